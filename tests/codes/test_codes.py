"""What a user may rely on when a quantity travels as spikes."""

from collections.abc import Callable

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from neurorobo.codes import CoarseFine, Code, Poisson, PopulationNested, PopulationUniform, TimeToFirstSpike

DETERMINISTIC = [PopulationUniform, PopulationNested, TimeToFirstSpike]
deterministic = pytest.mark.parametrize("kind", DETERMINISTIC)
fractions = st.floats(0, 1)
neurons = st.integers(1, 30)
windows = st.integers(2, 60)


@st.composite
def ranges(draw: st.DrawFn) -> tuple[float, float]:
    """Any range that makes sense: of any sign, its width between a thousandth and ten thousand."""
    lo = draw(st.floats(-1e4, 1e4))
    return lo, lo + draw(st.floats(1e-3, 1e4))


def column(*values: float) -> Tensor:
    """One value per member of a batch, in double precision."""
    return torch.tensor(values, dtype=torch.float64).unsqueeze(1)


def there_and_back(code: Code, values: Tensor, steps: int) -> Tensor:
    return code.decode(code.encode(values, steps))


def sweep(code: Code) -> Tensor:
    """Values from one end of the range to the other."""
    return code.lo + torch.linspace(0, 1, 1001, dtype=torch.float64).unsqueeze(1) * (code.hi - code.lo)


def assert_monotone(code: Code, steps: int) -> None:
    rises = there_and_back(code, sweep(code), steps).flatten().diff()
    assert rises.min() >= -1e-12 * (abs(code.lo) + abs(code.hi))


@deterministic
@given(range_=ranges(), neurons=neurons, steps=windows, fraction=fractions)
def test_a_round_trip_loses_at_most_half_a_resolution(
    kind: Callable[..., Code], range_: tuple[float, float], neurons: int, steps: int, fraction: float
) -> None:
    lo, hi = range_
    code = kind(neurons, lo, hi)
    value = lo + fraction * (hi - lo)
    error = (there_and_back(code, column(value), steps) - value).abs().item()
    assert error <= code.resolution(steps) / 2 + 1e-12 * (abs(lo) + abs(hi))


@deterministic
@given(range_=ranges(), neurons=neurons, steps=windows)
def test_a_larger_value_never_reads_smaller(
    kind: Callable[..., Code], range_: tuple[float, float], neurons: int, steps: int
) -> None:
    assert_monotone(kind(neurons, *range_), steps)


@pytest.mark.parametrize("kind", [*DETERMINISTIC, Poisson])
@given(range_=ranges(), neurons=neurons, steps=windows, beyond=st.floats(0, 1e6))
def test_values_out_of_range_saturate_and_are_told(
    kind: Callable[..., Code], range_: tuple[float, float], neurons: int, steps: int, beyond: float
) -> None:
    lo, hi = range_
    code = kind(neurons, lo, hi)
    values = column(lo - beyond, lo, hi, hi + beyond)
    spikes = code.encode(values, steps, torch.Generator().manual_seed(0))
    assert torch.equal(spikes[:, 0], spikes[:, 1])
    assert torch.equal(spikes[:, 2], spikes[:, 3])
    assert code.decode(spikes)[[1, 2]].flatten().tolist() == pytest.approx([lo, hi], rel=1e-9, abs=1e-9)
    assert code.saturated(values).flatten().tolist() == [values[0] < lo, False, False, values[3] > hi]


@pytest.mark.parametrize("kind", [*DETERMINISTIC, Poisson])
def test_spikes_are_zeros_and_ones_of_the_stated_shape_and_the_values_type(kind: Callable[..., Code]) -> None:
    for dtype in (torch.float32, torch.float64):
        values = torch.rand(5, 3, generator=torch.Generator().manual_seed(0), dtype=dtype)
        code = kind(4, 0.0, 1.0)
        spikes = code.encode(values, 20, torch.Generator().manual_seed(1))
        assert spikes.shape == (20, 5, 12)
        assert spikes.dtype == dtype
        assert ((spikes == 0) | (spikes == 1)).all()
        assert code.decode(spikes).shape == (5, 3)


@deterministic
def test_each_component_has_neurons_of_its_own(kind: Callable[..., Code]) -> None:
    code = kind(4, -1.0, 1.0)
    values = torch.tensor([[-0.7, 0.1, 0.9], [0.3, -0.2, -1.0]])
    alone = [code.encode(values[:, i : i + 1], 20) for i in range(3)]
    assert torch.equal(code.encode(values, 20), torch.cat(alone, dim=-1))


def test_each_component_of_a_poisson_code_has_neurons_of_its_own() -> None:
    spikes = Poisson(3, 0.0, 1.0).encode(torch.tensor([[0.0, 1.0]]), 20, torch.Generator().manual_seed(0))
    assert spikes.mean((0, 1)).tolist() == [0, 0, 0, 1, 1, 1]


@given(neurons=neurons, steps=windows, fraction=fractions)
def test_population_uniform_spreads_the_spikes_evenly_over_the_neurons(
    neurons: int, steps: int, fraction: float
) -> None:
    spikes = PopulationUniform(neurons, 0.0, 1.0).encode(column(fraction), steps)[:, 0]
    counts = spikes.sum(0)
    assert spikes.sum() == round(fraction * neurons * steps)
    assert counts.max() - counts.min() <= 1


@given(neurons=neurons, steps=windows, fraction=fractions)
def test_population_uniform_fires_each_neuron_at_even_intervals(neurons: int, steps: int, fraction: float) -> None:
    spikes = PopulationUniform(neurons, 0.0, 1.0).encode(column(fraction), steps)[:, 0]
    intervals = torch.cat([train.nonzero().flatten().diff() for train in spikes.T])
    assert len(intervals) == 0 or intervals.max() - intervals.min() <= 1


@given(neurons=neurons, steps=windows, fraction=fractions)
def test_population_uniform_spreads_the_spikes_evenly_over_the_steps(neurons: int, steps: int, fraction: float) -> None:
    together = PopulationUniform(neurons, 0.0, 1.0).encode(column(fraction), steps).sum((1, 2))
    assert together.max() - together.min() <= 1


@given(neurons=neurons, steps=windows)
def test_population_nested_adds_one_spike_at_a_time_to_the_neurons_in_turn(neurons: int, steps: int) -> None:
    count = neurons * steps
    spikes = PopulationNested(neurons, 0.0, count).encode(column(*range(count + 1)), steps).movedim(1, 0)
    assert spikes.sum((1, 2)).tolist() == list(range(count + 1))
    assert (spikes.diff(dim=0) >= 0).all()
    per_neuron = spikes.sum(1)
    assert (per_neuron.amax(1) - per_neuron.amin(1)).max() <= 1


@given(neurons=neurons, steps=windows, fraction=fractions)
def test_population_nested_leaves_no_neuron_silent_for_long(neurons: int, steps: int, fraction: float) -> None:
    spikes = PopulationNested(neurons, 0.0, 1.0).encode(column(fraction), steps)[:, 0]
    for train in spikes.T:
        fired = train.nonzero().flatten()
        if len(fired):
            gaps = torch.cat([fired, fired[:1] + steps]).diff()
            assert gaps.max() <= 4 * steps / len(fired)


def test_fewer_steps_of_population_nested_are_alike() -> None:
    def kinds(kind: Callable[..., Code]) -> int:
        return len(kind(18, 0.0, 1.0).encode(column(0.8), 50)[:, 0].unique(dim=0))

    assert (kinds(PopulationUniform), kinds(PopulationNested)) == (5, 36)


def test_the_papers_example_resolves_a_tenth_of_a_micrometre() -> None:
    position = PopulationUniform(200, -500.0, 500.0)  # um; 50 steps
    assert position.resolution(50) == pytest.approx(0.1)
    assert position.encode(column(500.0), 50).sum() == 10_000


@given(neurons=neurons, steps=windows, fraction=fractions)
def test_time_to_first_spike_fires_each_neuron_once_and_all_within_a_step(
    neurons: int, steps: int, fraction: float
) -> None:
    spikes = TimeToFirstSpike(neurons, 0.0, 1.0).encode(column(fraction), steps)[:, 0]
    assert spikes.sum(0).tolist() == [1.0] * neurons
    latencies = spikes.argmax(0)
    assert latencies.max() - latencies.min() <= 1


def test_time_to_first_spike_fires_the_sooner_the_larger_the_value() -> None:
    spikes = TimeToFirstSpike(1, 0.0, 4.0).encode(column(4, 3, 2, 1, 0), 5)
    assert spikes.argmax(0).flatten().tolist() == [0, 1, 2, 3, 4]


def test_a_neuron_that_stays_silent_counts_as_firing_last() -> None:
    code = TimeToFirstSpike(3, 0.0, 1.0)
    late = code.encode(column(0.0), 10)
    assert torch.equal(code.decode(torch.zeros_like(late)), code.decode(late))


@pytest.mark.parametrize("probability", [0.0, 0.03, 0.5, 0.8, 1.0])
def test_poisson_is_unbiased_with_the_stated_variance(probability: float) -> None:
    """Both within five standard deviations of their estimates from 4000 windows."""
    lo, hi, neurons, steps, samples = -3.0, 5.0, 6, 20, 4000
    code = Poisson(neurons, lo, hi)
    value = lo + probability * (hi - lo)
    generator = torch.Generator().manual_seed(11)
    decoded = code.decode(code.encode(column(value).expand(samples, 1), steps, generator)).flatten()

    n, pq = neurons * steps, probability * (1 - probability)
    variance = n * pq * code.resolution(steps) ** 2
    fourth_moment = n * pq * (1 + 3 * (n - 2) * pq) * code.resolution(steps) ** 4  # of the binomial distribution
    spread_of_variance = ((fourth_moment - variance**2 * (samples - 3) / (samples - 1)) / samples) ** 0.5
    assert abs(decoded.mean() - value) <= 5 * (variance / samples) ** 0.5 + 1e-12
    assert abs(decoded.var() - variance) <= 5 * spread_of_variance + 1e-12


def test_poisson_draws_from_the_generator_it_is_given_and_from_no_other() -> None:
    code, values = Poisson(5, 0.0, 1.0), torch.full((2, 1), 0.5)
    one, same, other = (code.encode(values, 30, torch.Generator().manual_seed(seed)) for seed in (1, 1, 2))
    assert torch.equal(one, same)
    assert not torch.equal(one, other)
    with pytest.raises(ValueError, match="needs a random generator"):
        code.encode(values, 30)


def test_decoding_a_count_is_differentiable() -> None:
    code = PopulationUniform(4, -1.0, 1.0)
    spikes = code.encode(torch.tensor([[0.3, 0.8]]), 10).requires_grad_()
    code.decode(spikes)[0, 1].backward()
    assert spikes.grad is not None
    assert torch.equal(spikes.grad[:, :, :4], torch.zeros(10, 1, 4))
    assert spikes.grad[:, :, 4:].flatten().tolist() == pytest.approx([code.resolution(10)] * 40)


@st.composite
def coarse_and_fine(draw: st.DrawFn) -> CoarseFine:
    """A coarse code and a fine one over a part of its range, which may share an end with it."""
    lo, hi = draw(ranges())
    first, last = sorted(draw(st.lists(st.integers(0, 10), min_size=2, max_size=2, unique=True)))
    part = [hi if tenth == 10 else lo + tenth / 10 * (hi - lo) for tenth in (first, last)]
    return CoarseFine.of(PopulationUniform(draw(neurons), lo, hi), PopulationUniform(draw(neurons), *part))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@given(code=coarse_and_fine(), steps=windows)
def test_coarse_fine_reads_finely_inside_the_fine_range_and_coarsely_elsewhere(
    dtype: torch.dtype, code: CoarseFine, steps: int
) -> None:
    values = sweep(code).to(dtype)
    error = (there_and_back(code, values, steps) - values).abs()
    fine, coarse = code.fine.resolution(steps), code.coarse.resolution(steps)
    inside = (values > code.fine.lo + 0.51 * fine) & (values < code.fine.hi - 0.51 * fine)
    rounding = 4 * torch.finfo(dtype).eps * (abs(code.lo) + abs(code.hi))
    assert (error[inside] <= fine / 2 + rounding).all()
    assert (error <= max(fine, coarse) / 2 + rounding).all()


@given(code=coarse_and_fine(), steps=windows)
def test_coarse_fine_never_reads_a_larger_value_smaller(code: CoarseFine, steps: int) -> None:
    assert_monotone(code, steps)


def test_coarse_fine_lays_the_coarse_neurons_of_a_component_before_its_fine_ones() -> None:
    coarse, fine = PopulationUniform(3, 0.0, 100.0), TimeToFirstSpike(2, 0.0, 10.0)
    code = CoarseFine.of(coarse, fine)
    values = torch.tensor([[5.0, 60.0]])
    parts = [part.encode(values[:, i : i + 1], 20) for i in range(2) for part in (coarse, fine)]
    assert code.neurons == 5
    assert torch.equal(code.encode(values, 20), torch.cat(parts, dim=-1))


def test_coarse_fine_is_stochastic_if_a_part_is() -> None:
    regular, random = PopulationUniform(2, 0.0, 1.0), Poisson(2, 0.0, 1.0)
    assert [CoarseFine.of(a, b).stochastic for a, b in [(regular, regular), (regular, random), (random, regular)]] == [
        False,
        True,
        True,
    ]


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: PopulationUniform(0, 0.0, 1.0), "at least one neuron"),
        (lambda: Poisson(3, 1.0, 1.0), "a range that rises"),
        (lambda: PopulationUniform(3, 0.0, float("nan")), "a range that rises"),
        (lambda: TimeToFirstSpike(3, 0.0, 1.0).resolution(1), "at least two steps"),
        (
            lambda: CoarseFine.of(PopulationUniform(3, 0.0, 1.0), PopulationUniform(3, 0.5, 1.5)),
            "must lie within the coarse 0.0..1.0",
        ),
    ],
)
def test_codes_that_make_no_sense_are_refused(build: Callable[[], object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        build()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("code", [PopulationUniform(3, -2.0, 5.0), TimeToFirstSpike(3, -2.0, 5.0)])
def test_a_value_that_is_not_finite_is_refused(code: Code, value: float) -> None:
    with pytest.raises(ValueError, match=r"not finite cannot be encoded over -2\.\.5"):
        code.encode(torch.tensor([[0.0, value]]), 10)


@pytest.mark.parametrize("kind", [PopulationUniform, TimeToFirstSpike, Poisson])
def test_spikes_are_where_the_values_are(kind: Callable[..., Code]) -> None:
    code = kind(3, 0.0, 1.0)
    expected = code.encode(column(0.3, 0.8), 20, torch.Generator().manual_seed(1))
    with torch.device("meta"):  # where tensors go that are not told where to go
        values = torch.tensor([[0.3], [0.8]], dtype=torch.float64, device="cpu")
        assert torch.equal(code.encode(values, 20, torch.Generator("cpu").manual_seed(1)), expected)


@pytest.mark.parametrize("kind", [PopulationUniform, TimeToFirstSpike, Poisson])
def test_a_code_knows_whether_gradients_flow_through_what_it_decodes(kind: Callable[..., Code]) -> None:
    code, other = kind(3, 0.0, 1.0), PopulationUniform(2, 0.4, 0.6)
    spikes = torch.zeros(20, 1, 3, requires_grad=True)
    assert code.decode(spikes).requires_grad == code.differentiable
    both = CoarseFine.of(code, other)
    assert both.differentiable == code.differentiable


@pytest.mark.parametrize(
    "code",
    [
        *(kind(4, 0, 1) for kind in DETERMINISTIC),
        CoarseFine.of(PopulationUniform(4, 0, 1), PopulationNested(3, 0, 0.5)),
    ],
    ids=lambda code: type(code).__name__,
)
@pytest.mark.parametrize("shape", [(0, 2), (2, 0)], ids=str)
def test_nothing_comes_back_as_nothing(code: Code, shape: tuple[int, int]) -> None:
    assert there_and_back(code, torch.zeros(shape), 5).shape == shape
