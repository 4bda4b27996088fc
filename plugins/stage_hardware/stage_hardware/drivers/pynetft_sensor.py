"""ATI's Net F/T box through the library pynetft, which receives in a thread of native code.

An alternative to :mod:`stage_hardware.drivers.ati_net_ft`, and a check of it. Needs the extra ``ati``. Not tried on a
device. The time of a reading is when Python gets it.
"""

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from stage_hardware import force_units
from stage_hardware.drivers.net_ft_sensor import NetFtSensor
from stage_hardware.errors import HardwareError, LinkError
from stage_hardware.force_sensor import Sample
from stage_hardware.links import rdt
from stage_hardware.threaded_force_sensor import WAITS_S

if TYPE_CHECKING:
    import pynetft

QUEUE = 4096
"""How many samples may wait for this process; those that find no place count as lost."""


class PynetftSensor(NetFtSensor):
    """A force sensor behind a Net F/T box that pynetft reads.

    Losses, status words and a sensor that stalls are judged as by `AtiNetFt`. Of the box's page pynetft reads units and
    counts per unit only: ranges and rate are not checked. What pynetft takes for a fault, such as a single record
    that comes twice or late, ends its stream, and readings are invalid until the next start.
    """

    def _prepare(self) -> None:
        self._client: pynetft.Client | None = None
        self._samples: Iterator[pynetft.Sample] = iter(())
        self._stream: rdt.RecordStream | None = None

    def _open(self) -> None:
        try:
            import pynetft
        except ImportError:
            raise HardwareError(
                self.name, "pynetft is not installed", "pip install 'neurorobo-stage-hardware[ati]'"
            ) from None
        config = pynetft.Config(
            sensor_host=self.host,
            rdt_port=self.rdt_port,
            http_port=self.http_port,
            receive_timeout=self.silence_s,
            configuration_connect_timeout=self.timeout_s,
            configuration_timeout=self.timeout_s,
            deliver_samples_with_error_status=True,
            recovery_policy=pynetft.RecoveryPolicy.FAIL_STOP,
        )
        client = pynetft.Client(config, queue_size=QUEUE)
        try:
            client.start()
        except (OSError, ValueError, pynetft.NetFTError) as error:
            raise LinkError(
                self.name, f"pynetft cannot read {self.host} ({error})", "see to power and address"
            ) from error
        self._client, self._stream, self._gives_up = client, None, pynetft.SensorFaultError
        self._samples = client.samples(WAITS_S)

    def _shut(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.stop()

    def _next(self) -> Sample | None:
        client = self._client
        if client is None:
            return None
        try:
            came = next(self._samples)
        except TimeoutError:  # which ends the iterator
            self._samples = client.samples(WAITS_S)
            return None
        except self._gives_up as error:
            raise LinkError(
                self.name,
                f"pynetft gave up: {error.health.last_error or error} ({error.fault_code.value})",
                "see to the sensor, then start again",
            ) from error
        if self._stream is None:
            self._stream = self._opened_stream(client)
        return self._stream.take(time.monotonic_ns(), came.rdt_sequence, came.ft_sequence, came.status, came.raw_wrench)

    def _opened_stream(self, client: "pynetft.Client") -> rdt.RecordStream:
        configuration = client.health().sensor_configuration
        assert configuration is not None  # there are no samples without
        found = configuration.calibration
        return rdt.RecordStream(
            self.rate_Hz,
            force_units.force_mN(found.force_unit.value) / found.counts_per_force_unit,
            force_units.torque_mNm(found.torque_unit.value) / found.counts_per_torque_unit,
            axia="axia" in configuration.product_name.lower(),
        )
