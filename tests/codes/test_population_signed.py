"""What a user may rely on when a signed quantity travels in ON and OFF neurons, and what is sigma-delta about it."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from neurorobo.codes import PopulationUniform
from neurorobo.codes.population_signed import PopulationSigned
from neurorobo.config.plugged_reader import read_plugged
from neurorobo.errors import ConfigError
from neurorobo.plugins import Registry

half = st.integers(1, 15)
windows = st.integers(1, 60)
ends = st.floats(1e-3, 1e4)
places = st.floats(-1, 1)


def column(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64).unsqueeze(1)


def sigma_delta(value: int, steps: int) -> list[int]:
    """A modulator of first order with the levels -1, 0 and 1, of ``value`` in steps of 1/steps."""
    integrator, said = 0, []
    for _ in range(steps):
        integrator += value
        said.append((integrator >= steps) - (integrator <= -steps))
        integrator -= steps * said[-1]
    return said


@given(half=half, hi=ends, steps=windows, place=places)
def test_a_round_trip_loses_at_most_half_a_resolution(half: int, hi: float, steps: int, place: float) -> None:
    code = PopulationSigned(2 * half, -hi, hi)
    error = (code.decode(code.encode(column(place * hi), steps)) - place * hi).abs().item()
    assert error <= code.resolution(steps) / 2 + 1e-12 * hi


@given(half=half, hi=ends, steps=windows)
def test_it_resolves_as_finely_as_population_uniform_of_as_many_neurons(half: int, hi: float, steps: int) -> None:
    uniform = PopulationUniform(2 * half, -hi, hi).resolution(steps)
    assert PopulationSigned(2 * half, -hi, hi).resolution(steps) == pytest.approx(uniform)


@given(half=half, hi=ends, steps=windows, place=places)
def test_the_sign_tells_who_fires_and_the_magnitude_how_often(half: int, hi: float, steps: int, place: float) -> None:
    code = PopulationSigned(2 * half, -hi, hi)
    spikes = code.encode(column(place * hi, -place * hi), steps)
    on, off = spikes[..., :half], spikes[..., half:]
    assert torch.equal(on[:, 0], off[:, 1])
    assert torch.equal(off[:, 0], on[:, 1])
    assert (off if place > 0 else on)[:, 0].sum() == 0
    count = spikes[:, 0].sum().item()
    assert abs(count - abs(place) * half * steps) <= 0.5 + 1e-9


@given(half=half, hi=ends, steps=windows, beyond=st.floats(0, 1e6))
def test_values_out_of_range_saturate_and_are_told(half: int, hi: float, steps: int, beyond: float) -> None:
    code = PopulationSigned(2 * half, -hi, hi)
    values = column(-hi - beyond, -hi, hi, hi + beyond)
    assert code.decode(code.encode(values, steps)).flatten().tolist() == pytest.approx([-hi, -hi, hi, hi])
    assert code.saturated(values).flatten().tolist() == [values[0] < -hi, False, False, values[3] > hi]


def test_zero_is_silent_and_silence_is_exactly_zero() -> None:
    code = PopulationSigned(6, -3.0, 3.0)
    assert code.encode(torch.zeros(2, 3), 25).sum() == 0
    assert torch.equal(code.decode(torch.zeros(25, 2, 18)), torch.zeros(2, 3))


@given(steps=windows, data=st.data())
def test_one_neuron_each_is_a_sigma_delta_modulator(steps: int, data: st.DataObject) -> None:
    value = data.draw(st.integers(-steps, steps))
    on, off = PopulationSigned(2, -1.0, 1.0).encode(column(value / steps), steps)[:, 0].t()
    assert (on - off).tolist() == sigma_delta(value, steps)


@given(steps=windows, data=st.data())
def test_population_uniform_of_one_neuron_is_a_sigma_delta_modulator(steps: int, data: st.DataObject) -> None:
    value = data.draw(st.integers(0, steps))
    spikes = PopulationUniform(1, 0.0, 1.0).encode(column(value / steps), steps).flatten()
    assert spikes.tolist() == sigma_delta(value, steps)


def test_decoding_is_differentiable_with_opposite_signs() -> None:
    code = PopulationSigned(4, -1.0, 1.0)
    spikes = code.encode(torch.tensor([[0.3, -0.8]]), 10).requires_grad_()
    code.decode(spikes)[0, 1].backward()
    assert spikes.grad is not None
    assert spikes.grad[0, 0].tolist() == pytest.approx([0, 0, 0, 0, 0.05, 0.05, -0.05, -0.05])


@pytest.mark.parametrize(
    ("neurons", "lo", "hi", "words"),
    [
        (4, 0.0, 100.0, r"zero in its middle \(got 0..100\); give it -100..100, or take population_uni"),
        (4, -5.0, 3.0, r"give it -5..5"),
        (4, 2.0, -2.0, "a range that rises"),
        (5, -1.0, 1.0, r"an even number \(got 5\)"),
        (0, -1.0, 1.0, "at least one neuron"),
    ],
)
def test_what_makes_no_sense_is_refused_with_the_cure(neurons: int, lo: float, hi: float, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        PopulationSigned(neurons, lo, hi)


def test_a_value_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="not finite cannot be encoded"):
        PopulationSigned(4, -1.0, 1.0).encode(torch.tensor([[float("nan")]]), 10)


def test_a_file_can_name_it_and_odd_populations_are_refused() -> None:
    config = read_plugged("code", {"type": "population_signed", "neurons": 12}, Registry.discover())
    assert config.build(-9.0, 9.0) == PopulationSigned(12, -9.0, 9.0)  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match="multiple of 2"):
        read_plugged("code", {"type": "population_signed", "neurons": 5}, Registry.discover())
