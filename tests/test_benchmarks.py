"""Every script of the project can be imported; to run them all would take hours."""

import runpy
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]
FILES = sorted([*PROJECT.glob("benchmarks/*/*.py"), *PROJECT.glob("plugins/*/tools/*.py")])
SCRIPTS = [file for file in FILES if "__main__" in file.read_text()]


def test_there_are_scripts() -> None:
    assert SCRIPTS


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: str(path.relative_to(PROJECT)))
def test_a_script_can_be_imported(script: Path) -> None:
    assert callable(runpy.run_path(str(script))["main"])


def test_training_from_scratch_is_held_to_time_and_figures() -> None:
    benchmark = runpy.run_path(str(PROJECT / "benchmarks" / "training" / "from_scratch.py"))

    def row(steps: float, inserted: int = 3) -> dict[str, object]:
        figures = {"steps": steps, "mean_force_mN": 20.0, "max_force_mN": 45.0}
        return {"inserted": inserted, "figures": {name: {"mean": mean} for name, mean in figures.items()}}

    def misses(minutes: float, trained: dict[str, object]) -> list[str]:
        result = {"training": {"minutes": minutes}, "shipped": row(28.0), "trained": trained}
        found: list[str] = benchmark["misses"](result, 3)
        return found

    assert misses(59.0, row(29.0)) == []
    assert [miss.split()[0] for miss in misses(61.0, row(32.0, inserted=2))] == ["training", "inserted", "steps"]


def test_latency_is_held_to_figures() -> None:
    figure = runpy.run_path(str(PROJECT / "benchmarks" / "latency" / "control_period.py"))["Figure"]
    assert not figure("period", 10.0, "ms", most=10).missed
    assert figure("period", 10.1, "ms", most=10).missed
    assert not figure("gain", 1.2, "times", least=1.2).missed
    assert str(figure("gain", 1.1, "times", least=1.2)).endswith("wanted at least 1.2  MISSED")


def test_the_time_of_a_period_is_told_apart() -> None:
    benchmark = runpy.run_path(str(PROJECT / "benchmarks" / "latency" / "control_period.py"))
    rig = benchmark["Rig"]()
    assert len(rig.periods_ms([1000], recorded=True)) == len(rig.periods_ms([1000, 1001])) > 20
    assert 0.0 < rig.share_outside(1000) < 0.9
