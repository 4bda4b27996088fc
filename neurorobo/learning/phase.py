"""The configuration of training phases: what all have in common, and the supervised one with the data it draws."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from neurorobo.bodies import BodyConfig
from neurorobo.clock import Clock
from neurorobo.errors import ConfigError, Fault, did_you_mean
from neurorobo.graph.plan import Plan
from neurorobo.regions.config import RegionConfig
from neurorobo.regions.port import Port
from neurorobo.seeds import LARGEST_SEED
from neurorobo.units import UnitError, parse_quantity, same_unit

if TYPE_CHECKING:
    from neurorobo.regions.region import Region

_FALL: Mapping[str, Callable[[float], float]] = {
    "constant": lambda done: 1.0,
    "linear": lambda done: 1.0 - done,
    "cosine": lambda done: (1.0 + math.cos(math.pi * done)) / 2.0,
}


def _as_text(value: object) -> object:
    return str(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


QuantityText = Annotated[str, BeforeValidator(_as_text)]
"""A quantity whose unit only the graph tells: text such as `0.1 um`; without a unit, a number will do."""


class DataConfig(BaseModel):
    """Base of the configuration of a source of training data; it must not import torch.

    ``implementation`` names the class behind it, as ``"package.module:Class"``: built from the configuration and the
    clock, it is a :class:`neurorobo.learning.evaluate.Data`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    implementation: ClassVar[str]

    type: str


class Unroll(BaseModel):
    """An outer recurrence to train through: the region runs ``windows`` times, and so does its teacher.

    Before each further window the outputs named in ``feedback`` become inputs; the other inputs stay as they are. The
    loss of window i counts ``discount**i``, i = 0, 1, ...
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    windows: int = Field(ge=1)
    feedback: dict[str, str] = Field(
        default={}, description="The output port that each input port takes its next value from."
    )
    discount: float = Field(default=1.0, gt=0, le=1)


class OnPolicy(BaseModel):
    """The share of each batch that a region is to meet by itself, in the closed loop of the experiment.

    A pupil meets the consequences of its own errors, which no distribution made beforehand has; what it should have
    said to them, its teacher says. Source: DAgger (Ross, Gordon and Bagnell 2011), but that old visits are forgotten.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    share: float = Field(gt=0, le=1, description="Share of each batch, rounded to whole inputs.")
    episodes: int = Field(default=16, ge=1, description="Episodes of a visit to the closed loop, each of a fresh seed.")
    every: int = Field(default=100, ge=1, description="Steps of training from one visit to the next.")
    keep: int = Field(default=8, ge=1, description="Visits whose inputs are drawn from, the newest ones.")

    def count(self, batch: int) -> int:
        """Return how many inputs of a batch are met."""
        return round(self.share * batch)


@dataclass(frozen=True)
class Pupil:
    """A region that a phase trains: its configuration and its ports."""

    config: RegionConfig
    inputs: Mapping[str, Port]
    outputs: Mapping[str, Port]


@dataclass(frozen=True)
class Surroundings:
    """What a phase has to fit: its pupils by name, its parts, and the experiment around them.

    ``parts`` are configurations; the ports of regions among them have been checked by themselves. The plan is there for
    a phase that needs a rollout.
    """

    pupils: Mapping[str, Pupil]
    parts: Mapping[str, BaseModel]
    clock: Clock
    plan: Plan | None
    body: BodyConfig | None


class Phase(BaseModel, ABC):
    """Base of the configuration of a training phase, of whatever rule; it must not import torch.

    ``implementation`` names what trains, as ``"package.module:function"``: it is called with the keywords ``regions``
    (by name; one ``region`` for a :class:`RegionPhase`), ``phase``, ``generator``, ``report`` (of
    :class:`neurorobo.learning.supervise.Progress`), ``checkpoints`` (to use or not, of
    :class:`neurorobo.learning.checkpoint.Checkpoints`), and one for each of ``parts``, and trains the regions in place.
    ``parts`` are the fields that name something to be built: a region or a source of data. A phase that
    ``needs_rollout`` is also given ``rollout``: an object of the class that ``rollout`` names, built of the experiment,
    its plan, the names of the pupils and all regions trained so far, with a ``fingerprint()`` of the closed loop.

    What ``training.json`` is to say of the phase, ready for JSON, is returned by ``implementation``, or by the function
    that ``examination`` names, of the same regions, ``phase``, ``generator`` and parts, or by both.

    ``from_weights`` tells where a region begins that no earlier phase has trained: with the weights that the file
    names, or with fresh ones.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    implementation: ClassVar[str]
    examination: ClassVar[str | None] = None
    parts: ClassVar[Mapping[str, Literal["region", "data"]]] = {}
    rollout: ClassVar[str] = "neurorobo.experiment.rollout:Rollout"
    from_weights: ClassVar[bool] = False

    phase: str
    seed: int = Field(default=0, ge=0, le=LARGEST_SEED)

    @property
    @abstractmethod
    def pupils(self) -> Mapping[str, tuple[str | int, ...]]:
        """The regions that learn, each with the place in the phase that names it."""

    @property
    def needs_rollout(self) -> bool:
        """Whether the rule lets its pupils act in the closed loop of the experiment."""
        return False

    def check(self, surroundings: Surroundings) -> None:
        """Raise a ConfigError with all that does not fit the experiment, before anything is built."""

    def check_parameters(self, groups: Mapping[str, Collection[str]]) -> None:
        """Raise a ConfigError if the phase does not fit the parameter groups of its pupils, known once built."""

    def keywords(self, regions: Mapping[str, "Region"]) -> dict[str, object]:
        """Return how implementation and examination are given the regions."""
        return {"regions": {name: regions[name] for name in self.pupils}}


class RegionPhase(Phase):
    """Base of the configuration of a phase that trains one region."""

    region: str

    @property
    def pupils(self) -> Mapping[str, tuple[str | int, ...]]:
        """The one region that learns."""
        return {self.region: ("region",)}

    def check_parameters(self, groups: Mapping[str, Collection[str]]) -> None:
        """Raise a ConfigError if the phase does not fit the parameter groups of its region."""
        self.check_groups(groups[self.region])

    def check_groups(self, groups: Collection[str]) -> None:
        """Raise a ConfigError if the phase does not fit a region of these parameter groups."""

    def keywords(self, regions: Mapping[str, "Region"]) -> dict[str, object]:
        """Return how implementation and examination are given the region."""
        return {"region": regions[self.region]}


class SupervisePhase(RegionPhase):
    """Train a region to do what its teacher does, by back-propagation through time with surrogate gradients (STBP).

    Source: Eq. 9 and 10 of Xing et al. for the loss and the unrolling, Wu et al. 2018 for the gradients.
    """

    implementation: ClassVar[str] = "neurorobo.learning.supervise:supervise"
    examination: ClassVar[str | None] = "neurorobo.learning.evaluate:examine"
    parts: ClassVar[Mapping[str, Literal["region", "data"]]] = {"teacher": "region", "data": "data"}

    phase: Literal["supervise"] = "supervise"
    teacher: str | dict[str, Any] = Field(description="A region with numeric ports, which gives the desired outputs.")
    data: str | dict[str, Any] = Field(description="Where the inputs of both come from.")
    loss: dict[str, QuantityText] = Field(
        min_length=1, description="The outputs that are taught, each with the error that counts as one: {move: 0.1 um}."
    )
    train: tuple[str, ...] | None = Field(default=None, description="The parameter groups to train; all if left out.")
    freeze: tuple[str, ...] = Field(default=(), description="Parameter groups to leave as they are.")
    unroll: Unroll = Unroll(windows=1)
    on_policy: OnPolicy | None = Field(
        default=None, description="The share of the data that the region meets by itself in the closed loop."
    )
    steps: int = Field(ge=1)
    batch: int = Field(default=32, ge=1)
    learning_rate: float = Field(
        default=0.02, gt=0, description="Adam's, for a fan-in of one; other weights get it divided by its root."
    )
    schedule: Literal["constant", "linear", "cosine"] = Field(
        default="cosine", description="How the learning rate goes on from its peak: it stays, or falls to zero."
    )
    warmup: int = Field(default=20, ge=0, description="Steps in which the learning rate rises to its peak.")
    rate_penalty: float = Field(default=0.0, ge=0, description="What a mean firing rate of one would add to the loss.")
    weight_noise: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="Gaussian noise on all that is trained while gradients are taken, as a share of the rms of each "
        "tensor, so that what is learned hangs less on the last digits, which rounding changes.",
    )
    precision: Literal["bf16", "float32"] = Field(
        default="float32", description="The products of spikes and weights while training; sums are always float32."
    )

    @property
    def needs_rollout(self) -> bool:
        """Whether the region learns from what it meets by itself."""
        return self.on_policy is not None

    def check(self, surroundings: Surroundings) -> None:
        """Raise a ConfigError with all that does not fit the pupil and its teacher."""
        pupil = surroundings.pupils[self.region]
        inputs, outputs = pupil.inputs, pupil.outputs
        faults = [*self._port_faults(inputs, outputs), *self._loop_faults(pupil.config, inputs)]
        teacher = surroundings.parts["teacher"]
        assert isinstance(teacher, RegionConfig)
        faults += self._teacher_faults(inputs, outputs, teacher, surroundings.clock)
        if faults:
            raise ConfigError(faults)

    def check_groups(self, groups: Collection[str]) -> None:
        """Raise a ConfigError if the phase names groups that there are not."""
        faults = [
            Fault((key, index), f"`{self.region}` has no parameter group `{name}`{did_you_mean(name, groups)}")
            for key, names in (("train", self.train or ()), ("freeze", self.freeze))
            for index, name in enumerate(names)
            if name not in groups
        ]
        if faults:
            raise ConfigError(faults)

    def check_ports(self, inputs: Mapping[str, Port], outputs: Mapping[str, Port]) -> None:
        """Raise a ConfigError with all that does not fit a region of these ports."""
        if faults := self._port_faults(inputs, outputs):
            raise ConfigError(faults)

    def _port_faults(self, inputs: Mapping[str, Port], outputs: Mapping[str, Port]) -> list[Fault]:
        faults = [*self._loss_faults(outputs)]
        for target, source in self.unroll.feedback.items():
            path = ("unroll", "feedback", target)
            if target not in inputs:
                faults.append(Fault(path, f"`{self.region}` has no input `{target}`{did_you_mean(target, inputs)}"))
            elif source not in outputs:
                faults.append(Fault(path, f"`{self.region}` has no output `{source}`{did_you_mean(source, outputs)}"))
            elif (inputs[target].unit, inputs[target].width) != (outputs[source].unit, outputs[source].width):
                faults.append(Fault(path, f"input `{target}` and output `{source}` differ in unit or width"))
        return faults

    def _loop_faults(self, pupil: RegionConfig, inputs: Mapping[str, Port]) -> Iterator[Fault]:
        """Yield what keeps the pupil from learning from what it meets by itself: inputs alone are kept of that."""
        if self.on_policy is None:
            return
        if pupil.carry != "never":
            yield Fault(
                ("on_policy",), f"`{self.region}` carries a state, and what it met is taught from rest; leave this out"
            )
        for name, port in inputs.items():
            if port.code is not None and port.code.stochastic:
                message = f"the input `{name}` is drawn at random, so that what was met cannot be told exactly"
                yield Fault(("on_policy",), f"{message}; give it a deterministic code, or leave this out")
        if not 0 < self.on_policy.count(self.batch) < self.batch + (self.on_policy.share == 1):
            yield Fault(
                ("on_policy", "share"),
                f"{self.on_policy.share:g} of a batch of {self.batch} is none or all; make the batch larger",
            )

    def _teacher_faults(
        self, inputs: Mapping[str, Port], outputs: Mapping[str, Port], teacher: RegionConfig, clock: Clock
    ) -> Iterator[Fault]:
        """Yield what the teacher cannot say, or cannot be told."""
        told, says = teacher.inputs(clock), teacher.outputs(clock)
        if teacher.weights is not None:
            yield Fault(
                ("teacher", "weights"), "a teacher is built without weights; take a region of numbers, without this key"
            )
        # The outputs that are taught and those fed back, each at the place that asks for it.
        asked: dict[tuple[str, ...], str] = {("loss", name): name for name in self.loss}
        asked |= {("unroll", "feedback", target): source for target, source in self.unroll.feedback.items()}
        for path, name in asked.items():
            if name in outputs and name not in says:
                yield Fault(path, f"the teacher `{teacher.type}` has no output `{name}`{did_you_mean(name, says)}")
            elif name in outputs and (difference := _difference(says[name], outputs[name])):
                yield Fault(path, f"the output `{name}` of the teacher `{teacher.type}` {difference}")
        for name, port in told.items():
            if name in inputs and (difference := _difference(port, inputs[name])):
                yield Fault(("teacher",), f"the input `{name}` of the teacher `{teacher.type}` {difference}")
            elif name not in inputs and port.initial is None:
                known = did_you_mean(name, inputs)
                yield Fault(
                    ("teacher",), f"`{teacher.type}` reads `{name}`, which `{self.region}` has no input for{known}"
                )

    def unit_errors(self, outputs: Mapping[str, Port]) -> dict[str, float]:
        """Return the error that counts as one for each taught output, in the unit of its port."""
        return {name: parse_quantity(text, outputs[name].unit) for name, text in self.loss.items()}

    def learning_rate_at(self, step: int) -> float:
        """Return the learning rate of a step."""
        done = step / self.steps
        rise = min(1.0, (step + 1) / self.warmup) if self.warmup else 1.0
        return self.learning_rate * rise * _FALL[self.schedule](done)

    def _loss_faults(self, outputs: Mapping[str, Port]) -> list[Fault]:
        faults = []
        for name, text in self.loss.items():
            path = ("loss", name)
            if name not in outputs:
                faults.append(Fault(path, f"`{self.region}` has no output `{name}`{did_you_mean(name, outputs)}"))
                continue
            code = outputs[name].code
            if code is not None and not code.differentiable:
                faults.append(
                    Fault(
                        path,
                        f"nothing can be taught through the code of `{name}`, {type(code).__name__}, which has no "
                        "gradient; give it one that counts spikes, such as population_uniform",
                    )
                )
            try:
                if parse_quantity(text, outputs[name].unit) <= 0:
                    faults.append(Fault(path, f"the error that counts as one must be above zero (got '{text}')"))
            except UnitError as error:
                faults.append(Fault(path, str(error)))
        return faults


def _difference(teachers: Port, pupils: Port) -> str:
    """Return what keeps a port of the teacher from standing for that of its pupil, or nothing."""
    if teachers.code is not None:
        return "carries spikes, not numbers; take a teacher that computes with numbers"
    if not same_unit(teachers.unit, pupils.unit) or teachers.width != pupils.width:
        return f"is {teachers.width} x {teachers.unit}, that of its pupil {pupils.width} x {pupils.unit}"
    return ""
