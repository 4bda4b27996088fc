"""Training data of the hippocampus: axial speeds; its configuration is torch-free."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from neurorobo.clock import Clock
from neurorobo.learning.phase import DataConfig
from neurorobo.units import Interval, Unit
from precision_interaction import table_one

if TYPE_CHECKING:
    import torch
    from torch import Tensor


class InsertionSpeedsConfig(DataConfig):
    """Axial speeds that cover their range evenly; what else the hippocampus reads starts at nothing."""

    implementation: ClassVar[str] = "precision_interaction.data.insertion_speeds:InsertionSpeeds"

    type: Literal["precision.insertion_speeds"] = "precision.insertion_speeds"
    speed: Annotated[Interval, Unit("um/s")] = Interval(0.0, table_one.MAX_SPEED_UM_S)


class InsertionSpeeds:
    """Draws speeds for the hippocampus and its teacher, one at random in each of ``batch`` equal parts of the range."""

    def __init__(self, config: InsertionSpeedsConfig, clock: Clock) -> None:
        self.speed_um_s = config.speed

    def draw(self, batch: int, generator: "torch.Generator") -> "dict[str, Tensor]":
        """Return speed (um/s), (batch, 1), in rising order."""
        import torch

        place = (torch.arange(batch).unsqueeze(1) + torch.rand(batch, 1, generator=generator)) / batch
        return {"speed": self.speed_um_s.lo + (self.speed_um_s.hi - self.speed_um_s.lo) * place}
