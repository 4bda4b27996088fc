"""All pages, in the paper's order; what goes beyond the paper comes last."""

from collections.abc import Sequence

from precision_interaction.reproduce.pages import (
    adaptation,
    additivity,
    assembly,
    cerebellum,
    codes,
    contact,
    firing_rates,
    hippocampus,
    learning,
    mujoco_rig,
    ppo,
)
from precision_interaction.reproduce.pages.page import Page


def pages() -> Sequence[Page]:
    """Return the page of every row."""
    return (
        codes.PAGE,
        hippocampus.PAGE,
        cerebellum.PAGE,
        firing_rates.PAGE,
        contact.PAGE,
        assembly.PAGE,
        additivity.PAGE,
        learning.PAGE,
        ppo.PAGE,
        mujoco_rig.PAGE,
        adaptation.PAGE,
    )
