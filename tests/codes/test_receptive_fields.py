"""What a user may rely on when a quantity travels as Gaussian receptive fields."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from neurorobo.codes import GaussianReceptiveFields
from neurorobo.codes.receptive_fields import LEAST_NEURONS
from neurorobo.config.plugged_reader import read_plugged
from neurorobo.errors import ConfigError
from neurorobo.plugins import Registry

neurons = st.integers(LEAST_NEURONS, 40)
windows = st.integers(2, 60)
widths = st.floats(1e-3, 1e4)


def sweep(code: GaussianReceptiveFields) -> Tensor:
    """Values from one end of the range to the other."""
    return code.lo + torch.linspace(0, 1, 1001, dtype=torch.float64).unsqueeze(1) * (code.hi - code.lo)


@given(lo=st.floats(-1e4, 1e4), width=widths, neurons=neurons, steps=windows)
def test_a_round_trip_loses_at_most_half_a_resolution(lo: float, width: float, neurons: int, steps: int) -> None:
    code = GaussianReceptiveFields(neurons, lo, lo + width)
    values = sweep(code)
    error = (code.decode(code.encode(values, steps)) - values).abs().max()
    assert error <= code.resolution(steps) / 2 * (1 + 1e-9) + 1e-12 * (abs(code.lo) + abs(code.hi))


def test_the_stated_resolution_is_no_more_than_twice_what_is_reached() -> None:
    code = GaussianReceptiveFields(50, 0.0, 100.0)
    values = sweep(code)
    error = (code.decode(code.encode(values, 50)) - values).abs().max()
    assert code.resolution(50) / 2 < 2 * error


@pytest.mark.parametrize(("few", "many"), [((10, 50), (20, 50)), ((10, 50), (10, 100))])
def test_more_neurons_and_longer_windows_resolve_more(few: tuple[int, int], many: tuple[int, int]) -> None:
    coarse, fine = (GaussianReceptiveFields(size, 0.0, 1.0).resolution(steps) for size, steps in (few, many))
    assert fine < coarse


@given(neurons=neurons, steps=windows, fraction=st.floats(0, 1))
def test_the_neuron_nearest_to_the_value_fires_most(neurons: int, steps: int, fraction: float) -> None:
    code = GaussianReceptiveFields(neurons, 0.0, 1.0)
    counts = code.encode(torch.tensor([[fraction]], dtype=torch.float64), steps).sum(0)[0]
    centres = (torch.arange(neurons) - 2) * code.spacing
    assert counts[(centres - fraction).abs().argmin()] == counts.max()


@given(neurons=neurons, steps=windows, beyond=st.floats(0, 1e6))
def test_values_out_of_range_saturate_and_are_told(neurons: int, steps: int, beyond: float) -> None:
    code = GaussianReceptiveFields(neurons, -1.0, 2.0)
    values = torch.tensor([[-1.0 - beyond], [-1.0], [2.0], [2.0 + beyond]], dtype=torch.float64)
    spikes = code.encode(values, steps)
    assert torch.equal(spikes[:, 0], spikes[:, 1])
    assert torch.equal(spikes[:, 2], spikes[:, 3])
    assert code.saturated(values).flatten().tolist() == [values[0] < -1, False, False, values[3] > 2]


def test_spikes_are_zeros_and_ones_of_the_stated_shape_and_each_component_has_neurons_of_its_own() -> None:
    for dtype in (torch.float32, torch.float64):
        values = torch.rand(5, 3, generator=torch.Generator().manual_seed(0), dtype=dtype)
        code = GaussianReceptiveFields(7, 0.0, 1.0)
        spikes = code.encode(values, 20)
        assert spikes.shape == (20, 5, 21)
        assert spikes.dtype == dtype
        assert ((spikes == 0) | (spikes == 1)).all()
        assert code.decode(spikes).shape == (5, 3)
        alone = [code.encode(values[:, i : i + 1], 20) for i in range(3)]
        assert torch.equal(spikes, torch.cat(alone, dim=-1))


def test_silence_reads_as_the_middle_of_the_range() -> None:
    assert GaussianReceptiveFields(8, -1.0, 5.0).decode(torch.zeros(10, 1, 8)).item() == pytest.approx(2.0)


def test_decoding_is_differentiable_also_where_nothing_fires() -> None:
    code = GaussianReceptiveFields(6, 0.0, 1.0)
    for spikes in (torch.zeros(10, 1, 6), code.encode(torch.tensor([[0.4]]), 10)):
        spikes.requires_grad_()
        code.decode(spikes).sum().backward()
        assert spikes.grad is not None
        assert spikes.grad.isfinite().all()
    assert spikes.grad.abs().max() > 0


def test_a_file_can_name_it() -> None:
    config = read_plugged("code", {"type": "gaussian_receptive_fields", "neurons": 12}, Registry.discover())
    assert config.build(0.0, 9.0) == GaussianReceptiveFields(12, 0.0, 9.0)  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match="greater than or equal to 6"):
        read_plugged("code", {"type": "gaussian_receptive_fields", "neurons": 5}, Registry.discover())


def test_too_few_neurons_are_refused() -> None:
    with pytest.raises(ValueError, match="need 6 neurons or more"):
        GaussianReceptiveFields(5, 0.0, 1.0)
