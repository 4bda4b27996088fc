"""Supervised training of one region by its teacher: surrogate gradients through whole windows (STBP)."""

import signal
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from neurorobo.errors import NeuroroboError
from neurorobo.learning.checkpoint import Checkpoints
from neurorobo.learning.evaluate import Data, Rates, SideBySide
from neurorobo.learning.on_policy import OnPolicyData, Rollout
from neurorobo.learning.phase import SupervisePhase
from neurorobo.learning.trainable import adam, only_learning, set_learning_rate
from neurorobo.regions.region import Region, constrain
from neurorobo.regions.weights_file import signature_hash


@dataclass(frozen=True)
class Progress:
    """Where a phase is: steps done of all, and the last one's loss, rms error of each output and mean firing rate.

    Errors are in the unit of the port, over the batch, all components and all windows. A phase that learns from a
    reward tells instead what it gains.
    """

    done: int
    steps: int
    loss: float
    error: Mapping[str, float]
    rate: float


def supervise(
    region: Region,
    teacher: Region,
    data: Data,
    phase: SupervisePhase,
    generator: torch.Generator,
    *,
    report: Callable[[Progress], None] = lambda progress: None,
    checkpoints: Checkpoints | None = None,
    rollout: Rollout | None = None,
) -> None:
    """Train ``region`` in place; ``generator`` draws the data. A phase with ``on_policy`` needs a ``rollout``.

    With ``checkpoints`` an interrupted phase goes on where it stopped, to the very same weights; the file is the
    caller's to remove, once the weights are safe. Ctrl-C ends the step, writes the checkpoint and raises
    KeyboardInterrupt. Raises ConfigError if the phase does not fit the region, NeuroroboError if the data or a
    checkpoint do not, or if a checkpoint cannot be written.
    """
    phase.check_ports(region.input_ports, region.output_ports)
    unit_errors = phase.unit_errors(region.output_ports)
    both = SideBySide(region, teacher, phase.unroll, tuple(unit_errors))
    visits = None
    if phase.on_policy is not None:
        if rollout is None:
            raise ValueError("a phase with `on_policy` needs a rollout")
        data = visits = OnPolicyData(data, rollout, phase.on_policy, region.input_ports)
    parameters = _chosen(region, phase)
    with (
        only_learning([region], parameters.values()),
        _deferred_interrupt() as interrupted,
        _products(phase.precision),
    ):
        optimiser = adam(parameters.values())
        state = _State(region, phase, parameters, optimiser, generator, visits)
        first = 0 if checkpoints is None else state.resume(checkpoints)
        for step in range(first, phase.steps):
            set_learning_rate(optimiser, phase.learning_rate_at(step))
            rates = Rates()
            with _products("float32"):  # what a region meets by itself is what it will meet when it runs
                values = data.draw(phase.batch, generator)
            optimiser.zero_grad()
            with _noise(region, parameters.values(), phase.weight_noise, generator):
                errors = both.errors(values, generator, rates)
                loss = _loss(errors, unit_errors, phase.unroll.discount)
                if phase.rate_penalty:
                    loss = loss + phase.rate_penalty * rates.mean()
                loss.backward()
            optimiser.step()
            constrain(region)
            error = {name: float(e.detach().square().mean().sqrt()) for name, e in errors.items()}
            report(Progress(step + 1, phase.steps, float(loss.detach()), error, float(rates.mean().detach())))
            if checkpoints is not None and (checkpoints.due or interrupted.is_set()):
                state.save(checkpoints, step + 1)
            if interrupted.is_set():
                raise KeyboardInterrupt


@dataclass(frozen=True)
class _State:
    """All that the rest of a phase depends on: the region, Adam's moments, the generator of the data, what was met."""

    region: Region
    phase: SupervisePhase
    parameters: Mapping[str, nn.Parameter]
    optimiser: torch.optim.Adam
    generator: torch.Generator
    visits: OnPolicyData | None

    def belongs(self) -> dict[str, Any]:
        """Return what a checkpoint must agree in to be gone on from, under the names that an error gives them."""
        loop = {} if self.visits is None else {"the rest of the closed loop": self.visits.fingerprint}
        return {
            "the settings of the phase": self.phase.model_dump(mode="json"),
            "the configuration of the region": signature_hash(self.region.config, self.region.clock),
            "the clock": self.region.clock.to_config(),
            **loop,
        }

    def save(self, checkpoints: Checkpoints, done: int) -> None:
        """Write a checkpoint."""
        tensors = {f"region.{name}": tensor for name, tensor in self.region.state_dict().items()}
        for name, parameter in self.parameters.items():
            tensors |= {f"adam.{key}.{name}": tensor for key, tensor in self.optimiser.state[parameter].items()}
        if self.visits is not None:
            tensors |= {f"visits.{name}": tensor for name, tensor in self.visits.tensors().items()}
        checkpoints.write(done, {**tensors, "generator": self.generator.get_state()}, self.belongs())

    def resume(self, checkpoints: Checkpoints) -> int:
        """Take over a checkpoint, if there is one, and return how many steps are done."""
        found = checkpoints.read(self.belongs())
        if found is None:
            return 0
        done, tensors = found
        try:
            self.region.load_state_dict(_below("region.", tensors))
            for name, parameter in self.parameters.items():
                if f"adam.step.{name}" in tensors:  # not if the loss does not depend on it
                    moments = {key: tensors[f"adam.{key}.{name}"] for key in ("step", "exp_avg", "exp_avg_sq")}
                    self.optimiser.state[parameter] = moments
            self.generator.set_state(tensors["generator"])
            if self.visits is not None:
                self.visits.restore(_below("visits.", tensors), done)
        except (KeyError, TypeError, RuntimeError) as error:
            raise NeuroroboError(
                f"{checkpoints.file} is not a checkpoint of this region ({error}); remove it to start afresh"
            ) from error
        return done


def _below(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the tensors whose names begin with ``prefix``, without it."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def _loss(errors: Mapping[str, Tensor], unit_errors: Mapping[str, float], discount: float) -> Tensor:
    """Return the mean over outputs of the squared error, in units of the one that counts as one, over windows."""
    squares = torch.stack([(error / unit_errors[name]).square().mean((1, 2)) for name, error in errors.items()])
    return (squares.mean(0) * discount ** torch.arange(squares.shape[1])).sum()


def _chosen(region: Region, phase: SupervisePhase) -> dict[str, nn.Parameter]:
    """Return the parameters that the phase trains, by name."""
    groups = region.parameter_groups()
    phase.check_groups(groups)
    names = groups if phase.train is None else phase.train
    wanted = {id(p) for name in names for p in groups[name].parameters()}
    wanted -= {id(p) for name in phase.freeze for p in groups[name].parameters()}
    if not wanted:
        raise NeuroroboError(f"the phase freezes all it would train; there are: {', '.join(groups)}")
    return {name: parameter for name, parameter in region.named_parameters() if id(parameter) in wanted}


@contextmanager
def _noise(
    region: Region, parameters: Collection[nn.Parameter], share: float, generator: torch.Generator
) -> Iterator[None]:
    """Let parameters be off by Gaussian noise, of a share of the rms of their tensor, and bring them back exactly.

    They keep their signs and limits.
    """
    if share == 0:
        yield
        return
    exact = [parameter.detach().clone() for parameter in parameters]
    try:
        with torch.no_grad():
            for parameter in parameters:
                noise = torch.randn(parameter.shape, generator=generator)
                parameter.add_(noise.mul_(share * parameter.square().mean().sqrt()))
            constrain(region)
        yield
    finally:
        with torch.no_grad():
            for parameter, before in zip(parameters, exact, strict=True):
                parameter.copy_(before)


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
