"""A unit that a configuration names."""

from typing import Annotated

from pydantic import AfterValidator

from neurorobo.units import same_unit


def _known(unit: str) -> str:
    same_unit(unit, unit)
    return unit


KnownUnit = Annotated[str, AfterValidator(_known)]
"""A field of a configuration that names a unit; one that there is not is refused."""
