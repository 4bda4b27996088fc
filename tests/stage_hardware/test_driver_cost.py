"""The measurement of what drivers cost: it sees each controller, and tells a driver that waits."""

import sys
import time
from typing import Any

import pytest

if sys.platform == "win32":
    pytest.skip("no pseudo-terminals", allow_module_level=True)

from driver_cost import MOST, measured
from stage_hardware.drivers.venus import VenusStage

from tests.stage_hardware.rigs import EXAMPLES


def test_each_controller_of_a_rig_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    state = VenusStage.state

    def slowly(stage: VenusStage) -> Any:
        time.sleep(0.02)
        return state(stage)

    monkeypatch.setattr(VenusStage, "state", slowly)
    pi, venus = measured(EXAMPLES / "pi_venus.yaml", seconds=0.2)
    for cost in (pi, venus):
        assert 0 < cost.wire_ms < cost.bare_ms  # as the emulators answer at the pace of the wire
    assert venus.driver_ms - venus.bare_ms > 15
    assert venus.share > MOST
