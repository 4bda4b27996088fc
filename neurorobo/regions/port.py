"""Ports: what goes into a region and what comes out."""

from dataclasses import dataclass

from neurorobo.codes import Code


@dataclass(frozen=True)
class Port:
    """A typed end of an edge: a quantity of ``width`` components in ``unit``, as numbers or as spikes.

    Numbers are tensors (batch, width); with a ``code``, spikes are tensors (steps, batch, width * code.neurons) of 0
    and 1. ``initial`` is the value of an input before its source has spoken, in ``unit``, one number per component; an
    input that has one may be left unwired. ``once`` says of an input that it adds up what it hears, so that each window
    of its source has to be heard exactly once.
    """

    unit: str
    width: int = 1
    code: Code | None = None
    initial: tuple[float, ...] | None = None
    description: str = ""
    once: bool = False

    def __post_init__(self) -> None:
        """Refuse an initial value of another width; whole numbers in it become floats."""
        if self.initial is None:
            return
        if len(self.initial) != self.width:
            raise ValueError(f"a port of width {self.width} cannot start at {self.initial}")
        object.__setattr__(self, "initial", tuple(map(float, self.initial)))

    @property
    def channels(self) -> int:
        """The last dimension of the tensor that the port carries."""
        return self.width if self.code is None else self.width * self.code.neurons
