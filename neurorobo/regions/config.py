"""The configuration of a region: all that a graph can be checked with before any network is built."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from neurorobo.clock import Clock
from neurorobo.errors import ConfigError, Fault, NeuroroboError
from neurorobo.neurons import NeuronConfig
from neurorobo.regions.port import Port
from neurorobo.units import same_unit

Path = tuple[str | int, ...]
"""Where something is inside a region's configuration, as in the file."""


class RegionConfig(BaseModel, ABC):
    """Base of every region's configuration; it must not import torch, so that files are checked and planned quickly.

    ``implementation`` names the class that is imported when the region is built, as ``"package.module:Class"``;
    ``pretrained_package`` the package that holds shipped weights, if there are any. ``accumulates`` says that a region
    is nothing without its past, as one that learns while it runs: some step has to commit its state.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    implementation: ClassVar[str]
    pretrained_package: ClassVar[str | None] = None
    accumulates: ClassVar[bool] = False
    not_in_signature: ClassVar[frozenset[str]] = frozenset({"weights", "carry"})

    type: str
    weights: str | None = Field(
        default=None,
        description="`pretrained` for the shipped weights, or the path of a safetensors file; fresh ones if left out.",
    )
    carry: Literal["never", "repeat", "always"] = Field(
        default="never",
        description="How long the state lives: every use starts at rest, it survives within a repeat, or always.",
    )

    @abstractmethod
    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Return the input ports by name."""

    @abstractmethod
    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Return the output ports by name."""

    def needs_spikes(self, path: Path) -> bool:
        """Whether the neuron at a path has to send spikes; it has, unless a region says that it can read numbers."""
        return True

    def signature(self, clock: Clock) -> Mapping[str, Any]:
        """Return what trained weights depend on; two regions of equal signature can exchange weights."""
        fields = self.model_dump(mode="json", exclude=set(self.not_in_signature))
        return {**fields, "window": clock.window}


def checked_ports(config: RegionConfig, clock: Clock) -> tuple[dict[str, Port], dict[str, Port]]:
    """Return the input and the output ports of a region; a ConfigError if they cannot be had.

    Its faults have paths inside the region's configuration: a neuron that cannot run at the spike step or sends numbers
    where spikes are needed, a period that there is not, a unit or a code that cannot be, a code that does not fit the
    window, an initial value that its code cannot say.
    """
    if faults := [*_neuron_faults(config, clock.spike_step_ns)]:
        raise ConfigError(faults)
    try:
        inputs, outputs = config.inputs(clock), config.outputs(clock)
        for name, port in (*inputs.items(), *outputs.items()):
            _check(name, port, clock.window)
    except ValueError as error:
        raise ConfigError([Fault((), str(error))]) from error
    return inputs, outputs


def _neuron_faults(config: RegionConfig, step_ns: int) -> Iterator[Fault]:
    for path, neuron in _neurons(config, ()):
        if not neuron.sends_spikes and config.needs_spikes(path):
            yield Fault(
                path,
                f"`{neuron.type}` sends numbers, and here spikes are needed; take another neuron, or a region whose "
                "layers can read them, such as a `spiking_network` before its last layer",
            )
        try:
            neuron.check(step_ns)
        except ValueError as error:
            yield Fault(path, str(error))


def _neurons(value: object, path: Path) -> Iterator[tuple[Path, NeuronConfig]]:
    """Yield the neurons within a configuration, and where they are."""
    if isinstance(value, NeuronConfig):
        yield path, value
    elif isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            yield from _neurons(getattr(value, name), (*path, field.alias or name))
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _neurons(item, (*path, key))
    elif isinstance(value, list | tuple):
        for number, item in enumerate(value):
            yield from _neurons(item, (*path, number))


def _check(name: str, port: Port, steps: int) -> None:
    """Raise a ValueError for a unit that does not exist, and for a window or an initial value that its code cannot say.

    A code says itself which windows it can use, when it is asked for its resolution.
    """
    same_unit(port.unit, port.unit)
    code = port.code
    if code is not None:
        try:
            code.resolution(steps)
        except (NeuroroboError, ValueError) as error:
            raise ValueError(f"the port `{name}`: {error}") from error
    for value in port.initial or ():
        if code is not None and not code.lo <= value <= code.hi:
            raise ValueError(
                f"the port `{name}` starts at {value:g} {port.unit}, outside the range {code.lo:g}..{code.hi:g} of its "
                "code; widen the range or start within it"
            )
