"""Fig. 7: how fast the regions fire, what that costs, and what a network that does not spike would cost."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch

from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.weights import weights_file
from neurorobo.graph.brain import Brain
from neurorobo.regions.region import Region
from neurorobo.tasks.supervised import SupervisedTask
from precision_interaction.reproduce.operations import (
    Array,
    Listener,
    Synapses,
    Window,
    circuit_of,
    synapses,
)
from precision_interaction.reproduce.row import Result, Row, Setting

if TYPE_CHECKING:
    pass

EXAMPLE = "peg_in_hole.yaml"
INSERTIONS, REST = "insertions", "at rest"
REGIONS = {"hippocampus": "0.26 ± 0.08", "cerebellum": "0.34 ± 0.08", "prefrontal_cortex": "0.37 ± 0.20"}

WINDOWS = 256
EPISODES, QUICK_EPISODES = 12, 2
BINS = 20


class FiringRates(Row):
    """Spikes, operations and energy of recorded insertions."""

    name: ClassVar[str] = "rates"

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return what the brain does while it is listened to."""
        return (INSERTIONS, REST)

    def files(self, setting: Setting) -> Sequence[Path]:
        """Return the example and the shipped weights."""
        experiment = self._experiment(setting)
        return [
            setting.examples / EXAMPLE,
            *(weights_file(name, experiment) for name, config in experiment.regions.items() if config.weights),
        ]

    def measure(self, cell: str, setting: Setting) -> Result:
        """Listen to the brain."""
        experiment = self._experiment(setting)
        brain = build_brain(experiment)
        if cell == REST:
            return {name: _at_rest(brain.region(name)) for name in REGIONS}
        projections = _projections(brain)
        episodes = QUICK_EPISODES if setting.quick else EPISODES
        windows, periods = listen(brain, experiment, projections, range(episodes))
        found: dict[str, Any] = {}
        for name in REGIONS:
            of_region = [window for window in windows if window.region == name]
            layers = list(of_region[0].spikes)
            rates = {layer: _rates(of_region, layer, brain.plan.clock.window) for layer in layers}
            chosen = np.linspace(0, len(rates[layers[0]]) - 1, WINDOWS).round().astype(int)
            every = np.concatenate([rates[layer][chosen] for layer in layers], axis=1)
            neurons = every.mean(0)
            uses = len(rates[layers[0]]) / periods
            found[name] = {
                "mean": float(every.mean()),
                "deviation_of_windows": float(every.mean(1).std()),
                "deviation_of_neurons": float(neurons.std()),
                "deviation": float(every.std()),
                "layers": {layer: float(rates[layer][chosen].mean()) for layer in layers},
                "neurons": every.shape[1],
                "windows": np.round(every.mean(1), 5).tolist(),
                "histogram": np.histogram(neurons, BINS, (0.0, 1.0))[0].tolist(),
                "uses": uses,
                "updates": uses * every.shape[1] * brain.plan.clock.window,
                "operations": {
                    one.name: float(sum(w.operations[one.name][torch.from_numpy(w.running)].sum() for w in of_region))
                    / periods
                    for one in projections[name]
                },
                "synapses": {one.name: one.count for one in projections[name]},
            }
        return {"periods": periods, "steps": brain.plan.clock.window, "regions": found}

    def _experiment(self, setting: Setting) -> Experiment:
        return load_experiment(setting.examples / EXAMPLE)


def listen(
    brain: Brain, experiment: Experiment, projections: Mapping[str, list[Synapses]], seeds: Sequence[int]
) -> tuple[list[Window], int]:
    """Run an insertion for each seed; return all windows of the spiking regions, and how many periods there were."""
    task = build_task(experiment)
    assert task is not None
    supervised, batch = SupervisedTask(task), len(seeds)
    running = np.ones(batch, dtype=np.bool_)
    listener, periods = Listener(projections, running), 0
    state = brain.init_state(seeds)
    with torch.inference_mode():
        supervised.reset(seeds, batch)
        while running.any():
            listener.running = running
            read = {k: torch.as_tensor(v, dtype=torch.float32) for k, v in supervised.body.read().items()}
            commands, state = brain.tick(read, state, listener)
            wanted = {name: value.numpy().astype(np.float64) for name, value in commands.items()}
            _, ended = supervised.step(wanted, brain.plan.clock.tick_ns, running)
            periods += int(running.sum())
            running = running & ~ended
    return listener.windows, periods


def _projections(brain: Brain) -> dict[str, list[Synapses]]:
    circuits = {name: circuit_of(brain.region(name)) for name in REGIONS}
    return {name: list(synapses(circuit)) for name, circuit in circuits.items() if circuit is not None}


def _rates(windows: Sequence[Window], layer: str, steps: int) -> Array:
    """Return spikes per step (windows of running episodes, neurons) of a layer."""
    return np.concatenate([window.spikes[layer].numpy()[window.running] for window in windows]).astype(float) / steps


def _at_rest(region: Region) -> dict[str, float]:
    """Return the firing rate of a region without any input spike, and with inputs that read zero."""
    steps, silent, zero = region.clock.window, {}, {}
    for name, port in region.input_ports.items():
        values = torch.zeros(1, port.width)
        silent[name] = values if port.code is None else torch.zeros(steps, 1, port.channels)
        zero[name] = values if port.code is None else port.code.encode(values, steps)
    return {"no_spikes": _rate(region, silent), "zero": _rate(region, zero)}


def _rate(region: Region, inputs: Mapping[str, torch.Tensor]) -> float:
    heard: list[torch.Tensor] = []
    with torch.inference_mode():
        region.step(inputs, region.init_state(1), lambda layer, spikes: heard.append(spikes.mean((0, 1))))
    return float(torch.cat(heard).mean())
