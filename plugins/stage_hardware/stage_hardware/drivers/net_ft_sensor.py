"""What the readers of a Net F/T box have in common: what is named of the box and expected of it."""

from abc import abstractmethod
from collections.abc import Mapping

from stage_hardware.force_sensor import WRENCH, Component
from stage_hardware.links import rdt
from stage_hardware.threaded_force_sensor import ThreadedForceSensor


class NetFtSensor(ThreadedForceSensor):
    """A force sensor behind a Net F/T box."""

    def __init__(
        self,
        name: str,
        host: str = "192.168.1.1",
        *,
        components: Mapping[str, Component],
        rate_Hz: float = 1000.0,
        rdt_port: int = rdt.PORT,
        http_port: int = 80,
        timeout_s: float = 2.0,
        silence_s: float = 0.1,
        bias_readings: int = 100,
    ) -> None:
        """Name the box and what is expected of it; ``components`` are those of `wrench_components`."""
        super().__init__(name, components, rate_Hz, silence_s=silence_s, start_s=timeout_s, bias_readings=bias_readings)
        if self._names != WRENCH:
            raise ValueError(f"the components of a Net F/T sensor are {', '.join(WRENCH)}, in this order")
        self.host, self.rdt_port, self.http_port, self.timeout_s = host, rdt_port, http_port, timeout_s
        self._prepare()

    @abstractmethod
    def _prepare(self) -> None:
        """Set what is kept of a stream to what holds before the first one."""
