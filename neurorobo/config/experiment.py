"""The experiment file: its top level, and how it is loaded, checked as a whole and written out in full."""

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
)

from neurorobo.bodies import BodyConfig
from neurorobo.clock import Clock
from neurorobo.config.document import Document, load_document
from neurorobo.config.faults import faults_of, raise_faults, validation_error
from neurorobo.config.overrides import apply_overrides
from neurorobo.config.plugged_reader import REGISTRY, validation_context
from neurorobo.errors import ConfigError, Fault, NeuroroboError
from neurorobo.graph.spec import RepeatSpec, StepSpec
from neurorobo.plugged_field import Plugged
from neurorobo.plugins import Registry
from neurorobo.regions import RegionConfig
from neurorobo.seeds import LARGEST_SEED
from neurorobo.tasks import TaskConfig
from neurorobo.units import Duration


def _name(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z]\w*", text, re.ASCII):
        raise ValueError("must start with a letter and go on with letters, digits and _")
    return text


def _file_name(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", text, re.ASCII):
        raise ValueError("names the run folder: it must be of letters, digits, '_', '.' and '-'")
    return text


def _positive(duration_ns: int) -> int:
    if duration_ns == 0:
        raise ValueError("must be longer than zero")
    return duration_ns


def _reference(value: object) -> object:
    if not isinstance(value, str):
        raise ValueError("must be a reference such as 'plan.speed'")
    return value


def _recorder(name: str, info: ValidationInfo) -> str:
    assert info.context is not None
    registry: Registry = info.context[REGISTRY]
    try:
        return registry.entry("recorder", name).name.removeprefix("core.")
    except NeuroroboError as error:
        raise validation_error([Fault((), str(error))], "recorder") from error


Model = TypeVar("Model", bound=BaseModel)
Name = Annotated[str, AfterValidator(_name)]
Reference = Annotated[str, BeforeValidator(_reference)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Step(BaseModel):
    """What stands after a step's name; every other key wires an input of the region."""

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: dict[str, Reference]

    use: Name = Field(description="The region to run.")
    state: Literal["commit", "fork", "fresh"] = Field(
        default="commit",
        description="Write the region's state, run on a copy that is thrown away, or start at rest.",
    )
    every: Name = Field(default="control", description="The period, of those under `time`, at which the step runs.")


class Repeat(_Strict):
    """Steps that run several times in a row."""

    repeat: int = Field(ge=1, strict=True, description="How many times the steps run.")
    steps: Any = Field(description="The steps, in order.")


class Episode(_Strict):
    """When a run without a task ends."""

    duration: Annotated[Duration, AfterValidator(_positive)] = Field(description="How long the run lasts.")


def _read_clock(value: object) -> Clock:
    if not isinstance(value, Mapping):
        raise validation_error(
            [Fault((), "must be a mapping such as {control: 1 s, spike_step: 1 ms, window: 50}")], "time"
        )
    try:
        return Clock.from_config(value)
    except ConfigError as error:
        raise validation_error(error.faults, "time") from error


def _read_steps(value: object) -> tuple[StepSpec | RepeatSpec, ...]:
    faults: list[Fault] = []
    steps = tuple(_items(value, ("steps",), faults))
    if faults:
        raise validation_error((Fault(fault.path[1:], fault.message) for fault in faults), "steps")
    return steps


def _items(value: object, path: tuple[str | int, ...], faults: list[Fault]) -> Iterator[StepSpec | RepeatSpec]:
    """Yield the steps of a list, noting what is wrong with the others."""
    if not isinstance(value, list) or not value:
        faults.append(Fault(path, "must be a list of steps such as '- plan: {use: cortex, force: body.force}'"))
        return
    for index, item in enumerate(value):
        place = (*path, index)
        if isinstance(item, Mapping) and "repeat" in item:
            block = _validated(Repeat, item, place, faults)
            inner = [*_items(item["steps"], (*place, "steps"), faults)] if "steps" in item else []
            steps = tuple(step for step in inner if isinstance(step, StepSpec))
            if len(steps) < len(inner):
                faults.append(Fault(place, "a repeat cannot hold another repeat; multiply the two counts"))
            if block is not None:
                yield RepeatSpec(block.repeat, steps, place)
        elif isinstance(item, Mapping) and len(item) == 1:
            [(name, content)] = item.items()
            place = (*place, name)
            if (step := _validated(Step, content, place, faults)) is not None:
                try:
                    name = _name(name)
                except ValueError as error:
                    faults.append(Fault(place, f"the name of a step {error}"))
                inputs: dict[str, str] = dict(step.__pydantic_extra__)
                yield StepSpec(name, step.use, step.state, step.every, inputs, place)
        else:
            keys = f" (got the keys {', '.join(map(repr, item))})" if isinstance(item, Mapping) else ""
            faults.append(
                Fault(place, f"must be one step, 'name: {{use: region, ...}}', or 'repeat' and 'steps'{keys}")
            )


def _validated(model: type[Model], value: object, path: tuple[str | int, ...], faults: list[Fault]) -> Model | None:
    """Return the validated model, or nothing after noting the faults."""
    try:
        return model.model_validate(value)
    except ValidationError as error:
        faults += ConfigError(faults_of(error, model, value)).under(*path).faults
        return None


def _write_steps(steps: Iterable[StepSpec | RepeatSpec]) -> list[dict[str, Any]]:
    return [
        {"repeat": step.count, "steps": _write_steps(step.steps)}
        if isinstance(step, RepeatSpec)
        else {step.name: {"use": step.use, "state": step.state, "every": step.every, **step.inputs}}
        for step in steps
    ]


class Experiment(_Strict):
    """Everything that an experiment file says, checked but not yet built; two are equal if they resolve to the same."""

    neurorobo: Literal[1] = Field(description="The version of the file format.")
    name: Annotated[str, AfterValidator(_file_name)] = Field(description="Names the run folder.")
    seed: int = Field(
        default=0, ge=0, le=LARGEST_SEED, strict=True, description="Draws the first episode and untrained weights."
    )
    clock: Annotated[Clock, PlainValidator(_read_clock), PlainSerializer(Clock.to_config)] = Field(
        alias="time", description="The periods of the steps, and the spike window of one use."
    )
    body: Annotated[BodyConfig, Plugged("body")] | None = Field(default=None, description="Sensors and actuators.")
    task: Annotated[TaskConfig, Plugged("task")] | None = Field(
        default=None, description="What the body is to achieve."
    )
    episode: Episode | None = Field(default=None, description="When a run without a task ends.")
    regions: dict[Name, Annotated[RegionConfig, Plugged("region")]] = Field(description="The brain regions, by name.")
    steps: Annotated[tuple[StepSpec | RepeatSpec, ...], PlainValidator(_read_steps), PlainSerializer(_write_steps)] = (
        Field(description="What runs in one control period, in order.")
    )
    command: dict[Name, Reference] = Field(default={}, description="Where each actuator's command comes from.")
    train: tuple[Annotated[BaseModel, Plugged("rule", key="phase")], ...] = Field(
        default=(), description="The phases of training, in order."
    )
    record: tuple[Annotated[str, AfterValidator(_recorder)], ...] = Field(
        default=(), description="The recorders of a run."
    )

    _document: Document = PrivateAttr()

    @classmethod
    def from_document(cls, document: Document, registry: Registry) -> Self:
        """Check a document against the models of the core and of its plugins; a ConfigError lists all faults."""
        others = [key for key in document.value if key.startswith("neurorobo_")]
        if others and "neurorobo" not in document.value:  # such as a rig, whose every line would be at fault
            fault = "says what kind of file this is, and it is no experiment; one starts with 'neurorobo: 1'"
            raise_faults(document, [Fault((others[0],), fault)])
        faults = [*_stops(document.value)]
        try:
            experiment = cls.model_validate(document.value, context=validation_context(registry))
        except ValidationError as error:
            faults += faults_of(error, cls, document.value)
        raise_faults(document, faults)
        experiment._document = document
        return experiment

    @property
    def document(self) -> Document:
        """The document that the experiment was read from, for the places of faults found later."""
        return self._document

    @property
    def config_hash(self) -> str:
        """The SHA-256 of the resolved experiment, in hexadecimal; the order of keys does not matter."""
        return hashlib.sha256(json.dumps(self.resolved(), sort_keys=True).encode()).hexdigest()

    def resolved(self) -> dict[str, Any]:
        """Return the experiment with every default written out, as plain values that load again to an equal one."""
        dump = self.model_dump(mode="json", by_alias=True)
        return {key: value for key, value in dump.items() if value is not None}

    def __eq__(self, other: object) -> bool:
        """Compare what the experiments say, not where they were read."""
        return isinstance(other, Experiment) and self.resolved() == other.resolved()


def load_experiment(path: str | Path, overrides: Iterable[str] = (), registry: Registry | None = None) -> Experiment:
    """Read and check an experiment file, with overrides such as ``seed=3``; by default with all installed plugins.

    Raises a ConfigError with every fault on a line of its own: place, path, what is wrong, what is allowed.
    """
    document = apply_overrides(load_document(path), overrides)
    return Experiment.from_document(document, Registry.discover() if registry is None else registry)


def _stops(values: Mapping[str, object]) -> Iterator[Fault]:
    """Yield what is missing for a run to have an end."""
    body, task, episode = (values.get(key) is not None for key in ("body", "task", "episode"))
    if body and not task:
        yield Fault(("task",), "is missing; a body needs a task, which says when an episode ends")
    if task and not body:
        yield Fault(("body",), "is missing; a task needs a body")
    if task and episode:
        yield Fault(("episode",), "is for experiments without a task; this one's task says when an episode ends")
    if not (body or task or episode):
        yield Fault(("episode",), "is missing; without a task, say when a run ends: 'episode: {duration: 5 s}'")
