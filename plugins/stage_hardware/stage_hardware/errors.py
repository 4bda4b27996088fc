"""What can go wrong with a device: each error names the device, the fault and the cure."""

from neurorobo.errors import NeuroroboError


class HardwareError(NeuroroboError):
    """A fault of a device, or of the way to it."""

    def __init__(self, device: str, fault: str, cure: str) -> None:
        self.device, self.fault, self.cure = device, fault, cure
        super().__init__(f"{device}: {fault}; {cure}")

    def __reduce__(self) -> tuple[type["HardwareError"], tuple[str, str, str]]:
        """Return what another process needs to raise the same error."""
        return type(self), (self.device, self.fault, self.cure)


class LinkError(HardwareError):
    """The link is gone: a cable was pulled, a controller switched off."""


class ReplyTimeoutError(HardwareError):
    """A reply did not come in time; whether the command was carried out is not known: read the state first."""


class ReplyError(HardwareError):
    """A reply that makes no sense: garbled, or of another command."""


class RefusedError(HardwareError):
    """The controller has refused a command."""


class InterruptedByStopError(HardwareError):
    """A transaction was given up, as a stop had to go first."""
