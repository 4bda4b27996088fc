"""The conditioning chamber and its task: stimuli come by the clock, the lid by its equation, responses are scored."""

import json
import math
import re
import runpy
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from neurorobo_paradigms.eyeblink.conditioning_chamber import ConditioningChamber
from neurorobo_paradigms.eyeblink.conditioning_chamber_config import ConditioningChamberConfig
from neurorobo_paradigms.eyeblink.eyeblink_task import EyeblinkTask, Trial
from neurorobo_paradigms.eyeblink.eyeblink_task_config import EyeblinkTaskConfig
from pydantic import ValidationError

from neurorobo.config.experiment import load_experiment
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.closed_loop import EpisodeResult
from neurorobo.experiment.summary import summarise
from neurorobo.tasks.supervised import SupervisedTask
from neurorobo.testing import check_body
from tests.tasks.toys import Cart, CartConfig

TICK_NS = 10_000_000
BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "paradigms"
EYEBLINK = runpy.run_path(str(BENCHMARK / "eyeblink.py"))


def config(*phases: Mapping[str, Any], **changes: Any) -> ConditioningChamberConfig:
    return ConditioningChamberConfig.model_validate({"phases": phases or [{"name": "only", "trials": 1}], **changes})


def run(
    chamber: ConditioningChamberConfig, rate_Hz: Callable[[int], float], **task: Any
) -> tuple[EyeblinkTask, list[dict[str, float]]]:
    """Command a rate by the time since the start (ms), until the task ends; return it, and what was read each tick."""
    found = EyeblinkTask(EyeblinkTaskConfig.model_validate(task), ConditioningChamber(chamber))
    moving, readings, done = SupervisedTask(found), [], np.array([False])
    moving.reset([0], 1)
    while not done[0]:
        readings.append({name: float(value[0, 0]) for name, value in found.body.read().items()})
        _, done = moving.step({"eyelid": np.array([[rate_Hz(10 * (len(readings) - 1))]])}, TICK_NS, ~done)
    return found, readings


def during(readings: Sequence[Mapping[str, float]], sensor: str) -> list[int]:
    """When a sensor says something, in ms."""
    return [10 * tick for tick, reading in enumerate(readings) if reading[sensor]]


def test_the_worst_animal_responds_least_to_pairs_and_most_to_the_tone_alone() -> None:
    chamber = config({"name": "pairs", "trials": 1}, {"name": "alone", "trials": 1, "stimuli": "tone"})
    task, _ = run(chamber, lambda ms: 0.0)
    eager = {"conditioned.pairs": 0.9, "late_conditioned.pairs": 1.0, "conditioned.alone": 0.8}
    lazy = {"conditioned.pairs": 0.5, "late_conditioned.pairs": 0.6, "conditioned.alone": 0.1}
    animals = [EpisodeResult(0, eager, {}), EpisodeResult(1, lazy, {})]
    worst = {name: of["worst"] for name, of in summarise(animals, task.higher_is_better)["aggregate"].items()}
    assert {name: worst[name] for name in eager} == {**lazy, "conditioned.alone": 0.8}


def test_the_chamber_keeps_the_contract_of_bodies() -> None:
    phases = [{"name": "pairs", "trials": 1}, {"name": "apart", "trials": 2, "stimuli": "unpaired"}]
    check_body(config(*phases), period_ns=TICK_NS)
    check_body(config(*phases), period_ns=50_000_000, motions=60)


def test_the_puff_comes_after_the_interval_and_ends_with_the_tone() -> None:
    _, readings = run(config(interval="500 ms", trial="1 s"), lambda ms: 0.0)
    assert len(readings) == 100
    assert during(readings, "tone") == [*range(100, 650, 10)]
    assert during(readings, "puff") == [*range(600, 650, 10)]
    assert {reading["puff"] for reading in readings} == {0.0, 1.0}  # an open eye feels all of it


@pytest.mark.parametrize(
    ("stimuli", "tones", "puffs"), [("tone", [0, 1], []), ("puff", [], [0, 1]), ("unpaired", [0], [1])]
)
def test_what_a_phase_leaves_out_does_not_come(stimuli: str, tones: list[int], puffs: list[int]) -> None:
    _, readings = run(config({"name": "a", "trials": 2, "stimuli": stimuli}), lambda ms: 0.0)
    assert sorted({ms // 900 for ms in during(readings, "tone")}) == tones
    assert sorted({ms // 900 for ms in during(readings, "puff")}) == puffs


def test_the_lid_follows_the_firing_rate_by_its_equation() -> None:
    _, readings = run(config(lid_time_constant="40 ms", full_closure="200 Hz"), lambda ms: 50.0)
    for tick, reading in enumerate(readings):
        assert reading["closure"] == pytest.approx(0.25 * (1 - math.exp(-10 * tick / 40)))
    _, readings = run(config(), lambda ms: 700.0)
    assert 0.99 < readings[-1]["closure"] <= 1.0  # more than shut it cannot be


def test_a_closure_in_time_spares_the_eye_the_puff() -> None:
    in_time, _ = run(config(), lambda ms: 100.0 * (300 <= ms < 450))
    (trial,) = in_time.trials(0)
    assert trial.conditioned
    assert trial.felt < 0.05
    assert trial.onset_ms == pytest.approx(210)  # 300 ms are 200 behind the tone; in 10 ms it shuts by 0.28
    assert trial.peak_ms == pytest.approx(350)
    assert trial.peak == pytest.approx(1 - math.exp(-150 / 30))
    (figures,) = in_time.metrics()
    assert figures == {
        "conditioned.only": 1.0,
        "late_conditioned.only": 1.0,
        "late_peak_ms.only": trial.peak_ms,
        "late_felt.only": trial.felt,
    }


@pytest.mark.parametrize(("first", "last"), [(0, 90), (100, 110), (400, 600)])
def test_a_closure_before_the_tone_with_its_onset_or_with_the_puff_is_not_conditioned(first: int, last: int) -> None:
    task, _ = run(config(), lambda ms: 100.0 * (first <= ms < last))
    (trial,) = task.trials(0)
    assert not trial.conditioned


def test_late_figures_are_of_the_last_block_and_only_trials_with_a_tone_count() -> None:
    """The animal responds from its third trial on, and hears the tone in every other one."""
    phases = {"name": "first", "trials": 6, "stimuli": "unpaired"}, {"name": "second", "trials": 2}
    task, _ = run(config(*phases), lambda ms: 100.0 * (ms >= 1800 and 300 <= ms % 900 < 450), block=2)
    (figures,) = task.metrics()
    assert figures["conditioned.first"] == pytest.approx(2 / 3)
    assert figures["late_conditioned.first"] == figures["conditioned.second"] == 1.0
    assert [trial.phase for trial in task.trials(0)] == ["first"] * 6 + ["second"] * 2


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"interval": "800 ms"}, "let trials be longer"),
        ({"phases": [{"name": "a", "trials": 1}] * 2}, "two phases are called `a`"),
        ({"phases": []}, "at least 1"),
        ({"phases": [{"name": "a", "trials": 1, "stimuli": "shock"}]}, "'paired', 'tone', 'puff' or 'unpaired'"),
    ],
)
def test_a_chamber_that_cannot_be_is_refused(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValidationError, match=reason):
        ConditioningChamberConfig.model_validate(changes)


def test_a_task_that_cannot_be_is_refused() -> None:
    with pytest.raises(NeuroroboError, match=r"needs a `paradigms.conditioning_chamber`, not a Cart"):
        EyeblinkTask(EyeblinkTaskConfig(), Cart(CartConfig()))
    with pytest.raises(NeuroroboError, match="or no response can be conditioned"):
        EyeblinkTask(EyeblinkTaskConfig.model_validate({"earliest": "300 ms"}), ConditioningChamber(config()))


def test_the_criterion_is_the_first_block_of_ten_with_eight_responses() -> None:
    criterion = EYEBLINK["trials_to_criterion"]
    assert criterion([0] * 5 + [1] * 20) == 13
    assert criterion([1] * 8) is None
    assert criterion([0, 1] * 40) is None


def test_a_phase_is_told_by_its_trials() -> None:
    own = [Trial("acquisition", True, True, bool(k > 4), 200.0, 300.0, 0.9, 0.1) for k in range(10)]
    found = EYEBLINK["_phase"]("acquisition", own, np.tile([0.0, 0.5], (10, 1)))
    assert found["conditioned"] == "0000011111"
    assert found["late_trace"] == [0.0, 0.5]
    assert EYEBLINK["shares"](found["conditioned"]) == [50.0]


def test_when_a_lid_was_shut_is_counted_from_the_onset_of_the_tone() -> None:
    trace = [0.9, 0.9, 0.0, 0.1, 0.3, 0.6, 0.4]  # what happened before it does not count
    row = {"tone_onset_ms": 20.0, "tick_ms": 10.0, "phases": {"acquisition": {"late_trace": trace}}}
    assert (EYEBLINK["half_ms"](row), EYEBLINK["peak_ms"](row)) == (20.0, 30.0)


def test_the_figures_belong_to_the_present_example() -> None:
    """Where this fails, measure anew: `python benchmarks/paradigms/eyeblink.py`."""
    conditions = {condition.name: condition for condition in EYEBLINK["CONDITIONS"]}
    rows = json.loads((BENCHMARK / "eyeblink.json").read_text())["rows"]
    assert {row["condition"] for row in rows} == conditions.keys()
    for row in rows:
        condition = conditions[row["condition"]]
        changes = [*condition.chamber, *condition.brain, f"seed={row['seed']}"]
        assert load_experiment(EYEBLINK["EXAMPLE"], changes).config_hash == row["config_hash"]


def test_chambers_side_by_side_do_what_each_does_alone() -> None:
    """Bodies of one interval and of another, one of which ends earlier."""
    chambers = config(), config({"name": "a", "trials": 2}, interval="500 ms")
    alone = [run(chamber, lambda ms: float(ms % 200))[0].trials(0) for chamber in chambers]
    tasks = [EyeblinkTask(EyeblinkTaskConfig(), ConditioningChamber(chamber)) for chamber in chambers]
    together = SupervisedTask(EYEBLINK["SideBySide"](tasks))
    together.reset([0, 0], 2)
    running = np.array([True, True])
    for tick in range(180):
        _, done = together.step({"eyelid": np.full((2, 1), float(10 * tick % 200))}, TICK_NS, running)
        running &= ~done
    assert not running.any()
    assert [task.trials(0) for task in tasks] == alone


def test_the_documents_show_what_was_measured(tmp_path: Path) -> None:
    """Where this fails: `python benchmarks/paradigms/eyeblink.py --draw`."""
    rows = json.loads((BENCHMARK / "eyeblink.json").read_text())["rows"]
    EYEBLINK["publish"](rows, tmp_path)
    for name in ("eyeblink.md", "eyeblink.svg"):
        # The names of clip paths hang on what else the process has drawn.
        now, then = (
            re.sub(r"\bp[0-9a-f]{10}\b", "clip", (folder / name).read_text()) for folder in (tmp_path, BENCHMARK)
        )
        assert now == then, name


def test_the_text_says_what_was_measured() -> None:
    """The counts in `docs/how_to/eyeblink_conditioning.md`."""
    rows = json.loads((BENCHMARK / "eyeblink.json").read_text())["rows"]
    learned = [row for row in rows if row["condition"] in ("300 ms", "500 ms")]
    late = [row["phases"]["acquisition"]["conditioned"][-10:] for row in learned]
    assert late == ["1" * 10] * 10
    assert all(row["phases"]["acquisition"]["conditioned"][:10] == "0" * 10 for row in rows)
    assert not any("1" in row["phases"]["acquisition"]["conditioned"] for row in rows if row["condition"] == "unpaired")
    in_time = [0 <= EYEBLINK["peak_ms"](row) - row["interval_ms"] <= 50 for row in learned]
    assert sum(in_time) == 9
    first, second = (
        [row["phases"][phase]["trials_to_criterion"] for row in learned] for phase in ("acquisition", "reacquisition")
    )
    assert sum(again < before for before, again in zip(first, second, strict=True)) == 9
    assert sum(again == before for before, again in zip(first, second, strict=True)) == 1
    plain, still = (EYEBLINK["of"](rows, name) for name in ("300 ms", "300 ms, nuclei do not learn"))
    assert np.mean([_criterion(row, "acquisition") for row in plain]) == 29.4
    assert np.mean([_criterion(row, "reacquisition") for row in plain]) == 17.2
    assert np.mean([_criterion(row, "reacquisition") for row in still]) == 24.0
    half_ms = EYEBLINK["half_ms"]
    assert sum(half_ms(other) > half_ms(row) for row, other in zip(plain, still, strict=True)) == 4
    assert sum(70 <= half_ms(row) <= 150 for row in learned) == 9


def _criterion(row: Mapping[str, Any], phase: str) -> int:
    found: int = row["phases"][phase]["trials_to_criterion"]
    return found
