/* Neurons other than the iterative LIF: one step of a row of them, forwards and backwards.
 *
 * Each has its equations in `neurons/`, and computes them here operation by operation in the same order, each rounded by
 * itself, so that both give the same bits.
 */

#ifndef NEUROROBO_MODELS_H
#define NEUROROBO_MODELS_H

#include <stdint.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline))

enum kind { GENERALIZED_LIF, IZHIKEVICH, ADEX, SOFT_UNIT };
enum shape { RECTANGULAR, TRIANGULAR, ARCTAN, FAST_SIGMOID };
enum { MOST_VARIABLES = 3, MOST_SUBSTEPS = 64 };

typedef struct {
    double threshold, decay, input_gain, synapse_decay, adaptation, adaptation_decay;
    int64_t has_synapse, adapts, subtracts, full; /* `full` is a reset that the gradient flows through */
} generalized_lif;

typedef struct {
    double b, c, d, input_gain, peak, substep, recovery; /* the share that u recovers in a substep */
    int64_t substeps;
} izhikevich;

typedef struct {
    double rest, threshold, inverse_slope, leak, upstroke, a, b, reset, input_gain, peak;
    double charging, recovery; /* a substep over the capacitance, and over the time constant */
    int64_t substeps;
} adex;

typedef struct {
    double threshold, decay, slope;
} soft_unit;

typedef struct {
    int64_t kind, variables;
    double rest[MOST_VARIABLES];
    int64_t shape;
    double width; /* of the surrogate */
    union {
        generalized_lif generalized_lif;
        izhikevich izhikevich;
        adex adex;
        soft_unit soft_unit;
    } of;
} model;

INLINE float exponential(float x) {
    x = x > -87.0f ? x > 88.0f ? 88.0f : x : -87.0f; /* where a NaN ends too, of which there is no whole number */
    float whole = x * 1.44269504088896340736f + 0x1.8p23f - 0x1.8p23f; /* rounded by what a float has room for */
    float rest = x - whole * 0.693359375f - whole * -2.12194440e-4f, sums = 1.9875691500e-4f;
    union {
        int32_t bits;
        float number;
    } power = {((int32_t)whole + 127) << 23};
    sums = sums * rest + 1.3981999507e-3f;
    sums = sums * rest + 8.3334519073e-3f;
    sums = sums * rest + 4.1665795894e-2f;
    sums = sums * rest + 1.6666665459e-1f;
    sums = sums * rest + 5.0000001201e-1f;
    sums = sums * rest * rest + rest + 1.0f;
    return sums * power.number;
}

INLINE float sigmoid(float x) { return 1.0f / (exponential(-x) + 1.0f); }

INLINE float derivative(float distance, float width, const enum shape shape) {
    float away = distance < 0 ? -distance : distance, half = width / 2;
    if (shape == RECTANGULAR) return (away < half ? 1.0f : 0.0f) / width;
    if (shape == TRIANGULAR) {
        float height = 1.0f - away / width;
        return (height < 0 ? 0.0f : height) / width;
    }
    if (shape == ARCTAN) {
        float scaled = distance / half;
        return 1.0f / (scaled * scaled + 1.0f) * (float)(1 / (3.14159265358979323846 * (double)half));
    }
    float scale = 0.41421356237309504880f / half; /* sqrt(2) - 1 */
    float below = away * scale + 1.0f;
    return 1.0f / (below * below) * (scale / 2);
}

/* Write the derivatives over the distances. */
static void to_derivatives(float *distance, int64_t count, const model *m) {
    float width = (float)m->width;
    switch (m->shape) {
    case RECTANGULAR: for (int64_t i = 0; i < count; i++) distance[i] = derivative(distance[i], width, RECTANGULAR); break;
    case TRIANGULAR: for (int64_t i = 0; i < count; i++) distance[i] = derivative(distance[i], width, TRIANGULAR); break;
    case ARCTAN: for (int64_t i = 0; i < count; i++) distance[i] = derivative(distance[i], width, ARCTAN); break;
    default: for (int64_t i = 0; i < count; i++) distance[i] = derivative(distance[i], width, FAST_SIGMOID); break;
    }
}

/* Step `count` neurons, whose variables lie `stride` apart, and write what they send: spikes, or a unit's output. */
static void step_generalized_lif(const generalized_lif *m, const float *restrict current, float *state, int64_t stride,
                                 int64_t count, float *restrict sent) {
    float *restrict potential = state, *restrict synapse = state + stride;
    float *restrict adapted = state + (m->has_synapse ? 2 : 1) * stride;
    float threshold = (float)m->threshold, decay = (float)m->decay, gain = (float)m->input_gain;
    float adaptation = (float)m->adaptation, fading = (float)m->adaptation_decay, ebbing = (float)m->synapse_decay;
    if (m->has_synapse)
        for (int64_t i = 0; i < count; i++) synapse[i] = synapse[i] * ebbing + current[i];
    const float *drive = m->has_synapse ? synapse : current;
    for (int64_t i = 0; i < count; i++) potential[i] = potential[i] * decay + drive[i] * gain;
    if (m->adapts)
        for (int64_t i = 0; i < count; i++) {
            sent[i] = potential[i] - threshold - adapted[i] * adaptation >= 0 ? 1.0f : 0.0f;
            adapted[i] = adapted[i] * fading + sent[i];
        }
    else
        for (int64_t i = 0; i < count; i++) sent[i] = potential[i] - threshold >= 0 ? 1.0f : 0.0f;
    if (m->subtracts)
        for (int64_t i = 0; i < count; i++) potential[i] -= sent[i] * threshold;
    else
        for (int64_t i = 0; i < count; i++) potential[i] *= 1.0f - sent[i];
}

static void step_izhikevich(const izhikevich *m, const float *restrict current, float *state, int64_t stride,
                            int64_t count, float *restrict sent) {
    float *restrict v = state, *restrict u = state + stride;
    float b = (float)m->b, c = (float)m->c, d = (float)m->d, gain = (float)m->input_gain, peak = (float)m->peak;
    float substep = (float)m->substep, recovery = (float)m->recovery;
    for (int64_t n = 0; n < m->substeps; n++)
        for (int64_t i = 0; i < count; i++) {
            float change = (v[i] * 0.04f + 5.0f) * v[i] + 140.0f - u[i] + current[i] * gain;
            float then = v[i] + change * substep;
            then = then > peak ? peak : then;
            u[i] = u[i] + (then * b - u[i]) * recovery;
            v[i] = then;
        }
    for (int64_t i = 0; i < count; i++) {
        sent[i] = v[i] - peak >= 0 ? 1.0f : 0.0f;
        v[i] = v[i] * (1.0f - sent[i]) + sent[i] * c;
        u[i] = u[i] + sent[i] * d;
    }
}

static void step_adex(const adex *m, const float *restrict current, float *state, int64_t stride, int64_t count,
                      float *restrict sent) {
    float *restrict v = state, *restrict w = state + stride;
    float rest = (float)m->rest, threshold = (float)m->threshold, inverse_slope = (float)m->inverse_slope;
    float leak = (float)m->leak, upstroke = (float)m->upstroke, a = (float)m->a, gain = (float)m->input_gain;
    float peak = (float)m->peak, charging = (float)m->charging, recovery = (float)m->recovery;
    for (int64_t n = 0; n < m->substeps; n++)
        for (int64_t i = 0; i < count; i++) {
            float change = (rest - v[i]) * leak + exponential((v[i] - threshold) * inverse_slope) * upstroke;
            change = change - w[i] + current[i] * gain;
            float then = v[i] + change * charging;
            then = then > peak ? peak : then;
            w[i] = w[i] + ((then - rest) * a - w[i]) * recovery;
            v[i] = then;
        }
    for (int64_t i = 0; i < count; i++) {
        sent[i] = v[i] - peak >= 0 ? 1.0f : 0.0f;
        v[i] = v[i] * (1.0f - sent[i]) + sent[i] * (float)m->reset;
        w[i] = w[i] + sent[i] * (float)m->b;
    }
}

static void step_soft_unit(const soft_unit *m, const float *restrict current, float *restrict potential, int64_t count,
                           float *restrict sent) {
    float threshold = (float)m->threshold, decay = (float)m->decay, slope = (float)m->slope;
    for (int64_t i = 0; i < count; i++) {
        float output = sigmoid((potential[i] - threshold) * slope);
        float now = potential[i] * decay * (1.0f - output) + current[i];
        potential[i] = now > 0 ? now : 0.0f;
        sent[i] = sigmoid((potential[i] - threshold) * slope);
    }
}

static void step_model(const model *m, const float *current, float *state, int64_t stride, int64_t count, float *sent) {
    switch (m->kind) {
    case GENERALIZED_LIF: step_generalized_lif(&m->of.generalized_lif, current, state, stride, count, sent); break;
    case IZHIKEVICH: step_izhikevich(&m->of.izhikevich, current, state, stride, count, sent); break;
    case ADEX: step_adex(&m->of.adex, current, state, stride, count, sent); break;
    default: step_soft_unit(&m->of.soft_unit, current, state, count, sent); break;
    }
}

enum { ABREAST = 64 }; /* neurons that go back through a step together */

/* Go back through one step of `count` neurons, given the gradients of what they sent and of the variables after it, which
 * become those of the variables before it. All rows are ABREAST long. */
static void back_generalized_lif(const model *m, const float *current, float before[][ABREAST], const float *grad_sent,
                                 float grad[][ABREAST], int64_t count, float *grad_current) {
    const generalized_lif *k = &m->of.generalized_lif;
    int64_t at = k->has_synapse ? 2 : 1;
    float threshold = (float)k->threshold, decay = (float)k->decay, gain = (float)k->input_gain;
    float adaptation = (float)k->adaptation, fading = (float)k->adaptation_decay, ebbing = (float)k->synapse_decay;
    float potential[ABREAST], distance[ABREAST], slope[ABREAST];
    for (int64_t i = 0; i < count; i++) {
        float drive = k->has_synapse ? before[1][i] * ebbing + current[i] : current[i];
        potential[i] = before[0][i] * decay + drive * gain;
        distance[i] = potential[i] - threshold;
        if (k->adapts) distance[i] -= before[at][i] * adaptation;
        slope[i] = distance[i];
    }
    to_derivatives(slope, count, m);
    for (int64_t i = 0; i < count; i++) {
        float after = grad[0][i], of_spike = grad_sent[i];
        if (k->full) of_spike -= (k->subtracts ? threshold : potential[i]) * after;
        if (k->adapts) of_spike += grad[at][i];
        float through = slope[i] * of_spike;
        float now = (k->subtracts || distance[i] < 0 ? after : 0.0f) + through;
        if (k->adapts) grad[at][i] = grad[at][i] * fading - through * adaptation;
        float driven = now * gain;
        if (k->has_synapse) {
            driven += grad[1][i];
            grad[1][i] = driven * ebbing;
        }
        grad[0][i] = now * decay;
        grad_current[i] = driven;
    }
}

/* What the two neurons of two variables have in common: from the end of a step to the end of its last substep. */
static void back_through_reset(const model *m, const float *v, float peak, float reset, float jump,
                               const float *grad_sent, float grad[][ABREAST], int64_t count) {
    float slope[ABREAST];
    for (int64_t i = 0; i < count; i++) slope[i] = v[i] - peak;
    to_derivatives(slope, count, m);
    for (int64_t i = 0; i < count; i++) {
        float of_spike = grad_sent[i] + (reset - v[i]) * grad[0][i] + jump * grad[1][i];
        grad[0][i] = (v[i] < peak ? grad[0][i] : 0.0f) + slope[i] * of_spike;
    }
}

static void back_izhikevich(const model *m, const float *current, float before[][ABREAST], const float *grad_sent,
                            float grad[][ABREAST], int64_t count, float *grad_current) {
    const izhikevich *k = &m->of.izhikevich;
    float v[MOST_SUBSTEPS + 1][ABREAST], raw[MOST_SUBSTEPS][ABREAST], u[ABREAST];
    float b = (float)k->b, gain = (float)k->input_gain, peak = (float)k->peak;
    float substep = (float)k->substep, recovery = (float)k->recovery;
    memcpy(v[0], before[0], sizeof v[0]);
    memcpy(u, before[1], sizeof u);
    for (int64_t n = 0; n < k->substeps; n++)
        for (int64_t i = 0; i < count; i++) {
            float change = (v[n][i] * 0.04f + 5.0f) * v[n][i] + 140.0f - u[i] + current[i] * gain;
            raw[n][i] = v[n][i] + change * substep;
            v[n + 1][i] = raw[n][i] > peak ? peak : raw[n][i];
            u[i] = u[i] + (v[n + 1][i] * b - u[i]) * recovery;
        }
    back_through_reset(m, v[k->substeps], peak, (float)k->c, (float)k->d, grad_sent, grad, count);
    for (int64_t i = 0; i < count; i++) grad_current[i] = 0;
    for (int64_t n = k->substeps - 1; n >= 0; n--)
        for (int64_t i = 0; i < count; i++) {
            float of_raw = grad[0][i] + grad[1][i] * recovery * b;
            of_raw = n == k->substeps - 1 || raw[n][i] <= peak ? of_raw : 0.0f;
            grad[0][i] = of_raw * (1.0f + substep * (0.08f * v[n][i] + 5.0f));
            grad[1][i] = grad[1][i] * (1.0f - recovery) - of_raw * substep;
            grad_current[i] += of_raw * substep * gain;
        }
}

static void back_adex(const model *m, const float *current, float before[][ABREAST], const float *grad_sent,
                      float grad[][ABREAST], int64_t count, float *grad_current) {
    const adex *k = &m->of.adex;
    float v[MOST_SUBSTEPS + 1][ABREAST], raw[MOST_SUBSTEPS][ABREAST], slope[MOST_SUBSTEPS][ABREAST], w[ABREAST];
    float rest = (float)k->rest, leak = (float)k->leak, upstroke = (float)k->upstroke, a = (float)k->a;
    float gain = (float)k->input_gain, peak = (float)k->peak, charging = (float)k->charging;
    float recovery = (float)k->recovery, inverse_slope = (float)k->inverse_slope;
    memcpy(v[0], before[0], sizeof v[0]);
    memcpy(w, before[1], sizeof w);
    for (int64_t n = 0; n < k->substeps; n++)
        for (int64_t i = 0; i < count; i++) {
            float rising = exponential((v[n][i] - (float)k->threshold) * inverse_slope) * upstroke;
            float change = (rest - v[n][i]) * leak + rising;
            change = change - w[i] + current[i] * gain;
            slope[n][i] = rising * inverse_slope - leak;
            raw[n][i] = v[n][i] + change * charging;
            v[n + 1][i] = raw[n][i] > peak ? peak : raw[n][i];
            w[i] = w[i] + ((v[n + 1][i] - rest) * a - w[i]) * recovery;
        }
    back_through_reset(m, v[k->substeps], peak, (float)k->reset, (float)k->b, grad_sent, grad, count);
    for (int64_t i = 0; i < count; i++) grad_current[i] = 0;
    for (int64_t n = k->substeps - 1; n >= 0; n--)
        for (int64_t i = 0; i < count; i++) {
            float of_raw = grad[0][i] + grad[1][i] * recovery * a;
            of_raw = n == k->substeps - 1 || raw[n][i] <= peak ? of_raw : 0.0f;
            grad[0][i] = of_raw * (1.0f + charging * slope[n][i]);
            grad[1][i] = grad[1][i] * (1.0f - recovery) - of_raw * charging;
            grad_current[i] += of_raw * charging * gain;
        }
}

static void back_soft_unit(const model *m, const float *current, float before[][ABREAST], const float *grad_sent,
                           float grad[][ABREAST], int64_t count, float *grad_current) {
    const soft_unit *k = &m->of.soft_unit;
    float threshold = (float)k->threshold, decay = (float)k->decay, slope = (float)k->slope;
    for (int64_t i = 0; i < count; i++) {
        float was = before[0][i], sent_before = sigmoid((was - threshold) * slope);
        float now = was * decay * (1.0f - sent_before) + current[i], potential = now > 0 ? now : 0.0f;
        float sent = sigmoid((potential - threshold) * slope);
        float of_potential = grad[0][i] + grad_sent[i] * slope * sent * (1.0f - sent);
        grad_current[i] = now > 0 ? of_potential : 0.0f;
        grad[0][i] = grad_current[i] * decay * (1.0f - sent_before) * (1.0f - was * slope * sent_before);
    }
}

#endif
