"""What is counted, by hand; and what is not is said."""

from typing import Any

import pytest
import torch
from precision_interaction.regions.adaptive_cerebellum import AdaptiveCerebellum
from precision_interaction.regions.adaptive_cerebellum_config import AdaptiveCerebellumConfig
from precision_interaction.regions.adaptive_hippocampus import AdaptiveHippocampus
from precision_interaction.regions.adaptive_hippocampus_config import AdaptiveHippocampusConfig
from samples import network, spikes
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.measures import Size, Work, WorkMeter, size_of
from neurorobo.regions.region import Region, State
from tests.measures.toys import Analogue
from tests.regions.toys import CLOCK, Net, NetConfig

RIG = Clock({"control": 10**9, "radial": 10**9}, 10**6, 10)


def count(region: Region, inputs: dict[str, Tensor], state: State | None = None) -> tuple[Work, WorkMeter]:
    """Run one window, and count it."""
    meter = WorkMeter(region)
    batch = next(iter(inputs.values())).shape[1]
    with meter.watching(), torch.inference_mode():
        region.step(inputs, region.init_state(batch) if state is None else state, meter.hear)
    return meter.take(batch, inputs), meter


def test_a_window_counted_by_hand() -> None:
    """Three steps of 20 channels; every neuron of the first layer fires in every step, of the second only the first."""
    layers: dict[str, Any] = {
        "hidden": {"neurons": 4, "reads": ["inputs"], "bias": True, "recurrent": True},
        "output": {"neurons": 10, "reads": ["hidden"]},
    }
    region = network(layers, seed=0)
    weights = {name: parameter for name, parameter in region.named_parameters()}
    with torch.no_grad():
        for weight in weights.values():
            weight.zero_()
        first, bias, recurrent, second = weights.values()
        first[:, 0] = 0.25
        bias[:] = 0.5
        recurrent[0, 1:] = 0.125
        second[0] = 1.0
    inputs = torch.zeros(3, 2, 20)
    inputs[0, 0, :2] = 1.0  # the second channel has no synapse
    work, meter = count(region, {"x": inputs})
    assert work == Work(
        windows=2,
        activations=3 * 2 * 14,
        spikes=3 * 2 * 5,
        effective_acs=4 + 2 * 2 * 3 + 3 * 2 * 4,
        dense=3 * 2 * (20 * 4 + 4 * 4 + 4 * 10),
    )
    assert size_of(region) == Size(
        parameter_count=80 + 4 + 16 + 40, footprint=4 * 140, weights=80 + 16 + 40, zeros=136 - (4 + 3 + 4)
    )
    assert meter.not_counted() == []


@pytest.mark.parametrize(
    "neuron", [{"type": "lif"}, {"type": "snntorch_neuron", "alpha": 0.5, "beta": 0.5, "class": "Synaptic"}]
)
def test_recurrent_synapses_are_given_the_spikes_of_the_step_before(neuron: dict[str, Any]) -> None:
    """Of the window before, in its first step; of none, from rest, with a state or without."""
    layers: dict[str, Any] = {
        "hidden": {"neurons": 30, "reads": ["inputs"], "recurrent": True, "neuron": neuron},
        "output": {"neurons": 10, "reads": ["hidden"]},
    }
    region = network(layers, seed=0)
    inputs = spikes(region, 20, 2, seed=1)
    whole, _ = count(region, {"x": inputs})
    without_state, _ = count(region, {"x": inputs}, {})
    assert without_state == whole
    meter, state = WorkMeter(region), region.init_state(2)
    with meter.watching(), torch.inference_mode():
        for piece in inputs.split(5):
            _, state = region.step({"x": piece}, state)
    assert meter.take(2, {}) == whole
    fired = []
    with torch.inference_mode():
        region.step({"x": inputs}, region.init_state(2), lambda name, trains: fired.append(trains))
    hidden = fired[0]
    assert hidden[-1].any()
    assert whole.effective_acs == inputs.sum() * 30 + hidden[:-1].sum() * 30 + hidden.sum() * 10


def test_a_matrix_of_numbers_multiplies_and_what_is_no_matrix_is_named() -> None:
    region = Analogue()
    work, meter = count(region, {"x": torch.tensor([[1.5, 0.0, -1.0]])})
    assert (work.effective_macs, work.effective_acs, work.dense) == (3, 0, 6)
    assert work.activation_sparsity is None
    assert size_of(region) == Size(parameter_count=10, footprint=40, weights=6, zeros=1)
    assert meter.not_counted() == ["scale"]


def test_a_region_that_is_not_watched_runs_as_it_did() -> None:
    region = Net(NetConfig(), CLOCK, torch.Generator().manual_seed(0))
    inputs = {"force": (torch.rand(20, 3, 12, generator=torch.Generator().manual_seed(0)) < 0.5).float()}
    meter = WorkMeter(region)
    with torch.inference_mode():
        before, _ = region.step(inputs, region.init_state(3))
        with meter.watching():
            during, _ = region.step(inputs, region.init_state(3))
        counted = meter.take(3, inputs)
        after, _ = region.step(inputs, region.init_state(3))
    assert torch.equal(before["move"], during["move"])
    assert torch.equal(before["move"], after["move"])
    assert counted.dense > 0
    assert meter.take(3, inputs) == Work(windows=3)


def spikes_of(region: Region) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(1)
    return {
        name: torch.zeros(2, port.width)
        if port.code is None
        else (torch.rand(10, 2, port.channels, generator=generator) < 0.4).float()
        for name, port in region.input_ports.items()
    }


def test_a_layer_that_is_driven_counts_as_any_other() -> None:
    """Learned synapses that are too weak to matter let it take the other way, to the same spikes."""
    sizes = {"granule_cells": 100, "purkinje_cells": 40}
    found = []
    for rate in (0.0, 0.0024):
        config = AdaptiveCerebellumConfig.model_validate({**sizes, "learning_rate": rate})
        region = AdaptiveCerebellum(config, RIG, torch.Generator().manual_seed(1))
        state = region.init_state(2)
        state["synapses"] += 1e-9
        inputs = spikes_of(region)
        found.append(count(region, inputs, state))
    (plain, _), (driven, meter) = found
    assert driven == plain
    assert driven.dense == 10 * 2 * (64 * 100 + 100 * 40 + (40 + 64) * 8 + 8 * 40)
    assert meter.not_counted() == ["synapses that change as it runs"]


def test_a_layer_that_nobody_saw_is_named() -> None:
    """The output of this hippocampus runs apart from the engine, and is part of no circuit."""
    region = AdaptiveHippocampus(AdaptiveHippocampusConfig(hidden_neurons=20), RIG, torch.Generator().manual_seed(1))
    work, meter = count(region, spikes_of(region))
    sources = sum(port.channels for port in region.input_ports.values() if port.code is not None)
    assert work.dense == 10 * 2 * (sources + 20) * 20
    assert meter.not_counted() == ["the layer output, which was not seen to run", "synapses that change as it runs"]


def test_sizes_and_work_add_up() -> None:
    assert Size(1, 2, 3, 4) + Size(10, 20, 30, 40) == Size(11, 22, 33, 44)
    assert Work(1, 2, 3, 4, 5, 6) + Work(10, 20, 30, 40, 50, 60) == Work(11, 22, 33, 44, 55, 66)
    assert Work().activation_sparsity is None
    assert Size().connection_sparsity is None
