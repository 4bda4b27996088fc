"""The package `nir`, an extra: imported when it is needed."""

from typing import Any

from neurorobo.errors import NeuroroboError


def nir() -> Any:
    """Return the package `nir`; a NeuroroboError says how to install it."""
    try:
        import nir as package
    except ImportError as error:
        raise NeuroroboError(
            f"networks are exchanged with the package `nir`, which cannot be imported ({error}); install it: "
            "pip install 'neurorobo[nir]'"
        ) from None
    return package
