"""Fig. 9 and 10: the contact of repeated insertions, identified on the rig as the paper identified its own."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from precision_interaction import table_one
from precision_interaction.identification.analysis import ContactFit, analyse
from precision_interaction.identification.experiment import insert_and_withdraw
from precision_interaction.reproduce.row import Result, Row, Setting
from precision_interaction.rig.insertion_rig_config import (
    InsertionRigConfig,
    MeasuredContactConfig,
    ProportionalContactConfig,
)

if TYPE_CHECKING:
    pass

FILTERED, RAW_MN = 0.0, table_one.FORCE_RESOLUTION_MN
CASES: dict[str, tuple[MeasuredContactConfig | ProportionalContactConfig, float]] = {
    "measured": (MeasuredContactConfig(), FILTERED),
    "proportional": (ProportionalContactConfig(law="proportional"), FILTERED),
    "measured, sensor not filtered": (MeasuredContactConfig(), RAW_MN),
}

REPETITIONS, QUICK_REPETITIONS = 1000, 40


class Contact(Row):
    """The contact as a Gaussian of the insertion step."""

    name: ClassVar[str] = "contact"

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return the rigs."""
        return list(CASES)

    def measure(self, cell: str, setting: Setting) -> Result:
        """Insert and withdraw, and analyse the log as `neurorobo identify` does."""
        contact, resolution = CASES[cell]
        rig = InsertionRigConfig(contact=contact).model_copy(update={"force_resolution": resolution})
        repetitions = QUICK_REPETITIONS if setting.quick else REPETITIONS
        found = analyse(insert_and_withdraw(rig, repetitions=repetitions))
        assert found.measured is not None
        return {
            "repetitions": repetitions,
            "step_um": found.step_um.tolist(),
            "mean_mN": found.mean_mN.tolist(),
            "variance_mN2": found.variance_mN2.tolist(),
            "r_squared": found.radial_r_squared.tolist(),
            "chosen": found.best().law,
            "fits": {fit.law: _lines(fit) for fit in (found.measured, found.proportional)},
            "histograms": [
                [{name: np.asarray(value).tolist() for name, value in asdict(one).items()} for one in of_step]
                for of_step in found.histograms
            ],
        }


def _lines(fit: ContactFit) -> dict[str, Any]:
    return {
        name: {key: np.asarray(value).tolist() for key, value in asdict(line).items()}
        for name, line in (("mean", fit.mean), ("variance", fit.variance))
    }
