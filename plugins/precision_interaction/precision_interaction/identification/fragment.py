"""The fitted contact as what stands under ``body: contact:`` of an experiment."""

import numpy as np
import yaml
from pydantic import TypeAdapter

from precision_interaction.identification.analysis import Analysis, ContactFit
from precision_interaction.identification.log import Array
from precision_interaction.rig.insertion_rig_config import (
    ContactConfig,
    Correlation,
    MeasuredContactConfig,
    ProportionalContactConfig,
)

DIGITS = 5
LARGEST = 0.999
"""Of a correlation: the rig wants axes that are not the same."""


def contact_of(analysis: Analysis, fit: ContactFit) -> ContactConfig:
    """Return the fitted law as the rig's configuration; an axis z that was not measured adds nothing.

    The correlation of x and y is left out unless it is beyond doubt.
    """
    told: dict[str, object] = {
        "law": fit.law,
        "mean_slope": _texts(fit.mean.slope, "mN/um"),
        "variance_slope": _texts(fit.variance.slope, "mN^2/um"),
    }
    if fit.law == "measured":
        told["mean_intercept"] = _texts(fit.mean.intercept, "mN")
        told["variance_intercept"] = _texts(fit.variance.intercept, "mN^2")
    if analysis.correlated:
        told["correlation"] = Correlation(xy=round(float(np.clip(analysis.correlation_xy, -LARGEST, LARGEST)), 3))
    kind = MeasuredContactConfig if fit.law == "measured" else ProportionalContactConfig
    return kind.model_validate(told)


def as_yaml(contact: ContactConfig, comment: str) -> str:
    """Return a contact as YAML, with a comment of one line above it."""
    told = TypeAdapter(ContactConfig).dump_python(contact, mode="json", exclude_unset=True)
    ordered = {"law": told.pop("law"), **told}
    return f"# {comment}\n" + yaml.safe_dump(ordered, sort_keys=False, default_flow_style=None, width=120)


def _texts(values: Array, unit: str) -> list[str]:
    three = [*values, 0.0][:3]
    return [f"{float(f'{value:.{DIGITS}g}')!r} {unit}" for value in three]
