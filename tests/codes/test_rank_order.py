"""What a user may rely on when a quantity travels as the order in which neurons fire."""

from itertools import pairwise

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.codes.rank_order import RankOrder
from neurorobo.config.plugged_reader import read_plugged
from neurorobo.errors import ConfigError, NeuroroboError
from neurorobo.plugins import Registry
from neurorobo.regions import RegionConfig
from neurorobo.regions.config import checked_ports

neurons = st.integers(2, 25)
extra_steps = st.integers(0, 30)
fractions = st.floats(0, 1)


def column(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64).unsqueeze(1)


def order(spikes: Tensor) -> list[int]:
    """The neurons of one component in the order in which they fire."""
    return spikes[:, 0].argmax(0).argsort().tolist()  # type: ignore[no-any-return]


def every_value(code: RankOrder) -> Tensor:
    """Each value that the code can say, in double precision."""
    return column(*(code.lo + (code.hi - code.lo) * k / code.pairs for k in range(code.pairs + 1)))


@given(
    lo=st.floats(-1e4, 1e4), width=st.floats(1e-3, 1e4), neurons=neurons, extra_steps=extra_steps, fraction=fractions
)
def test_a_round_trip_loses_at_most_half_a_resolution(
    lo: float, width: float, neurons: int, extra_steps: int, fraction: float
) -> None:
    code, steps = RankOrder(neurons, lo, lo + width), neurons + extra_steps
    value = code.lo + fraction * (code.hi - code.lo)
    error = (code.decode(code.encode(column(value), steps)) - value).abs().item()
    assert error <= code.resolution(steps) / 2 + 1e-12 * (abs(code.lo) + abs(code.hi))


@given(neurons=neurons, extra_steps=extra_steps)
def test_all_values_a_resolution_apart_are_told_apart_from_end_to_end(neurons: int, extra_steps: int) -> None:
    code, steps = RankOrder(neurons, -2.0, 3.0), neurons + extra_steps
    said = code.decode(code.encode(every_value(code), steps))
    torch.testing.assert_close(said, every_value(code))
    assert said.diff(dim=0).min() > 0.99 * code.resolution(steps)


@given(neurons=neurons)
def test_the_next_value_exchanges_two_neurons_that_fire_one_after_the_other(neurons: int) -> None:
    code = RankOrder(neurons, 0.0, 1.0)
    orders = [order(code.encode(value.view(1, 1), neurons)) for value in every_value(code)]
    assert orders[0] == list(range(neurons))
    assert orders[-1] == list(reversed(range(neurons)))
    for one, other in pairwise(orders):
        first, second = (place for place in range(neurons) if one[place] != other[place])
        assert second == first + 1
        assert (one[first], one[second]) == (other[second], other[first])


@given(neurons=neurons, data=st.data())
def test_two_neurons_in_the_wrong_order_cost_one_resolution(neurons: int, data: st.DataObject) -> None:
    code = RankOrder(neurons, 0.0, 7.0)
    spikes = code.encode(column(data.draw(st.floats(0, 7))), neurons)
    place = data.draw(st.integers(0, neurons - 2))
    exchanged = [*range(place), place + 1, place, *range(place + 2, neurons)]
    assert (code.decode(spikes[exchanged]) - code.decode(spikes)).abs().item() == pytest.approx(
        code.resolution(neurons)
    )


@given(neurons=neurons, fraction=fractions, data=st.data())
def test_a_delay_and_any_stretch_of_time_change_nothing(neurons: int, fraction: float, data: st.DataObject) -> None:
    code = RankOrder(neurons, 0.0, 1.0)
    spikes = code.encode(column(fraction), neurons)
    steps = sorted(data.draw(st.sets(st.integers(0, 200), min_size=neurons, max_size=neurons)))
    stretched = torch.zeros(201, *spikes.shape[1:], dtype=spikes.dtype)
    stretched[steps] = spikes
    assert torch.equal(code.decode(stretched) - code.lo, code.decode(spikes) - code.lo)


@given(neurons=neurons)
def test_each_neuron_is_the_first_over_a_part_of_the_range_of_its_own(neurons: int) -> None:
    code = RankOrder(neurons, 0.0, 1.0)
    firsts = [order(code.encode(value.view(1, 1), neurons))[0] for value in every_value(code)]
    assert sorted(firsts) == firsts
    assert set(firsts) == set(range(neurons))


@given(neurons=neurons, extra_steps=extra_steps, beyond=st.floats(0, 1e6))
def test_values_out_of_range_saturate_and_are_told(neurons: int, extra_steps: int, beyond: float) -> None:
    code = RankOrder(neurons, -1.0, 2.0)
    values = column(-1.0 - beyond, -1.0, 2.0, 2.0 + beyond)
    spikes = code.encode(values, neurons + extra_steps)
    assert code.decode(spikes).flatten().tolist() == pytest.approx([-1, -1, 2, 2])
    assert code.saturated(values).flatten().tolist() == [values[0] < -1, False, False, values[3] > 2]


@given(neurons=neurons, extra_steps=extra_steps, fraction=fractions)
def test_each_neuron_fires_once_and_no_two_together(neurons: int, extra_steps: int, fraction: float) -> None:
    spikes = RankOrder(neurons, 0.0, 1.0).encode(column(fraction), neurons + extra_steps)[:, 0]
    assert spikes.sum(0).tolist() == [1.0] * neurons
    assert spikes.sum(1).max() == 1


def test_silence_and_a_volley_read_as_the_middle_of_the_range() -> None:
    code = RankOrder(5, 0.0, 6.0)
    volley = torch.zeros(8, 1, 5)
    volley[3] = 1
    assert code.decode(torch.zeros(8, 1, 5)).item() == code.decode(volley).item() == 3.0


def test_a_neuron_that_is_lost_counts_as_the_last() -> None:
    code = RankOrder(5, 0.0, 1.0)
    spikes = code.encode(column(0.0), 8)
    lost = spikes.clone()
    lost[:, :, 4] = 0
    assert torch.equal(code.decode(lost), code.decode(spikes))


def test_an_order_that_does_not_fit_into_the_window_is_refused_with_the_cure() -> None:
    code = RankOrder(10, 0.0, 1.0)
    spikes = code.encode(column(0.3), 10)
    with pytest.raises(NeuroroboError, match=r"10 neurons does not fit into a window of 9 steps; give .* fewer"):
        code.encode(column(0.3), 9)
    with pytest.raises(NeuroroboError, match="does not fit"):
        code.decode(spikes[:9])


def test_a_region_whose_window_is_too_short_for_it_is_refused_before_anything_is_built() -> None:
    port = {"unit": "um", "range": "0..9 um", "code": {"type": "rank_order", "neurons": 10}}
    config = read_plugged(
        "region",
        {"type": "feedforward", "inputs": {"place": port}, "outputs": {"said": port}, "hidden": [4]},
        Registry.discover(),
    )
    assert isinstance(config, RegionConfig)
    checked_ports(config, Clock({"control": 1_000_000_000}, 1_000_000, 10))
    with pytest.raises(ConfigError, match=r"`place`: .* does not fit into a window of 9 steps; .* under `time`"):
        checked_ports(config, Clock({"control": 1_000_000_000}, 1_000_000, 9))


def test_a_file_can_name_it_and_one_neuron_is_refused() -> None:
    config = read_plugged("code", {"type": "rank_order", "neurons": 12}, Registry.discover())
    assert config.build(0.0, 9.0) == RankOrder(12, 0.0, 9.0)  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match="greater than or equal to 2"):
        read_plugged("code", {"type": "rank_order", "neurons": 1}, Registry.discover())
    with pytest.raises(ValueError, match="needs 2 neurons or more"):
        RankOrder(1, 0.0, 1.0)


def test_nothing_can_be_learned_through_it() -> None:
    assert not RankOrder(3, 0.0, 1.0).differentiable
