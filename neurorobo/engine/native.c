/* The kernels of the engine's fast path: windows of spiking layers, driven by their events.
 *
 * Plain C without headers of Python or torch; `kernels.py` calls it, and checks all arguments before. The file is built
 * once for each instruction set; the tile is the only thing that differs. Every sum has one order, whatever the
 * instruction set, the number of threads, the batch and the division of a window: sources ascend, one by one or, of
 * narrow weights, in groups that are exact. Products and sums are rounded apart (-ffp-contract=off), so that all builds
 * give the same bits.
 *
 * Spikes come as bits: a row of 64-bit words for each step and batch element, source s in bit s % 64 of word s / 64.
 * A layer's currents are then sums of those rows of its weights that the bits select. Weights are packed in tiles of
 * neighbouring targets, (tile, sources, targets of the tile), so that a row of a tile fits into registers: as floats, or
 * in 8 or 16 bits if all are small multiples of one power of two. A weight gradient is the same sum with the roles
 * exchanged: rows of current gradients, selected by the bits of one source.
 */

#define _DEFAULT_SOURCE /* for madvise */
#include <pthread.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#if defined(__linux__)
#include <sys/mman.h>
#endif
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "models.h"

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "words of bits are written by bytes, the lowest first"
#endif

#if defined(__AVX512F__)
#define VECTOR_BYTES 64
#elif defined(__AVX2__)
#define VECTOR_BYTES 32
#else
#define VECTOR_BYTES 16
#endif

enum {
    LANES = VECTOR_BYTES / 4,
    VECTORS = 8, /* the accumulators of one row of a tile; they stay in registers */
    TILE = VECTORS * LANES,
    WORD = 64,       /* sources in one word */
    SHORTS = VECTOR_BYTES / 2, /* numbers of 16 bits in one vector */
    BYTES = VECTOR_BYTES,      /* the most weights in one vector */
    BYTE_WORDS = 4,  /* words of sources whose bytes add up to what 16 bits hold: 4 * 64 * 255 < 2^16 */
    SHORT_WORDS = 2, /* words of sources whose tile of shorts stays in the cache nearest to the processor */
    LINE = 16,       /* floats in one line of the cache */
    ROWS = 64,       /* rows (steps x batch elements) of a block; its sums stay in the cache nearest to the processor */
    COLUMNS = 256,   /* neurons that a scan takes at once on the way back */
    RECURRENT = 16,  /* batch elements that step together through a recurrent layer */
    MOST_THREADS = 256
};

typedef float vector __attribute__((vector_size(VECTOR_BYTES), aligned(4), may_alias));
typedef int16_t shorts __attribute__((vector_size(VECTOR_BYTES), aligned(2), may_alias));
typedef uint16_t wrapping_shorts __attribute__((vector_size(VECTOR_BYTES), aligned(2), may_alias)); /* may overflow */
typedef int32_t integers __attribute__((vector_size(VECTOR_BYTES), aligned(4), may_alias));
typedef uint32_t wrapping_integers __attribute__((vector_size(VECTOR_BYTES), aligned(4), may_alias));

static int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }
static int64_t pieces(int64_t whole, int64_t piece) { return (whole + piece - 1) / piece; }

/* ---- Work shared among threads: items are independent, so that it does not matter who does which. ---- */

typedef void work(const void *arguments, int64_t item, int64_t worker);

typedef struct {
    work *run;
    const void *arguments;
    int64_t items;
    atomic_llong next, there; /* the next item, and how many workers there are */
} queue;

typedef struct {
    queue *queue;
    int64_t number;
} worker;

static void *serve(void *argument) {
    worker *self = argument;
    queue *queue = self->queue;
    for (int64_t item; (item = atomic_fetch_add(&queue->next, 1)) < queue->items;)
        queue->run(queue->arguments, item, self->number);
    return NULL;
}

static int64_t workers(int64_t threads, int64_t items) {
    return threads < 1 ? 1 : least(least(threads, MOST_THREADS), items < 1 ? 1 : items);
}

typedef void parallel(void (*run)(void *), void *argument, unsigned threads, unsigned flags);

static _Atomic(parallel *) of_openmp;

static void not_in_a_child(void) { of_openmp = NULL; }

/* Use the threads of an OpenMP library, given its GOMP_parallel: those that torch has its own work done by. Threads
 * beside them would wait for a processor while torch's look out for more to do. They do not outlive a fork. */
void neurorobo_use_openmp(parallel *of_torch) {
    if (!of_openmp && pthread_atfork(NULL, NULL, not_in_a_child) == 0) of_openmp = of_torch;
}

static void serve_together(void *argument) {
    queue *queue = argument;
    serve(&(worker){queue, atomic_fetch_add(&queue->there, 1)});
}

/* Without them, threads live as long as the call, and one that cannot start is not missed. */
static void share(work *run, const void *arguments, int64_t items, int64_t threads) {
    queue queue = {.run = run, .arguments = arguments, .items = items};
    worker crew[MOST_THREADS];
    pthread_t started[MOST_THREADS];
    int64_t count = 1, wanted = workers(threads, items);
    parallel *together = of_openmp;
    if (wanted > 1 && together) {
        together(serve_together, &queue, (unsigned)wanted, 0);
        return;
    }
    crew[0] = (worker){&queue, 0};
    for (; count < wanted; count++) {
        crew[count] = (worker){&queue, count};
        if (pthread_create(&started[count], NULL, serve, &crew[count]) != 0) break;
    }
    serve(&crew[0]);
    for (int64_t i = 1; i < count; i++) pthread_join(started[i], NULL);
}

/* ---- Memory ---- */

/* Ask for large pages where memory is touched for the first time: one fault in place of 512. */
void neurorobo_use_large_pages(float *memory, int64_t bytes) {
#if defined(__linux__)
    const uintptr_t page = 1 << 21, first = ((uintptr_t)memory + page - 1) / page * page;
    const uintptr_t end = ((uintptr_t)memory + (uintptr_t)bytes) / page * page;
    if (first < end) madvise((void *)first, end - first, MADV_HUGEPAGE); /* refused, it costs nothing either */
#else
    (void)memory, (void)bytes;
#endif
}

/* ---- Bits ---- */

/* Return in which lanes a vector has this value, the first in the lowest bit. */
INLINE uint64_t equals(vector lanes, float value) {
#if defined(__AVX512F__)
    return _mm512_cmp_ps_mask((__m512)lanes, _mm512_set1_ps(value), _CMP_EQ_OQ);
#elif defined(__AVX2__)
    return (uint64_t)_mm256_movemask_ps(_mm256_cmp_ps((__m256)lanes, _mm256_set1_ps(value), _CMP_EQ_OQ));
#elif defined(__x86_64__)
    return (uint64_t)_mm_movemask_ps(_mm_cmpeq_ps((__m128)lanes, _mm_set1_ps(value)));
#else
    uint64_t bits = 0;
    for (int i = 0; i < LANES; i++) bits |= (uint64_t)(lanes[i] == value) << i;
    return bits;
#endif
}

/* Pack one row of 0/1 into words; returns the number of ones, or -1 if there is any other value. */
static int64_t pack_row(const float *row, int64_t length, uint64_t *words) {
    int64_t events = 0, bad = 0;
    for (int64_t first = 0; first < length; first += WORD) {
        uint64_t ones = 0, zeros = 0;
        int64_t count = least(WORD, length - first);
        const float *piece = row + first;
        float padded[WORD] = {0};
        if (count < WORD) piece = memcpy(padded, piece, (size_t)count * sizeof(float));
        for (int i = 0; i < WORD; i += LANES) {
            vector lanes = *(const vector *)(piece + i);
            ones |= equals(lanes, 1.0f) << i;
            zeros |= equals(lanes, 0.0f) << i;
        }
        bad |= ~(ones | zeros) != 0;
        *words++ = ones;
        events += __builtin_popcountll(ones);
    }
    return bad ? -1 : events;
}

/* Pack spikes (steps, batch, sources), whose first two strides are given, into words (steps, batch, words).
 * Returns the number of ones, or -1 - the position (step * batch + element) * sources + source of the first value
 * that is neither 0 nor 1. */
int64_t neurorobo_pack_spikes(const float *spikes, int64_t steps, int64_t batch, int64_t sources, int64_t step_stride,
                              int64_t batch_stride, uint64_t *words) {
    int64_t events = 0, row_words = pieces(sources, WORD);
    for (int64_t t = 0; t < steps; t++)
        for (int64_t b = 0; b < batch; b++) {
            const float *row = spikes + t * step_stride + b * batch_stride;
            int64_t ones = pack_row(row, sources, words);
            if (ones < 0)
                for (int64_t s = 0; s < sources; s++)
                    if (row[s] != 0.0f && row[s] != 1.0f) return -1 - ((t * batch + b) * sources + s);
            events += ones;
            words += row_words;
        }
    return events;
}

/* Count the spikes of each batch element. */
void neurorobo_count(const uint64_t *words, int64_t steps, int64_t batch, int64_t row_words, float *counts) {
    for (int64_t b = 0; b < batch; b++) {
        int64_t ones = 0;
        for (int64_t t = 0; t < steps; t++)
            for (int64_t w = 0; w < row_words; w++)
                ones += __builtin_popcountll(words[(t * batch + b) * row_words + w]);
        counts[b] = (float)ones;
    }
}

/* Write the bits of some sources, a byte each. Returns -1, or the position of the first that is not among them all. */
int64_t neurorobo_pick(const uint64_t *words, int64_t rows, int64_t all, const int64_t *sources, int64_t some,
                       uint8_t *picked) {
    for (int64_t i = 0; i < some; i++)
        if (sources[i] < 0 || sources[i] >= all) return i;
    for (int64_t r = 0; r < rows; r++, words += pieces(all, WORD))
        for (int64_t i = 0; i < some; i++) {
            uint64_t source = (uint64_t)sources[i];
            *picked++ = words[source / WORD] >> (source % WORD) & 1;
        }
    return -1;
}

/* Mirror a square of 64 x 64 bits, row i in square[i], by exchanging its quarters, their quarters and so on. */
static void mirror(uint64_t square[WORD]) {
    uint64_t right = 0xffffffff00000000u; /* the columns whose number has the bit `half` */
    for (int half = WORD / 2; half; half /= 2, right ^= right >> half)
        for (int i = 0; i < WORD; i++)
            if (!(i & half)) {
                uint64_t moved = ((square[i] & right) >> half) ^ (square[i + half] & ~right);
                square[i] ^= moved << half;
                square[i + half] ^= moved;
            }
}

/* ---- Weights ---- */

/* Pack weights (targets, sources) into tiles. Returns -1, or the position of the first that is not finite. */
int64_t neurorobo_pack_weights(const float *weights, int64_t targets, int64_t sources, float *packed) {
    int bad = 0;
    for (int64_t first = 0; first < targets; first += TILE) {
        int64_t count = least(TILE, targets - first), width = pieces(count, LANES) * LANES;
        for (int64_t n = 0; n < width; n += 16)
            for (int64_t s0 = 0; s0 < sources; s0 += 16)
                for (int64_t s = s0; s < least(s0 + 16, sources); s++)
                    for (int64_t i = n; i < least(n + 16, width); i++) {
                        float weight = i < count ? weights[(first + i) * sources + s] : 0.0f;
                        packed[s * width + i] = weight;
                        bad |= weight - weight != 0;
                    }
        packed += sources * width;
    }
    if (bad)
        for (int64_t i = 0; i < targets * sources; i++)
            if (weights[i] - weights[i] != 0) return i;
    return -1;
}

/* Return how many floats packed weights take. */
int64_t neurorobo_packed_size(int64_t targets, int64_t sources) { return pieces(targets, LANES) * LANES * sources; }

/* Return how many bytes weights of 8 or 16 bits take. */
int64_t neurorobo_narrow_size(int64_t targets, int64_t sources, int64_t bits) {
    return pieces(targets, VECTOR_BYTES * 8 / bits) * VECTOR_BYTES * sources;
}

/* Pack weights (targets, sources) as multiples of a unit of 8 or 16 bits, two to a number: of neighbours n and n + (the
 * numbers in a vector) the first, made positive, is its lower half and the second its higher one. Returns 0, or 1 if one
 * is no multiple that fits. */
int64_t neurorobo_pack_narrow(const float *weights, int64_t targets, int64_t sources, double unit, int64_t bits,
                              void *packed) {
    int64_t numbers = VECTOR_BYTES * 4 / bits;
    int32_t most = (1 << (bits - 1)) - 1;
    float inverse = (float)(1 / unit), largest = (float)most;
    for (int64_t first = 0; first < targets; first += TILE) {
        int64_t count = least(TILE, targets - first), width = pieces(count, 2 * numbers) * numbers;
        for (int64_t i = 0; i < width; i++) {
            int64_t low = i / numbers * 2 * numbers + i % numbers, high = low + numbers;
            for (int64_t s = 0; s < sources; s++) {
                float below = low < count ? weights[(first + low) * sources + s] * inverse : 0.0f;
                float above = high < count ? weights[(first + high) * sources + s] * inverse : 0.0f;
                if (!(below >= -largest && below <= largest && above >= -largest && above <= largest)) return 1;
                int32_t whole_below = (int32_t)below, whole_above = (int32_t)above;
                if ((float)whole_below != below || (float)whole_above != above) return 1;
                int32_t both = whole_above * (1 << bits) + whole_below + most + 1;
                int64_t at = sources * first / 2 + s * width + i;
                if (bits == 8)
                    ((int16_t *)packed)[at] = (int16_t)both;
                else
                    ((int32_t *)packed)[at] = both;
            }
        }
    }
    return 0;
}

/* Add to sums those rows of a tile that the words select. */
INLINE void add_rows(float *sums, const uint64_t *words, int64_t row_words, const float *tile, const int vectors) {
    vector total[VECTORS];
    for (int v = 0; v < vectors; v++) total[v] = ((const vector *)sums)[v];
    for (int64_t w = 0; w < row_words; w++, tile += WORD * vectors * LANES)
        for (uint64_t word = words[w]; word; word &= word - 1) {
            const vector *row = (const vector *)(tile + __builtin_ctzll(word) * vectors * LANES);
            for (int v = 0; v < vectors; v++) total[v] += row[v];
        }
    for (int v = 0; v < vectors; v++) ((vector *)sums)[v] = total[v];
}

/* Word by word, so that 64 rows of the tile serve all rows of sums while they are near; a single row in one go. */
INLINE void add_events_of(float *sums, int64_t stride, int64_t rows, const uint64_t *const *words, int64_t row_words,
                          const float *tile, int cold, const int vectors) {
    int64_t at_once = rows == 1 ? row_words : 1, size = WORD * vectors * LANES;
    int64_t lines = cold && rows > 1 ? pieces(size, rows * LINE) : 0; /* of the next word, to fetch with each row */
    for (int64_t w = 0; w < row_words; w += at_once)
        for (int64_t r = 0; r < rows; r++) {
            const float *next = tile + (w + 1) * size + r * lines * LINE;
            for (int64_t i = 0; i < lines && w + 1 < row_words; i++) __builtin_prefetch(next + i * LINE);
            add_rows(sums + r * stride, words[r] + w, at_once, tile + w * size, vectors);
        }
}

/* For each row r: add to the sums at r * stride those rows of a tile of so many vectors that words[r] selects.
 * Cold is a tile that is read for the first time: events touch its rows in no order that a processor could foresee. */
static void add_events(float *sums, int64_t stride, int64_t rows, const uint64_t *const *words, int64_t row_words,
                       const float *tile, int cold, int64_t vectors) {
    switch (vectors) {
    case 1: add_events_of(sums, stride, rows, words, row_words, tile, cold, 1); break;
    case 2: add_events_of(sums, stride, rows, words, row_words, tile, cold, 2); break;
    case 3: add_events_of(sums, stride, rows, words, row_words, tile, cold, 3); break;
    case 4: add_events_of(sums, stride, rows, words, row_words, tile, cold, 4); break;
    case 5: add_events_of(sums, stride, rows, words, row_words, tile, cold, 5); break;
    case 6: add_events_of(sums, stride, rows, words, row_words, tile, cold, 6); break;
    case 7: add_events_of(sums, stride, rows, words, row_words, tile, cold, 7); break;
    default: add_events_of(sums, stride, rows, words, row_words, tile, cold, 8); break;
    }
}

/* As add_events_of, with a tile of bytes. Numbers of two bytes are added up as they are, where the sum of the low bytes
 * runs over into that of the high ones, and these once more by themselves; then the two can be told apart. */
INLINE void add_bytes_of(float *sums, int64_t stride, int64_t rows, const uint64_t *const *words, int64_t row_words,
                         const int16_t *tile, float unit, int cold, const int vectors) {
    int64_t width = vectors * SHORTS, size = BYTE_WORDS * WORD * width;
    int64_t lines = cold && rows > 1 ? pieces(size, rows * 2 * LINE) : 0;
    for (int64_t w = 0; w < row_words; w += BYTE_WORDS, tile += size)
        for (int64_t r = 0; r < rows; r++) {
            const int16_t *next = tile + size + r * lines * 2 * LINE, *piece = tile;
            for (int64_t i = 0; i < lines && w + BYTE_WORDS < row_words; i++) __builtin_prefetch(next + i * 2 * LINE);
            wrapping_shorts both[VECTORS / 4] = {{0}};
            shorts high[VECTORS / 4] = {{0}};
            int events = 0;
            for (int64_t v = w; v < least(w + BYTE_WORDS, row_words); v++, piece += WORD * width)
                for (uint64_t word = words[r][v]; word; word &= word - 1, events++) {
                    const shorts *row = (const shorts *)(piece + __builtin_ctzll(word) * width);
                    for (int i = 0; i < vectors; i++) {
                        both[i] += (wrapping_shorts)row[i];
                        high[i] += row[i] >> 8;
                    }
                }
            float *sum = sums + r * stride;
            for (int i = 0; i < vectors; i++)
                for (int n = 0; n < SHORTS; n++) {
                    uint16_t low = (uint16_t)(both[i][n] - high[i][n] * 256);
                    sum[i * BYTES + n] += unit * (float)(low - 128 * events);
                    sum[i * BYTES + SHORTS + n] += unit * (float)high[i][n];
                }
        }
}

/* The same with a tile of shorts, in numbers of four bytes. */
INLINE void add_shorts_of(float *sums, int64_t stride, int64_t rows, const uint64_t *const *words, int64_t row_words,
                          const int32_t *tile, float unit, int cold, const int vectors) {
    int64_t width = vectors * LANES, size = SHORT_WORDS * WORD * width;
    int64_t lines = cold && rows > 1 ? pieces(size, rows * LINE) : 0;
    for (int64_t w = 0; w < row_words; w += SHORT_WORDS, tile += size)
        for (int64_t r = 0; r < rows; r++) {
            const int32_t *next = tile + size + r * lines * LINE, *piece = tile;
            for (int64_t i = 0; i < lines && w + SHORT_WORDS < row_words; i++) __builtin_prefetch(next + i * LINE);
            wrapping_integers both[VECTORS / 2] = {{0}};
            integers high[VECTORS / 2] = {{0}};
            int events = 0;
            for (int64_t v = w; v < least(w + SHORT_WORDS, row_words); v++, piece += WORD * width)
                for (uint64_t word = words[r][v]; word; word &= word - 1, events++) {
                    const integers *row = (const integers *)(piece + __builtin_ctzll(word) * width);
                    for (int i = 0; i < vectors; i++) {
                        both[i] += (wrapping_integers)row[i];
                        high[i] += row[i] >> 16;
                    }
                }
            float *sum = sums + r * stride;
            for (int i = 0; i < vectors; i++)
                for (int n = 0; n < LANES; n++) {
                    uint32_t low = both[i][n] - (uint32_t)high[i][n] * 65536u;
                    sum[i * 2 * LANES + n] += unit * (float)((int32_t)low - 32768 * events);
                    sum[i * 2 * LANES + LANES + n] += unit * (float)high[i][n];
                }
        }
}

static void add_bytes(float *sums, int64_t stride, int64_t rows, const uint64_t *const *words, int64_t row_words,
                      const int16_t *tile, float unit, int cold, int64_t vectors) {
    if (vectors == 1)
        add_bytes_of(sums, stride, rows, words, row_words, tile, unit, cold, 1);
    else
        add_bytes_of(sums, stride, rows, words, row_words, tile, unit, cold, VECTORS / 4);
}

static void add_shorts(float *sums, int64_t stride, int64_t rows, const uint64_t *const *words, int64_t row_words,
                       const int32_t *tile, float unit, int cold, int64_t vectors) {
    switch (vectors) {
    case 1: add_shorts_of(sums, stride, rows, words, row_words, tile, unit, cold, 1); break;
    case 2: add_shorts_of(sums, stride, rows, words, row_words, tile, unit, cold, 2); break;
    case 3: add_shorts_of(sums, stride, rows, words, row_words, tile, unit, cold, 3); break;
    default: add_shorts_of(sums, stride, rows, words, row_words, tile, unit, cold, VECTORS / 2); break;
    }
}

/* ---- One window of a layer ---- */

typedef struct {
    int64_t sources;
    uint64_t *words; /* (steps, batch, words) */
} population;

typedef struct {
    const void *memory; /* packed */
    double unit;        /* what is counted with 8 or 16 bits */
    int64_t bits;       /* 32 are floats */
} weights;

typedef struct {
    population from;
    weights weights;      /* or, if there is an index, floats (targets, fan_in) */
    const int64_t *index; /* the sources (targets, fan_in); NULL if all */
    int64_t fan_in;
} projection;

typedef struct {
    int64_t steps, batch, neurons, threads;
    const float *current; /* (steps, batch, neurons) that the projections add to, or NULL */
    int64_t projections;
    const projection *projection;
    weights recurrent;        /* without memory if there are none */
    uint64_t *fired;          /* (steps + 1, batch, words), the first row of before the window; NULL if not recurrent
                                 and not asked for */
    const float *threshold;   /* one, or one per neuron */
    int64_t threshold_stride; /* 0 or 1 */
    double decay;
    int64_t rectify;
    float *spikes;     /* (steps, batch, neurons), or NULL */
    float *potentials; /* (steps, batch, neurons), or NULL; may be the current */
    float *last;       /* (batch, neurons): the potential before, then after */
    const model *model; /* of neurons that are not LIF, or NULL; their `last` is (batch, carried): all variables, and of
                           a recurrent layer what it fired; their `potentials` are what they heard */
    float *before;      /* (steps, batch, variables, neurons): their state before each step, or NULL */
} window;

static int64_t carried(const window *w) {
    if (!w->model) return w->neurons;
    return (w->model->variables + (w->recurrent.memory != NULL)) * w->neurons;
}

typedef struct {
    const window *window;
    float *expanded; /* for each worker, room for the spikes of a fan-in's sources: (sources, ROWS) */
    int64_t room;
    int64_t group, chunk; /* batch elements and steps of a block */
    int64_t tiles;        /* tiles of one item: 1, or all */
} division;

typedef struct {
    int64_t step, steps, element, elements; /* a block's rows: steps x batch elements */
} block;

static int64_t row_of(const window *w, const block *k, int64_t r) {
    return (k->step + r / k->elements) * w->batch + k->element + r % k->elements;
}

/* Write the spikes of a fan-in's sources as floats (sources, ROWS). */
static void expand(const uint64_t *const *words, int64_t rows, int64_t sources, float *expanded) {
    for (int64_t s = 0; s < sources; s++) {
        float *lane = expanded + s * ROWS;
        for (int64_t r = 0; r < rows; r++) lane[r] = (float)(words[r][s / WORD] >> (s % WORD) & 1);
        for (int64_t r = rows; r < ROWS; r++) lane[r] = 0;
    }
}

/* Add the currents of a fan-in to the sums of some of its targets: first all rows of 16 targets, then across. */
static void add_fan_in(float *sums, int64_t rows, const projection *p, const float *expanded, int64_t first,
                       int64_t count) {
    vector totals[16][ROWS / LANES];
    for (int64_t i = 0; i < count; i += 16) {
        int64_t some = least(16, count - i);
        for (int64_t n = 0; n < some; n++) {
            vector total[ROWS / LANES] = {{0}};
            for (int64_t j = 0; j < p->fan_in; j++) {
                int64_t synapse = (first + i + n) * p->fan_in + j;
                float weight = ((const float *)p->weights.memory)[synapse];
                const vector *lanes = (const vector *)(expanded + p->index[synapse] * ROWS);
                for (int v = 0; v < ROWS / LANES; v++) total[v] += weight * lanes[v];
            }
            for (int v = 0; v < ROWS / LANES; v++) totals[n][v] = total[v];
        }
        for (int64_t r = 0; r < rows; r++)
            for (int64_t n = 0; n < some; n++) sums[r * TILE + i + n] += ((const float *)totals[n])[r];
    }
}

/* Write a tile's spikes as bits into a row of words, and zeros behind the last tile. */
INLINE void write_bits(const float *spikes, uint64_t *row, int64_t neurons, int64_t first) {
    uint64_t bits[(TILE + WORD - 1) / WORD] = {0};
    int64_t bytes = first + TILE < neurons ? TILE / 8 : pieces(neurons, WORD) * 8 - first / 8;
    for (int i = 0; i < TILE; i += LANES) bits[i / WORD] |= equals(*(const vector *)(spikes + i), 1.0f) << (i % WORD);
    memcpy((uint8_t *)row + first / 8, bits, (size_t)bytes);
}

/* Step the neurons of a tile through a block's rows of currents. */
INLINE void scan_of(const window *w, const block *k, const float *sums, const float *threshold, int64_t first,
                    int64_t count, const int rectify) {
    float decay = (float)w->decay, spikes[TILE] = {0};
    int64_t row_words = pieces(w->neurons, WORD);
    for (int64_t g = 0; g < k->elements; g++) {
        float *restrict before = w->last + (k->element + g) * w->neurons + first;
        for (int64_t c = 0; c < k->steps; c++) {
            const float *restrict current = sums + (c * k->elements + g) * TILE;
            int64_t row = (k->step + c) * w->batch + k->element + g, at = row * w->neurons + first;
            for (int64_t i = 0; i < count; i++) {
                float carried = decay * before[i];
                float now = current[i] + (before[i] < threshold[i] ? carried : 0.0f);
                if (rectify) now = now < 0.0f ? 0.0f : now;
                spikes[i] = now >= threshold[i] ? 1.0f : 0.0f;
                before[i] = now;
            }
            if (w->spikes) memcpy(w->spikes + at, spikes, (size_t)count * sizeof(float));
            if (w->fired) write_bits(spikes, w->fired + (row + w->batch) * row_words, w->neurons, first);
            if (w->potentials) memcpy(w->potentials + at, before, (size_t)count * sizeof(float));
        }
    }
}

/* The same with neurons of another model. */
static __attribute__((noinline)) void scan_model(const window *w, const block *k, const float *sums, int64_t first, int64_t count) {
    const model *m = w->model;
    float sent[TILE] = {0};
    int64_t row_words = pieces(w->neurons, WORD), width = carried(w);
    size_t bytes = (size_t)count * sizeof(float);
    for (int64_t g = 0; g < k->elements; g++) {
        float *state = w->last + (k->element + g) * width + first;
        for (int64_t c = 0; c < k->steps; c++) {
            const float *current = sums + (c * k->elements + g) * TILE;
            int64_t row = (k->step + c) * w->batch + k->element + g, at = row * w->neurons + first;
            if (w->before)
                for (int64_t v = 0; v < m->variables; v++)
                    memcpy(w->before + (row * m->variables + v) * w->neurons + first, state + v * w->neurons, bytes);
            step_model(m, current, state, w->neurons, count, sent);
            if (w->spikes) memcpy(w->spikes + at, sent, bytes);
            if (w->fired) write_bits(sent, w->fired + (row + w->batch) * row_words, w->neurons, first);
            if (w->potentials) memcpy(w->potentials + at, current, bytes);
        }
        if (w->recurrent.memory) memcpy(state + m->variables * w->neurons, sent, bytes);
    }
}

/* Add the currents of all sources of a tile's neurons, from `first` on, to the sums of the rows. */
static void add_dense(float *sums, int64_t rows, const uint64_t *const *words, int64_t sources, const weights *from,
                      int64_t first, int64_t count, int cold) {
    int64_t row_words = pieces(sources, WORD), at = sources * first;
    float unit = (float)from->unit;
    if (from->bits == 8)
        add_bytes(sums, TILE, rows, words, row_words, (const int16_t *)from->memory + at / 2, unit, cold,
                  pieces(count, BYTES));
    else if (from->bits == 16)
        add_shorts(sums, TILE, rows, words, row_words, (const int32_t *)from->memory + at / 2, unit, cold,
                   pieces(count, SHORTS));
    else
        add_events(sums, TILE, rows, words, row_words, (const float *)from->memory + at, cold, pieces(count, LANES));
}

/* Run the neurons of one tile through one block. */
static void run_block(const window *w, const block *k, int64_t tile, const float *const *expanded) {
    float sums[ROWS * TILE], threshold[TILE];
    const uint64_t *words[ROWS];
    int64_t rows = k->steps * k->elements, first = tile * TILE, count = least(TILE, w->neurons - first);
    int64_t width = pieces(count, BYTES) * BYTES;
    int cold = k->step == 0 && k->element == 0;
    for (int64_t r = 0; r < rows; r++) {
        float *sum = sums + r * TILE;
        if (w->current) memcpy(sum, w->current + row_of(w, k, r) * w->neurons + first, (size_t)count * sizeof(float));
        int64_t given = w->current ? count : 0;
        memset(sum + given, 0, (size_t)(width - given) * sizeof(float));
    }
    for (int64_t p = 0; p < w->projections; p++) {
        const projection *from = &w->projection[p];
        if (from->index) {
            add_fan_in(sums, rows, from, expanded[p], first, count);
            continue;
        }
        for (int64_t r = 0; r < rows; r++) words[r] = from->from.words + row_of(w, k, r) * pieces(from->from.sources, WORD);
        add_dense(sums, rows, words, from->from.sources, &from->weights, first, count, cold);
    }
    if (w->recurrent.memory) { /* row t of `fired` is of the step before */
        for (int64_t r = 0; r < rows; r++) words[r] = w->fired + row_of(w, k, r) * pieces(w->neurons, WORD);
        add_dense(sums, rows, words, w->neurons, &w->recurrent, first, count, cold);
    }
    if (w->model) {
        scan_model(w, k, sums, first, count);
        return;
    }
    if (w->threshold_stride)
        memcpy(threshold, w->threshold + first, (size_t)count * sizeof(float));
    else
        for (int64_t i = 0; i < count; i++) threshold[i] = *w->threshold;
    if (w->rectify)
        scan_of(w, k, sums, threshold, first, count, 1);
    else
        scan_of(w, k, sums, threshold, first, count, 0);
}

enum { MOST_PROJECTIONS = 64 };

static void run_item(const void *arguments, int64_t item, int64_t worker) {
    const division *d = arguments;
    const window *w = d->window;
    int64_t all = pieces(w->neurons, TILE), groups = pieces(w->batch, d->group);
    int64_t first_tile = d->tiles == all ? 0 : item / groups;
    block k = {.element = item % groups * d->group};
    k.elements = least(d->group, w->batch - k.element);
    const float *expanded[MOST_PROJECTIONS];
    for (k.step = 0; k.step < w->steps; k.step += d->chunk) {
        k.steps = least(d->chunk, w->steps - k.step);
        float *room = d->expanded + worker * d->room;
        for (int64_t p = 0; p < w->projections; p++) {
            const projection *from = &w->projection[p];
            if (!from->index) continue;
            const uint64_t *words[ROWS];
            for (int64_t r = 0; r < k.steps * k.elements; r++)
                words[r] = from->from.words + row_of(w, &k, r) * pieces(from->from.sources, WORD);
            expand(words, k.steps * k.elements, from->from.sources, room);
            expanded[p] = room;
            room += from->from.sources * ROWS;
        }
        for (int64_t tile = first_tile; tile < first_tile + d->tiles; tile++) run_block(w, &k, tile, expanded);
    }
}

/* Run a layer through a window. Returns 0, 1 if there is no memory, 2 if there are more than 64 projections, or 3 if a
 * potential is not finite. */
int64_t neurorobo_run_window(const window *w) {
    if (w->projections > MOST_PROJECTIONS) return 2;
    int bad = 0;
    int64_t width = carried(w), numbers = w->batch * width;
    for (int64_t i = 0; i < numbers; i++) bad |= w->last[i] - w->last[i] != 0;
    if (bad) return 3;
    division d = {.window = w, .tiles = 1};
    for (int64_t p = 0; p < w->projections; p++)
        if (w->projection[p].index) d.room += w->projection[p].from.sources * ROWS;
    int64_t all = pieces(w->neurons, TILE), row_words = pieces(w->neurons, WORD);
    if (w->recurrent.memory || d.room) d.tiles = all; /* else a tile's weights stay in the cache from block to block */
    d.chunk = w->recurrent.memory ? 1 : least(w->steps, ROWS);
    d.group = w->recurrent.memory ? RECURRENT : ROWS / d.chunk;
    if (w->recurrent.memory)
        for (int64_t b = 0; b < w->batch; b++)
            for (int64_t n = 0; n < w->neurons; n++) {
                uint64_t *word = w->fired + b * row_words + n / WORD;
                if (n % WORD == 0) *word = 0;
                const float *last = w->last + b * width + n;
                uint64_t fires = w->model ? last[width - w->neurons] == 1.0f : *last >= w->threshold[n * w->threshold_stride];
                *word |= fires << (n % WORD);
            }
    int64_t items = pieces(w->batch, d.group) * (d.tiles == all ? 1 : all);
    if (d.room) {
        d.expanded = malloc((size_t)(workers(w->threads, items) * d.room) * sizeof(float));
        if (!d.expanded) return 1;
    }
    share(run_item, &d, items, w->threads);
    free(d.expanded);
    return 0;
}

/* ---- One window of a circuit: layers, each of which reads inputs and layers before it ---- */

typedef struct {
    const float *spikes; /* (steps, batch, sources) with these strides */
    int64_t step_stride, batch_stride;
    population to;
} input;

typedef struct {
    int64_t pieces;
    const population *piece; /* what is to lie side by side where a projection reads; none if it lies there already */
    int64_t most;            /* so many events pay; for more, a matrix product does */
} reading;

typedef struct {
    window window;
    const reading *reading; /* one for each projection */
    int64_t from_rest; /* whether the potentials before are zero, whatever `last` holds */
} stage;

typedef struct {
    int64_t inputs;
    const input *input;
    int64_t stages;
    stage *stage;
    int64_t threads, least_work; /* for how many additions of a weight threads are worth starting */
} circuit;

/* Lay the bits of several populations side by side. */
static void join(const population *piece, int64_t count, const population *whole, int64_t rows) {
    int64_t row_words = pieces(whole->sources, WORD), at = 0;
    memset(whole->words, 0, (size_t)(rows * row_words) * sizeof(uint64_t));
    for (const population *end = piece + count; piece < end; at += piece++->sources) {
        int64_t words = pieces(piece->sources, WORD), left = at % WORD;
        for (int64_t r = 0; r < rows; r++) {
            uint64_t *into = whole->words + r * row_words + at / WORD;
            for (int64_t w = 0; w < words; w++) {
                uint64_t word = piece->words[r * words + w];
                into[w] |= word << left;
                if (left && word >> (WORD - left)) into[w + 1] |= word >> (WORD - left);
            }
        }
    }
}

/* Put a layer's neurons to rest. */
static void rest(const window *w) {
    int64_t width = carried(w);
    memset(w->last, 0, (size_t)(w->batch * width) * sizeof(float));
    for (int64_t v = 0; w->model && v < w->model->variables; v++)
        for (int64_t b = 0; b < w->batch; b++)
            for (int64_t i = 0; i < w->neurons; i++)
                w->last[b * width + v * w->neurons + i] = (float)w->model->rest[v];
}

/* Run a circuit through a window. Returns 0, what neurorobo_run_window does if one of its layers fails, 4 if an input
 * holds anything but spikes, or 5 if a projection's sources fire so often that it had better be run elsewhere. */
int64_t neurorobo_run_circuit(const circuit *c) {
    if (!c->stages) return 0;
    int64_t steps = c->stage->window.steps, batch = c->stage->window.batch, rows = steps * batch;
    if (!rows) return 0; /* an empty batch, of which there is no memory */
    for (const input *i = c->input; i < c->input + c->inputs; i++)
        if (neurorobo_pack_spikes(i->spikes, steps, batch, i->to.sources, i->step_stride, i->batch_stride,
                                  i->to.words) < 0)
            return 4;
    for (stage *s = c->stage; s < c->stage + c->stages; s++) {
        window *w = &s->window;
        int64_t work = w->recurrent.memory ? rows * w->neurons * w->neurons / 8 : 0;
        for (int64_t p = 0; p < w->projections; p++) {
            const population *from = &w->projection[p].from;
            const reading *reading = &s->reading[p];
            if (reading->pieces) join(reading->piece, reading->pieces, from, rows);
            int64_t events = 0, words = rows * pieces(from->sources, WORD);
            for (int64_t i = 0; i < words; i++) events += __builtin_popcountll(from->words[i]);
            if (events > reading->most) return 5;
            work += events * w->neurons;
        }
        if (s->from_rest) rest(w);
        w->threads = work >= c->least_work ? c->threads : 1;
        int64_t failed = neurorobo_run_window(w);
        if (failed) return failed;
    }
    return 0;
}

/* ---- The scan on the way back ---- */

typedef struct {
    int64_t steps, batch, neurons, threads;
    const float *potentials;   /* (steps, batch, neurons) */
    const float *grad_spikes;  /* (steps, batch, neurons), with these strides */
    int64_t step_stride, batch_stride;
    const float *grad_last;    /* (batch, neurons) of the last step's potential, or NULL */
    const float *later;        /* (batch, neurons): the gradient of the current after the last step, or NULL */
    const float *threshold;
    int64_t threshold_stride;
    double decay;
    int64_t full;    /* whether the gradient flows through the reset */
    int64_t rectify; /* whether the potentials were rectified */
    int64_t shape;
    double width; /* of the surrogate */
    float *grad_current;   /* (steps, batch, neurons) */
    float *grad_threshold; /* (batch, neurons) that is added to, or NULL */
} scan_back;

INLINE void scan_back_of(const scan_back *k, int64_t b, int64_t first, int64_t count, const enum shape shape) {
    float later[COLUMNS], threshold[COLUMNS], grad_threshold[COLUMNS] = {0};
    float decay = (float)k->decay, through_reset = k->full ? -decay : 0.0f, width = (float)k->width;
    int64_t size = k->batch * k->neurons, column = b * k->neurons + first;
    for (int64_t i = 0; i < count; i++) threshold[i] = k->threshold[(first + i) * k->threshold_stride];
    for (int64_t i = 0; i < count; i++) later[i] = k->later ? k->later[column + i] : 0.0f;
    for (int64_t t = k->steps - 1; t >= 0; t--) {
        const float *restrict potential = k->potentials + t * size + column;
        const float *restrict grad_spikes = k->grad_spikes + t * k->step_stride + b * k->batch_stride + first;
        const float *restrict grad_last = k->grad_last && t == k->steps - 1 ? k->grad_last + column : NULL;
        float *restrict grad_current = k->grad_current + t * size + column;
        for (int64_t i = 0; i < count; i++) {
            float u = potential[i], through = decay * later[i];
            float grad = derivative(u - threshold[i], width, shape) * (grad_spikes[i] + through_reset * u * later[i]);
            grad_threshold[i] -= grad;
            later[i] = grad + (u < threshold[i] ? through : 0.0f);
        }
        if (grad_last)
            for (int64_t i = 0; i < count; i++) later[i] += grad_last[i];
        if (k->rectify)
            for (int64_t i = 0; i < count; i++) later[i] = potential[i] > 0 ? later[i] : 0.0f;
        memcpy(grad_current, later, (size_t)count * sizeof(float));
    }
    if (k->grad_threshold)
        for (int64_t i = 0; i < count; i++) k->grad_threshold[column + i] += grad_threshold[i];
}

static void scan_back_item(const void *arguments, int64_t item, int64_t worker) {
    const scan_back *k = arguments;
    int64_t parts = pieces(k->neurons, COLUMNS), first = item % parts * COLUMNS, b = item / parts;
    int64_t count = least(COLUMNS, k->neurons - first);
    (void)worker;
    switch (k->shape) {
    case RECTANGULAR: scan_back_of(k, b, first, count, RECTANGULAR); break;
    case TRIANGULAR: scan_back_of(k, b, first, count, TRIANGULAR); break;
    case ARCTAN: scan_back_of(k, b, first, count, ARCTAN); break;
    default: scan_back_of(k, b, first, count, FAST_SIGMOID); break;
    }
}

/* Write the gradient of the currents of a window, or of some steps of it. */
void neurorobo_scan_back(const scan_back *k) {
    share(scan_back_item, k, k->batch * pieces(k->neurons, COLUMNS), k->threads);
}

/* ---- The way back through neurons of other models ---- */

typedef struct {
    int64_t steps, batch, neurons, threads;
    const model *model;
    const float *before;      /* (steps, batch, variables, neurons): the state before each step */
    const float *current;     /* (steps, batch, neurons): all that they heard */
    const float *grad_sent;   /* (steps, batch, neurons), with these strides */
    int64_t step_stride, batch_stride;
    float *grad_state;        /* (batch, variables, neurons): of the state after the window, then of that before it */
    float *grad_current;      /* (steps, batch, neurons) */
} model_back;

static void model_back_item(const void *arguments, int64_t item, int64_t worker) {
    const model_back *k = arguments;
    int64_t parts = pieces(k->neurons, ABREAST), first = item % parts * ABREAST, b = item / parts;
    int64_t count = least(ABREAST, k->neurons - first), variables = k->model->variables;
    size_t bytes = (size_t)count * sizeof(float);
    float before[MOST_VARIABLES][ABREAST] = {{0}}, grad[MOST_VARIABLES][ABREAST] = {{0}};
    (void)worker;
    for (int64_t v = 0; v < variables; v++)
        memcpy(grad[v], k->grad_state + (b * variables + v) * k->neurons + first, bytes);
    for (int64_t t = k->steps - 1; t >= 0; t--) {
        int64_t row = t * k->batch + b, at = row * k->neurons + first;
        const float *sent = k->grad_sent + t * k->step_stride + b * k->batch_stride + first, *now = k->current + at;
        float *into = k->grad_current + at;
        for (int64_t v = 0; v < variables; v++)
            memcpy(before[v], k->before + (row * variables + v) * k->neurons + first, bytes);
        switch (k->model->kind) {
        case GENERALIZED_LIF: back_generalized_lif(k->model, now, before, sent, grad, count, into); break;
        case IZHIKEVICH: back_izhikevich(k->model, now, before, sent, grad, count, into); break;
        case ADEX: back_adex(k->model, now, before, sent, grad, count, into); break;
        default: back_soft_unit(k->model, now, before, sent, grad, count, into); break;
        }
    }
    for (int64_t v = 0; v < variables; v++)
        memcpy(k->grad_state + (b * variables + v) * k->neurons + first, grad[v], bytes);
}

/* Write the gradients of the currents of a window, or of some steps of it, and of the state before. */
void neurorobo_model_back(const model_back *k) {
    share(model_back_item, k, k->batch * pieces(k->neurons, ABREAST), k->threads);
}

/* ---- Weight gradients ---- */

typedef struct {
    int64_t rows, sources, targets, threads;
    const uint64_t *words;     /* (rows, words); a row is a step of a batch element */
    const float *grad_current; /* (rows, targets) */
    const int64_t *index;      /* the sources (targets, fan_in); NULL if all */
    int64_t fan_in;
    float *grad_weight; /* (targets, sources), or (targets, fan_in) */
} weight_gradient;

typedef struct {
    const weight_gradient *of;
    const uint64_t *by_source; /* (blocks of rows, sources padded to words): row r of the block in bit r % 64 */
    float *room;               /* for each worker */
    int64_t room_each;
} gradient_work;

/* Turn the words of rows into words of sources. */
static void words_by_source(const weight_gradient *k, uint64_t *by_source) {
    int64_t row_words = pieces(k->sources, WORD);
    for (int64_t first = 0; first < k->rows; first += ROWS)
        for (int64_t w = 0; w < row_words; w++, by_source += WORD) {
            int64_t count = least(ROWS, k->rows - first);
            for (int64_t r = 0; r < ROWS; r++) by_source[r] = r < count ? k->words[(first + r) * row_words + w] : 0;
            mirror(by_source);
        }
}

/* The gradient of one tile of targets: for each source, the sum of the rows in which it fired. */
static void dense_gradient_item(const void *arguments, int64_t tile, int64_t worker) {
    const gradient_work *d = arguments;
    const weight_gradient *k = d->of;
    float rows[ROWS * TILE], *sums = d->room + worker * d->room_each;
    int64_t first = tile * TILE, count = least(TILE, k->targets - first), vectors = pieces(count, LANES);
    int64_t width = vectors * LANES, padded = pieces(k->sources, WORD) * WORD;
    memset(sums, 0, (size_t)(k->sources * width) * sizeof(float));
    memset(rows, 0, sizeof rows);
    const uint64_t *by_source = d->by_source;
    for (int64_t block = 0; block < k->rows; block += ROWS, by_source += padded) {
        for (int64_t r = 0; r < least(ROWS, k->rows - block); r++)
            memcpy(rows + r * width, k->grad_current + (block + r) * k->targets + first, (size_t)count * sizeof(float));
        for (int64_t s = 0; s < k->sources; s += WORD) {
            const uint64_t *words[WORD];
            int64_t those = least(WORD, k->sources - s);
            for (int64_t i = 0; i < those; i++) words[i] = by_source + s + i;
            add_events(sums + s * width, width, those, words, 1, rows, 0, vectors);
        }
    }
    for (int64_t s0 = 0; s0 < k->sources; s0 += 16)
        for (int64_t i = 0; i < count; i++)
            for (int64_t s = s0; s < least(s0 + 16, k->sources); s++)
                k->grad_weight[(first + i) * k->sources + s] = sums[s * width + i];
}

enum { FAN_IN_TARGETS = 1024 };

/* The gradient of some targets of a fan-in: for each synapse, the sum of the target's gradients where its source fired. */
static void fan_in_gradient_item(const void *arguments, int64_t item, int64_t worker) {
    const gradient_work *d = arguments;
    const weight_gradient *k = d->of;
    float *expanded = d->room + worker * d->room_each;
    int64_t row_words = pieces(k->sources, WORD), end = least((item + 1) * FAN_IN_TARGETS, k->targets);
    for (int64_t i = item * FAN_IN_TARGETS * k->fan_in; i < end * k->fan_in; i++) k->grad_weight[i] = 0;
    for (int64_t block = 0; block < k->rows; block += ROWS) {
        const uint64_t *words[ROWS];
        int64_t rows = least(ROWS, k->rows - block);
        for (int64_t r = 0; r < rows; r++) words[r] = k->words + (block + r) * row_words;
        expand(words, rows, k->sources, expanded);
        for (int64_t first = item * FAN_IN_TARGETS; first < end; first += 16) {
            float grads[16][ROWS] = {{0}};
            int64_t count = least(16, end - first);
            for (int64_t r = 0; r < rows; r++)
                for (int64_t i = 0; i < count; i++)
                    grads[i][r] = k->grad_current[(block + r) * k->targets + first + i];
            for (int64_t synapse = first * k->fan_in; synapse < (first + count) * k->fan_in; synapse++) {
                const float *grad = grads[synapse / k->fan_in - first], *lane = expanded + k->index[synapse] * ROWS;
                float sums[16] = {0}; /* as many, and added up in this order, with all instruction sets */
                for (int r = 0; r < ROWS; r += 16)
                    for (int i = 0; i < 16; i++) sums[i] += grad[r + i] * lane[r + i];
                for (int half = 8; half; half /= 2)
                    for (int i = 0; i < half; i++) sums[i] += sums[i + half];
                k->grad_weight[synapse] += sums[0];
            }
        }
    }
}

/* Write the gradient of the weights. Returns 0, or 1 if there is no memory. */
int64_t neurorobo_weight_gradient(const weight_gradient *k) {
    int64_t items = k->index ? pieces(k->targets, FAN_IN_TARGETS) : pieces(k->targets, TILE);
    int64_t count = workers(k->threads, items);
    gradient_work d = {.of = k, .room_each = k->sources * (k->index ? (int64_t)ROWS : (int64_t)TILE)};
    d.room = malloc((size_t)(count * d.room_each) * sizeof(float) + 1);
    uint64_t *by_source = NULL;
    if (!k->index) {
        by_source = malloc((size_t)(pieces(k->rows, ROWS) * pieces(k->sources, WORD) * WORD) * sizeof(uint64_t) + 1);
        if (by_source) words_by_source(k, by_source);
        d.by_source = by_source;
    }
    int64_t failed = !d.room || (!k->index && !by_source);
    if (!failed) share(k->index ? fan_in_gradient_item : dense_gradient_item, &d, items, k->threads);
    free(by_source);
    free(d.room);
    return failed;
}

/* ---- Codes that count spikes ---- */

/* Write the spikes (steps, values, neurons) of a code that turns each value into the nearest number of spikes: spread
 * evenly if `first` is NULL, else each where (steps, neurons) says from which number on it is there. From one value's
 * neurons to the next it is `stride` neurons. Returns -1, or the position of the first value that is not finite. */
int64_t neurorobo_encode(const float *value, int64_t values, int64_t neurons, int64_t stride, int64_t steps, double lo,
                         double hi, const int64_t *first, float *spikes) {
    int64_t slots = neurons * steps, room[COLUMNS];
    float low = (float)lo, range = (float)(hi - lo);
    for (int64_t v = 0; v < values; v++) {
        if (value[v] - value[v] != 0) return v;
        float fraction = (value[v] - low) / range;
        fraction = fraction < 0.0f ? 0.0f : fraction > 1.0f ? 1.0f : fraction;
        /* Rounded to the nearest whole number, halves to an even one, by what a double has room for. */
        int64_t count = (int64_t)((double)(fraction * (float)slots) + 0x1.8p52 - 0x1.8p52);
        for (int64_t n0 = 0; n0 < neurons; n0 += COLUMNS) {
            int64_t some = least(COLUMNS, neurons - n0);
            for (int64_t n = 0; n < some; n++) room[n] = (n0 + n) * steps;
            for (int64_t t = 0; t < steps; t++) {
                float *row = spikes + (t * values + v) * stride + n0;
                if (first) {
                    for (int64_t n = 0; n < some; n++) row[n] = count >= first[t * neurons + n0 + n] ? 1.0f : 0.0f;
                    continue;
                }
                for (int64_t n = 0; n < some; n++) { /* a neuron fires when its share of the count is a whole number */
                    int64_t now = room[n] + count;
                    row[n] = now >= slots ? 1.0f : 0.0f;
                    room[n] = now >= slots ? now - slots : now;
                }
            }
        }
    }
    return -1;
}

/* Write `lo + resolution * count` of each value (batch, width) whose spikes (steps, batch, width, neurons), with these
 * strides of steps and batch, are given. */
void neurorobo_decode(const float *spikes, int64_t steps, int64_t batch, int64_t width, int64_t neurons,
                      int64_t step_stride, int64_t batch_stride, double lo, double resolution, float *value) {
    float low = (float)lo, unit = (float)resolution;
    for (int64_t v = 0; v < batch * width; v++) {
        const float *first = spikes + v / width * batch_stride + v % width * neurons;
        float counts[LINE] = {0}, count = 0; /* whole numbers, whose sums are exact in any order */
        for (int64_t t = 0; t < steps; t++) {
            const float *row = first + t * step_stride;
            int64_t n = 0;
            for (; n + LINE <= neurons; n += LINE)
                for (int64_t i = 0; i < LINE; i++) counts[i] += row[n + i];
            for (int64_t i = 0; n + i < neurons; i++) counts[i] += row[n + i];
        }
        for (int64_t i = 0; i < LINE; i++) count += counts[i];
        value[v] = low + count * unit;
    }
}

/* ---- About the build ---- */

/* Return the instruction set of this processor, as far as there is a build for it: 2 AVX-512, 1 AVX2, 0 other. */
int64_t neurorobo_processor(void) {
#if defined(__x86_64__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl"))
        return 2;
    if (__builtin_cpu_supports("avx2")) return 1;
#endif
    return 0;
}

#ifndef NEUROROBO_SOURCE
#define NEUROROBO_SOURCE "unknown"
#endif

/* Return the hash of the source that this was built from. */
const char *neurorobo_source(void) { return NEUROROBO_SOURCE; }
