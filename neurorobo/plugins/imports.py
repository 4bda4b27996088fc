"""Importing what a plugin names as ``package.module:attribute``; whatever goes wrong is the plugin's fault."""

import importlib
from typing import Any

from neurorobo.errors import NeuroroboError


def import_target(target: str) -> Any:
    """Return ``package.module:attribute``, imported; a NeuroroboError says what became of it, whatever it raised."""
    module, _, attribute = target.partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (Exception, SystemExit) as error:
        raise NeuroroboError(
            f"`{target}` cannot be imported ({described(error)}); repair or reinstall the plugin that provides it"
        ) from error


def described(error: BaseException) -> str:
    """Return an error in one line; its type says what happened unless the text was written for the user."""
    return str(error) if isinstance(error, NeuroroboError) else f"{type(error).__name__}: {error}"
