"""Supervised training of one region by its teacher: surrogate gradients through whole windows (STBP)."""

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from neurorobo.errors import NeuroroboError, did_you_mean
from neurorobo.learning.phase import SupervisePhase, Unroll
from neurorobo.regions.port import Port
from neurorobo.regions.region import Probe, Region, State, constrain


class Data(Protocol):
    """A source of training inputs."""

    def draw(self, batch: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """Return numbers (batch, width) for the inputs of the region and of its teacher, in the ports' units."""


@dataclass(frozen=True)
class Progress:
    """Where a phase is: steps done of all, and the last one's loss, rms error of each output and mean firing rate.

    Errors are in the unit of the port, over the batch, all components and all windows.
    """

    done: int
    steps: int
    loss: float
    error: Mapping[str, float]
    rate: float


@dataclass(frozen=True)
class Evaluation:
    """How far a region is from its teacher, (windows, width) in the ports' units, and how fast each layer fires."""

    rms: Mapping[str, Tensor]
    largest: Mapping[str, Tensor]
    bias: Mapping[str, Tensor]
    rates: Mapping[str, float]


@dataclass(frozen=True)
class Checkpoints:
    """Where the state of an unfinished phase is kept, and how often it is written."""

    file: Path
    every_s: float = 60.0


def supervise(
    region: Region,
    teacher: Region,
    data: Data,
    phase: SupervisePhase,
    generator: torch.Generator,
    *,
    report: Callable[[Progress], None] = lambda progress: None,
    checkpoints: Checkpoints | None = None,
) -> None:
    """Train ``region`` in place; ``generator`` draws the data.

    With ``checkpoints`` an interrupted phase goes on where it stopped, to the very same weights; the file is the
    caller's to remove, once the weights are safe. Ctrl-C ends the step, writes the checkpoint and raises
    KeyboardInterrupt. Raises ConfigError if the phase does not fit the region, NeuroroboError if the data or a
    checkpoint do not.
    """
    phase.check_ports(region.input_ports, region.output_ports)
    lesson = _Lesson(region, teacher, phase.unroll, phase.unit_errors(region.output_ports))
    with _trainable(region, phase) as parameters, _deferred_interrupt() as interrupted, _products(phase.precision):
        optimiser = torch.optim.Adam(_by_fan_in(parameters.values()), betas=(0.9, 0.99), fused=True)
        first = _resume(checkpoints, region, phase, parameters, optimiser, generator)
        saved_at = time.monotonic()
        for step in range(first, phase.steps):
            for group in optimiser.param_groups:
                group["lr"] = phase.learning_rate_at(step) * group["scale"]
            rates = _Rates()
            errors = lesson.errors(data.draw(phase.batch, generator), rates)
            loss = lesson.loss(errors)
            if phase.rate_penalty:
                loss = loss + phase.rate_penalty * rates.mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            constrain(region)
            error = {name: float(e.detach().square().mean().sqrt()) for name, e in errors.items()}
            report(Progress(step + 1, phase.steps, float(loss.detach()), error, float(rates.mean().detach())))
            late = checkpoints is not None and time.monotonic() - saved_at >= checkpoints.every_s
            if checkpoints is not None and (late or interrupted.is_set()):
                _save(checkpoints.file, step + 1, region, phase, parameters, optimiser, generator)
                saved_at = time.monotonic()
            if interrupted.is_set():
                raise KeyboardInterrupt


def examine(
    region: Region, teacher: Region, data: Data, phase: SupervisePhase, generator: torch.Generator
) -> dict[str, Any]:
    """Return how far a trained region is from its teacher on what its phase teaches, ready for JSON."""
    return plain(evaluate(region, teacher, data, generator, outputs=phase.loss, unroll=phase.unroll))


def plain(evaluation: Evaluation) -> dict[str, Any]:
    """Return an evaluation as what JSON can hold."""
    tables = {"rms": evaluation.rms, "largest": evaluation.largest, "bias": evaluation.bias}
    figures = {name: {port: error.tolist() for port, error in table.items()} for name, table in tables.items()}
    return {**figures, "firing_rates": dict(evaluation.rates)}


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
    lesson = _Lesson(region, teacher, unroll, dict.fromkeys(outputs, 1.0))
    rates = _Rates()
    drawn = [lesson.errors(data.draw(batch, generator), rates) for _ in range(batches)]
    errors = {name: torch.cat([errors[name] for errors in drawn], dim=1) for name in drawn[0]}
    return Evaluation(
        rms={name: error.square().mean(1).sqrt() for name, error in errors.items()},
        largest={name: error.abs().amax(1) for name, error in errors.items()},
        bias={name: error.mean(1) for name, error in errors.items()},
        rates=rates.by_layer(),
    )


class _Rates:
    """A probe that adds up the firing rate of each layer, differentiably."""

    def __init__(self) -> None:
        self._rates: dict[str, list[Tensor]] = {}

    def __call__(self, layer: str, spikes: Tensor) -> None:
        self._rates.setdefault(layer, []).append(spikes.mean())

    def mean(self) -> Tensor:
        """Return the mean over all layers, each counting the same."""
        layers = [torch.stack(rates).mean() for rates in self._rates.values()]
        return torch.stack(layers).mean() if layers else torch.zeros(())

    def by_layer(self) -> dict[str, float]:
        return {layer: float(torch.stack(rates).mean()) for layer, rates in self._rates.items()}


@dataclass(frozen=True)
class _Lesson:
    """A region and its teacher side by side on the same inputs, for one or several windows."""

    region: Region
    teacher: Region
    unroll: Unroll
    unit_errors: Mapping[str, float]

    def errors(self, values: Mapping[str, Tensor], probe: Probe) -> dict[str, Tensor]:
        """Return what the region says minus what the teacher says, (windows, batch, width) of each taught output."""
        batch = len(next(iter(values.values())))
        inputs = {
            name: self._encode(port, _value(name, port, values, batch))
            for name, port in self.region.input_ports.items()
        }
        told = {name: _value(name, port, values, batch) for name, port in self.teacher.input_ports.items()}
        state, teacher_state = self.region.init_state(batch), self.teacher.init_state(batch)
        errors: dict[str, list[Tensor]] = {name: [] for name in self.unit_errors}
        for _ in range(self.unroll.windows):
            outputs, state = _run(self.region, inputs, state, probe)
            with torch.no_grad():
                wanted, teacher_state = _run(self.teacher, told, teacher_state, None)
            for name, error in errors.items():
                port = self.region.output_ports[name]
                error.append(_decode(port, outputs[name]) - _within(port, wanted[name]))
            for target, source in self.unroll.feedback.items():
                inputs[target] = self._recode(target, source, outputs[source])
                told[target] = wanted[source]
        return {name: torch.stack(error) for name, error in errors.items()}

    def loss(self, errors: Mapping[str, Tensor]) -> Tensor:
        """Return the mean over outputs of the squared error, in units of the one that counts as one, over windows."""
        discount = self.unroll.discount ** torch.arange(self.unroll.windows)
        squares = [(error / self.unit_errors[name]).square().mean((1, 2)) for name, error in errors.items()]
        return (torch.stack(squares).mean(0) * discount).sum()

    def _recode(self, target: str, source: str, values: Tensor) -> Tensor:
        """Turn an output of the region into its own input: equal codes connect directly."""
        port, output = self.region.input_ports[target], self.region.output_ports[source]
        return values if port.code == output.code else self._encode(port, _decode(output, values))

    def _encode(self, port: Port, values: Tensor) -> Tensor:
        return values if port.code is None else port.code.encode(values, self.region.clock.window)


def _run(
    region: Region, inputs: Mapping[str, Tensor], state: State, probe: Probe | None
) -> tuple[dict[str, Tensor], State]:
    """Run one window; a region that never carries its state starts the next one at rest."""
    outputs, after = region.step(inputs, state, probe)
    return outputs, state if region.config.carry == "never" else after


def _value(name: str, port: Port, values: Mapping[str, Tensor], batch: int) -> Tensor:
    if name in values:
        return values[name]
    if port.initial is None:
        raise NeuroroboError(f"the training data have nothing for the input `{name}`{did_you_mean(name, values)}")
    return torch.tensor(port.initial).expand(batch, -1)


def _decode(port: Port, values: Tensor) -> Tensor:
    return values if port.code is None else port.code.decode(values)


def _within(port: Port, values: Tensor) -> Tensor:
    """Clip what is wanted to what the port can say."""
    return values if port.code is None else values.clamp(port.code.lo, port.code.hi)


def _by_fan_in(parameters: Iterable[nn.Parameter]) -> list[dict[str, Any]]:
    """Return Adam's groups: each parameter is to move in proportion to what it was drawn from, 1/sqrt(fan-in)."""
    return [{"params": [parameter], "scale": parameter.shape[-1] ** -0.5} for parameter in parameters]


@contextmanager
def _trainable(region: Region, phase: SupervisePhase) -> Iterator[dict[str, nn.Parameter]]:
    """Let gradients flow into the parameters that the phase trains, and into no others; yield them by name."""
    groups = region.parameter_groups()
    phase.check_groups(groups)
    chosen = groups if phase.train is None else phase.train
    wanted = {id(p) for name in chosen for p in groups[name].parameters()}
    wanted -= {id(p) for name in phase.freeze for p in groups[name].parameters()}
    if not wanted:
        raise NeuroroboError(f"the phase freezes all it would train; there are: {', '.join(groups)}")
    before = {name: parameter.requires_grad for name, parameter in region.named_parameters()}
    try:
        for parameter in region.parameters():
            parameter.requires_grad_(id(parameter) in wanted)
        yield {name: parameter for name, parameter in region.named_parameters() if parameter.requires_grad}
    finally:
        for name, parameter in region.named_parameters():
            parameter.requires_grad_(before[name])
            parameter.grad = None


@contextmanager
def _products(precision: str) -> Iterator[None]:
    """Let matrix products round their factors to bf16, in which spikes are exact; sums stay float32."""
    matmul = torch.backends.mkldnn.matmul  # type: ignore[attr-defined] # torch's stubs lag behind
    before = matmul.fp32_precision
    matmul.fp32_precision = "bf16" if precision == "bf16" else "ieee"
    try:
        yield
    finally:
        matmul.fp32_precision = before


@contextmanager
def _deferred_interrupt() -> Iterator[threading.Event]:
    """Turn the first Ctrl-C into an event, so that no step is torn; outside the main thread there is none."""
    interrupted = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield interrupted
        return
    before = signal.getsignal(signal.SIGINT)

    def note(*_: object) -> None:
        interrupted.set()
        signal.signal(signal.SIGINT, before)  # a second Ctrl-C stops at once

    signal.signal(signal.SIGINT, note)
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, before)


def _save(
    file: Path,
    done: int,
    region: Region,
    phase: SupervisePhase,
    parameters: Mapping[str, nn.Parameter],
    optimiser: torch.optim.Adam,
    generator: torch.Generator,
) -> None:
    """Write one safetensors file, step and phase as JSON in its header, beside the old one and then in its place."""
    tensors = {f"region.{name}": tensor for name, tensor in region.state_dict().items()}
    for name, parameter in parameters.items():
        tensors |= {f"adam.{key}.{name}": tensor for key, tensor in optimiser.state[parameter].items()}
    tensors["generator"] = generator.get_state()
    header = {"done": done, "phase": phase.model_dump(mode="json")}
    file.parent.mkdir(parents=True, exist_ok=True)
    unfinished = file.with_suffix(".unfinished")
    save_file(
        {name: tensor.contiguous() for name, tensor in tensors.items()}, unfinished, {"checkpoint": json.dumps(header)}
    )
    os.replace(unfinished, file)


def _resume(
    checkpoints: Checkpoints | None,
    region: Region,
    phase: SupervisePhase,
    parameters: Mapping[str, nn.Parameter],
    optimiser: torch.optim.Adam,
    generator: torch.Generator,
) -> int:
    """Load a checkpoint, if there is one, and return how many steps are done."""
    if checkpoints is None or not checkpoints.file.exists():
        return 0
    try:
        with safe_open(checkpoints.file, "pt") as opened:
            header = json.loads(opened.metadata()["checkpoint"])
            tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118 (not a mapping)
        if header["phase"] != phase.model_dump(mode="json"):
            raise NeuroroboError(
                f"{checkpoints.file} belongs to another training phase; remove it to start this one afresh"
            )
        region.load_state_dict(
            {name.removeprefix("region."): t for name, t in tensors.items() if name.startswith("region.")}
        )
        for name, parameter in parameters.items():
            optimiser.state[parameter] = {
                key: tensors[f"adam.{key}.{name}"] for key in ("step", "exp_avg", "exp_avg_sq")
            }
        generator.set_state(tensors["generator"])
        return int(header["done"])
    except (SafetensorError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise NeuroroboError(
            f"{checkpoints.file} is not a checkpoint of this region ({error}); remove it to start afresh"
        ) from error
