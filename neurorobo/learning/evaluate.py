"""How far a region is from its teacher: both side by side on the same inputs, and the figures of their difference."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from neurorobo.errors import NeuroroboError, did_you_mean
from neurorobo.learning.phase import SupervisePhase, Unroll
from neurorobo.regions.port import Port
from neurorobo.regions.region import Probe, Region, State
from neurorobo.regions.values import convert


class Data(Protocol):
    """A source of training inputs."""

    def draw(self, batch: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """Return numbers (batch, width) for the inputs of the region and of its teacher, in the ports' units."""


@dataclass(frozen=True)
class Evaluation:
    """How far a region is from its teacher, (windows, width) in the ports' units, and how fast each layer fires."""

    rms: Mapping[str, Tensor]
    largest: Mapping[str, Tensor]
    bias: Mapping[str, Tensor]
    rates: Mapping[str, float]

    def to_json(self) -> dict[str, Any]:
        """Return the figures as what JSON can hold."""
        tables = {"rms": self.rms, "largest": self.largest, "bias": self.bias}
        figures = {name: {port: error.tolist() for port, error in table.items()} for name, table in tables.items()}
        return {**figures, "firing_rates": dict(self.rates)}


def examine(
    region: Region, teacher: Region, data: Data, phase: SupervisePhase, generator: torch.Generator
) -> dict[str, Any]:
    """Return how far a trained region is from its teacher on what its phase teaches, ready for JSON."""
    return evaluate(region, teacher, data, generator, outputs=phase.loss, unroll=phase.unroll).to_json()


@torch.no_grad()
def evaluate(
    region: Region,
    teacher: Region,
    data: Data,
    generator: torch.Generator,
    *,
    outputs: Iterable[str],
    unroll: Unroll = Unroll(windows=1),  # noqa: B008 (frozen)
    batch: int = 64,
    batches: int = 16,
) -> Evaluation:
    """Compare a region with its teacher on ``batches`` fresh draws, in full precision."""
    both = SideBySide(region, teacher, unroll, tuple(outputs))
    rates = Rates()
    drawn = [both.errors(data.draw(batch, generator), generator, rates) for _ in range(batches)]
    errors = {name: torch.cat([errors[name] for errors in drawn], dim=1) for name in drawn[0]}
    return Evaluation(
        rms={name: error.square().mean(1).sqrt() for name, error in errors.items()},
        largest={name: error.abs().amax(1) for name, error in errors.items()},
        bias={name: error.mean(1) for name, error in errors.items()},
        rates=rates.by_layer(),
    )


class Rates:
    """A probe that adds up the firing rate of each layer, differentiably."""

    def __init__(self) -> None:
        """Start with no spikes heard."""
        self._rates: dict[str, list[Tensor]] = {}

    def __call__(self, layer: str, spikes: Tensor) -> None:
        """Take the spikes (steps, batch, neurons) of one layer."""
        self._rates.setdefault(layer, []).append(spikes.mean())

    def mean(self) -> Tensor:
        """Return the mean over all layers, each counting the same."""
        layers = [torch.stack(rates).mean() for rates in self._rates.values()]
        return torch.stack(layers).mean() if layers else torch.zeros(())

    def by_layer(self) -> dict[str, float]:
        """Return the mean of each layer."""
        return {layer: float(torch.stack(rates).mean()) for layer, rates in self._rates.items()}


@dataclass(frozen=True)
class SideBySide:
    """A region and its teacher on the same inputs, for one or several windows; ``outputs`` are compared."""

    region: Region
    teacher: Region
    unroll: Unroll
    outputs: tuple[str, ...]

    def errors(self, values: Mapping[str, Tensor], generator: torch.Generator, probe: Probe) -> dict[str, Tensor]:
        """Return what the region says minus what the teacher says, (windows, batch, width) of each output.

        ``values`` are numbers (batch, width) by input; only stochastic codes draw from ``generator``. Raises a
        NeuroroboError if an input has neither a value nor an initial one.
        """
        batch, steps = len(next(iter(values.values()))), self.region.clock.window
        generators = [generator] * batch
        ports, said = self.region.input_ports, self.region.output_ports

        def given(name: str, port: Port) -> Tensor:
            return convert(numbers(name, port, values, batch), None, port.code, steps, generators)

        inputs = {name: given(name, port) for name, port in ports.items()}
        told = {name: given(name, port) for name, port in self.teacher.input_ports.items()}
        state, teacher_state = self.region.init_state(batch), self.teacher.init_state(batch)
        errors: dict[str, list[Tensor]] = {name: [] for name in self.outputs}
        for _ in range(self.unroll.windows):
            outputs, state = _run(self.region, inputs, state, probe)
            with torch.no_grad():
                wanted, teacher_state = _run(self.teacher, told, teacher_state, None)
            for name, error in errors.items():
                code = said[name].code
                error.append(convert(outputs[name], code, None, steps, ()) - _within(said[name], wanted[name]))
            for target, source in self.unroll.feedback.items():
                inputs[target] = convert(outputs[source], said[source].code, ports[target].code, steps, generators)
                told[target] = wanted[source]
        return {name: torch.stack(error) for name, error in errors.items()}


def numbers(name: str, port: Port, values: Mapping[str, Tensor], batch: int) -> Tensor:
    """Return the numbers (batch, width) of an input, or its initial value; a NeuroroboError if there is neither."""
    if name in values:
        return values[name]
    if port.initial is None:
        raise NeuroroboError(f"the training data have nothing for the input `{name}`{did_you_mean(name, values)}")
    return torch.tensor(port.initial).expand(batch, -1)


def _run(
    region: Region, inputs: Mapping[str, Tensor], state: State, probe: Probe | None
) -> tuple[dict[str, Tensor], State]:
    """Run one window; a region that never carries its state starts the next one at rest."""
    outputs, after = region.step(inputs, state, probe)
    return outputs, state if region.config.carry == "never" else after


def _within(port: Port, values: Tensor) -> Tensor:
    """Clip what is wanted to what the port can say."""
    return values if port.code is None else values.clamp(port.code.lo, port.code.hi)
