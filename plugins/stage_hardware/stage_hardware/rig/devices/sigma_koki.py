"""What the configurations of SIGMA KOKI's controllers have in common: axes in pulses, and their emulation."""

from collections.abc import Mapping
from operator import itemgetter
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from neurorobo.units import Unit
from stage_hardware.rig.device_config import AxisConfig, SerialStageConfig
from stage_hardware.rig.emulated_device import EmulatedAxis

if TYPE_CHECKING:
    from stage_hardware.drivers.sigma_koki import SigmaKokiAxis
    from stage_hardware.emulators.sigma_koki import SigmaKokiEmulator


class SigmaKokiAxisConfig(AxisConfig):
    """An axis at a connector; its resolution is that of a pulse."""

    number: int = Field(ge=1, le=8, strict=True, description="Its connector, from 1.")
    division: int | None = Field(
        default=None, ge=1, strict=True, description="Pulses per full step: set, and read back, if it is given."
    )
    start_speed: Annotated[float, Unit("um/s", gt=0)] | None = Field(
        default=None, description="The speed that is reached at once; by default as the manufacturer has it."
    )
    seeks_origin: Literal[-1, 1] = Field(
        default=-1, description="Which way a GSC-02 looks for its origin; others know it."
    )

    def driver_axis(self) -> "SigmaKokiAxis":
        """Return it as the driver takes it."""
        from stage_hardware.drivers.sigma_koki import SigmaKokiAxis

        return SigmaKokiAxis(
            self.axis, self.number, self.pulses_per_um, self.division, self.start_speed, self.seeks_origin
        )


class SigmaKokiConfig(SerialStageConfig):
    """A controller of SIGMA KOKI."""

    axes: dict[str, SigmaKokiAxisConfig]
    hardware_flow_control: bool = Field(default=True, strict=True, description="RTS/CTS, which the controllers want.")

    def _mechanisms(
        self, emulator: "SigmaKokiEmulator", speeds: Mapping[str, tuple[int, int, int]]
    ) -> dict[str, EmulatedAxis]:
        """Build the axes into an emulator, which looks for all origins at the speed of the slowest of them."""
        from stage_hardware.emulators import sigma_koki
        from stage_hardware.emulators.mechanism import Mechanism

        emulator.origin_speeds = sigma_koki.Speeds(*min(speeds.values(), key=itemgetter(1)))
        built = {}
        for name, axis in self.axes.items():
            lower, upper, position = (float(round(um * axis.pulses_per_um)) for um in axis.mechanics())
            mechanism = Mechanism(lower, upper, position=position, start_speed=0, speed=1, acceleration=1)
            emulator.axes[axis.number - 1] = mechanism
            built[name] = EmulatedAxis(mechanism, float(1 / axis.pulses_per_um))
        return built
