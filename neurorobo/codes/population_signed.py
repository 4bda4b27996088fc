"""A signed value in ON and OFF neurons, which are silent at zero."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from neurorobo.codes.code import Code
from neurorobo.codes.config import CodeConfig
from neurorobo.codes.rate import PopulationUniform

if TYPE_CHECKING:
    import torch
    from torch import Tensor


@dataclass(frozen=True)
class PopulationSigned(Code):
    """The magnitude as :class:`PopulationUniform` has it: in ON neurons above zero, in as many OFF neurons below.

    The value is ``(ON spikes - OFF spikes) * resolution``, and the resolution, ``(hi - lo) / (neurons * steps)``, is
    that of population uniform; but zero is silence, exactly, and a small value a few spikes. Encoding and decoding
    again is off by at most half a resolution. The range must have zero in its middle.

    Source: the ON and OFF pathways of the retina (Schiller 1992). A pair of one ON and one OFF neuron is a sigma-delta
    modulator of first order with three levels.
    """

    def __post_init__(self) -> None:
        """Refuse a range without zero in its middle, and neurons that cannot be shared evenly by ON and OFF."""
        super().__post_init__()
        if self.lo != -self.hi:
            furthest = max(-self.lo, self.hi)
            raise ValueError(
                f"a signed code needs a range with zero in its middle (got {self.lo:g}..{self.hi:g}); give it "
                f"{-furthest:g}..{furthest:g}, or take population_uniform"
            )
        if self.neurons % 2:
            raise ValueError(f"a signed code needs as many ON as OFF neurons, an even number (got {self.neurons})")

    @property
    def _magnitude(self) -> PopulationUniform:
        return PopulationUniform(self.neurons // 2, 0.0, self.hi)

    def resolution(self, steps: int) -> float:
        """Return the value of one spike."""
        return self._magnitude.resolution(steps)

    def encode(self, values: "Tensor", steps: int, generator: "torch.Generator | None" = None) -> "Tensor":
        """Return the spikes of ``values``: per component the ON neurons, then the OFF ones; deterministic."""
        import torch

        return self._magnitude.encode(torch.stack([values, -values], dim=-1).flatten(1), steps)

    def decode(self, spikes: "Tensor") -> "Tensor":
        """Take what the OFF neurons say from what the ON neurons say; differentiable."""
        both = self._magnitude.decode(spikes)
        return both[:, ::2] - both[:, 1::2]


class PopulationSignedConfig(CodeConfig):
    """As many spikes as the magnitude asks for, of ON neurons above zero and OFF neurons below; silent at zero."""

    type: Literal["population_signed"] = "population_signed"
    neurons: int = Field(
        default=10, ge=2, multiple_of=2, description="Neurons of each component of the quantity, half of them ON."
    )

    def build(self, lo: float, hi: float) -> PopulationSigned:
        """Return the code."""
        return PopulationSigned(self.neurons, lo, hi)
