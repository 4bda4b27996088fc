"""Some cases of the fault matrix, on emulated rigs: what must stop stops, what must be tolerated is."""

import sys

import pytest

if sys.platform != "linux":
    pytest.skip("pseudo-terminals, 127.0.0.2 and /proc", allow_module_level=True)

from fault_matrix import PHASES, RIGS, Case, cases, judged
from killed_process import Death, deaths
from rig_under_test import allowance

NAMES = (
    "shot_ds102.radial.no reply.homing",
    "shot_ds102.radial.power cycle.homing",
    "shot_ds102.radial.split reply.insertion",
    "shot_ds102.elevator.hang-up.approach",
    "shot_ds102.elevator.emergency stop.insertion",
    "shot_ds102.load.over-force beyond the latch.approach",
    "pi_venus.radial.refusal.approach",
    "pi_venus.axial.limit switch.insertion",
    "pi_venus.axial.deaf.retraction",
    "pi_venus.force_sensor.silence.insertion",
    "pi_venus.load.axial over-force.retraction",
    "pi_venus.load.hard wall.insertion",
    "pi_venus.brain.hang.loop",
)
CASES = {case.name: case for case in cases()}


@pytest.mark.parametrize("name", NAMES)
def test_a_fault_leads_to_what_it_must(name: str) -> None:
    found = judged(CASES[name])
    assert not found["failures"], found


def test_there_is_a_case_of_every_fault_in_every_phase_on_both_rigs() -> None:
    assert len(CASES) == len(list(cases())) >= 200
    for rig in RIGS:
        devices = {case.device for case in CASES.values() if case.rig == rig}
        assert {"radial", "force_sensor", "load", "brain"} < devices
        for device in devices - {"brain"}:
            of_device = [case for case in CASES.values() if (case.rig, case.device) == (rig, device)]
            for fault in {case.fault for case in of_device}:
                phases = {case.phase for case in of_device if case.fault == fault and not case.as_shipped}
                assert phases == set(PHASES)


def test_a_fault_that_does_not_stop_the_rig_fails() -> None:
    """The judge is not content with a run that goes on, as it does unless the machine pauses for the sensor's age."""
    case = Case("pi_venus", "force_sensor", "drop", "homing", "stop")
    assert any("status finished" in judged(case)["failures"] for _ in range(3))


def test_the_allowance_is_what_its_terms_make() -> None:
    allowed = allowance("shot_ds102", as_shipped=True)
    assert allowed.stops_s == pytest.approx(allowed.wakes_s + allowed.link_s + allowed.line_s + allowed.controller_s)
    assert allowed.load_mN(2.0) == pytest.approx(2.0 * 1000.0 * (0.002 + allowed.stops_s))


def test_a_killed_process_leaves_one_bounded_command_at_most() -> None:
    for death in deaths(3, seed=1):
        assert not death.misses(), death


def test_more_than_one_command_after_death_is_a_miss() -> None:
    death = Death("pi_venus", "inserting", 0.1, {"z": 50.0}, {"z": 2}, 36.0, rests=False)
    assert [miss.split()[0] for miss in death.misses()] == ["z", "something", "z"]
