"""What the bundle brings to neurorobo."""

from neurorobo.plugins import hookimpl
from neurorobo.plugins.registry import Registrar


@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    """Register bodies and commands."""
