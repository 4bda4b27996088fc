"""The configuration of a region: all that a graph can be checked with before any network is built."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from neurorobo.clock import Clock
from neurorobo.errors import ConfigError, Fault
from neurorobo.regions.port import Port
from neurorobo.units import same_unit


class RegionConfig(BaseModel, ABC):
    """Base of every region's configuration; it must not import torch, so that files are checked and planned quickly.

    ``implementation`` names the class that is imported when the region is built, as ``"package.module:Class"``;
    ``pretrained_package`` the package that holds shipped weights, if there are any.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    implementation: ClassVar[str]
    pretrained_package: ClassVar[str | None] = None
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

    def signature(self, clock: Clock) -> Mapping[str, Any]:
        """Return what trained weights depend on; two regions of equal signature can exchange weights."""
        fields = self.model_dump(mode="json", exclude=set(self.not_in_signature))
        return {**fields, "window": clock.window}


def checked_ports(config: RegionConfig, clock: Clock) -> tuple[dict[str, Port], dict[str, Port]]:
    """Return the input and the output ports of a region; a ConfigError if they cannot be had.

    Its faults have paths inside the region's configuration: a period that there is not, a unit or a code that cannot
    be, an initial value that its code cannot say.
    """
    try:
        inputs, outputs = config.inputs(clock), config.outputs(clock)
        for name, port in (*inputs.items(), *outputs.items()):
            _check(name, port)
    except ValueError as error:
        raise ConfigError([Fault((), str(error))]) from error
    return inputs, outputs


def _check(name: str, port: Port) -> None:
    """Raise a ValueError for a unit that does not exist, and for an initial value that its code cannot say."""
    same_unit(port.unit, port.unit)
    code = port.code
    for value in port.initial or ():
        if code is not None and not code.lo <= value <= code.hi:
            raise ValueError(
                f"the port `{name}` starts at {value:g} {port.unit}, outside the range {code.lo:g}..{code.hi:g} of its "
                "code; widen the range or start within it"
            )
