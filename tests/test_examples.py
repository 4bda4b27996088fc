"""Every example does what it is there for."""

import json
import runpy
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from neurorobo.config.experiment import load_experiment
from neurorobo.experiment.lessons import read_lessons
from neurorobo.experiment.train import train_experiment
from neurorobo.plugins import Registry

EXAMPLES = Path(__file__).parents[1] / "examples"
INSERTIONS = sorted(  # the one on hardware needs a rig: tests of the bundle bring a virtual one up
    path.name
    for path in EXAMPLES.glob("*.yaml")
    if path.name.startswith(("peg_in_hole", "baseline")) and "hardware" not in path.name
)

needs_mujoco = pytest.mark.skipif(
    any(find_spec(name) is None for name in ("mujoco", "glfw", "imageio")), reason="the extra `mujoco` is not installed"
)


def run(tmp_path: Path, file: str, *options: str) -> dict[str, object]:
    """Run an example from the command line, as a user would, and return what it prints."""
    command = [str(Path(sys.executable).with_name("neurorobo")), "run", str(EXAMPLES / file)]
    command += ["--json", "--out", str(tmp_path / "run"), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    printed: dict[str, object] = json.loads(done.stdout)
    return printed


@pytest.mark.parametrize("file", INSERTIONS)
def test_an_insertion_ends_at_the_bottom_and_leaves_a_run_folder(tmp_path: Path, file: str) -> None:
    if "mujoco" in file and find_spec("mujoco") is None:
        pytest.skip("the extra `mujoco` is not installed")
    summary = run(tmp_path, file, "--seed", "1000")
    (episode,) = summary["episodes"]  # type: ignore[misc]
    assert episode["success"] == 1.0
    assert episode["final_error_um"] <= 1.0
    assert episode["overshoot_um"] == 0.0
    assert {path.name for path in (tmp_path / "run").iterdir()} == {
        "config.yaml",
        "config.resolved.yaml",
        "run.json",
        "summary.json",
        "timing.json",
        "trajectory.parquet",
        "recording.rrd",
    }


def test_the_radial_loop_may_run_at_20_hz(tmp_path: Path) -> None:
    summary = run(
        tmp_path, "peg_in_hole_fast.yaml", "--seed", "1000", "--set", "time.radial=50 ms", "--set", "record=[]"
    )
    assert summary["aggregate"]["success"]["mean"] == 1.0  # type: ignore[index]


def test_the_minimal_example_spikes_without_a_robot(tmp_path: Path) -> None:
    summary = run(tmp_path, "minimal.yaml")
    assert set(summary["aggregate"]) == {"firing_rate.ping", "firing_rate.pong", "saturations"}  # type: ignore[call-overload]
    assert len((EXAMPLES / "minimal.yaml").read_text().splitlines()) < 25


def test_the_network_of_a_tutorial_of_snntorch_fires_the_same_spikes_here(tmp_path: Path) -> None:
    script = EXAMPLES / "snntorch_tutorial.py"
    done = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    steps = done.stdout.splitlines()
    assert len(steps) == 25
    assert all(step.endswith(" the same") for step in steps)
    assert any("1" in step for step in steps)
    assert len(script.read_text().splitlines()) < 30
    weights = f"regions.classifier.weights={tmp_path / 'snntorch_tutorial.safetensors'}"
    found = [
        run(tmp_path / str(seed), "snntorch_tutorial.yaml", "--set", weights, "--seed", str(seed)) for seed in (1, 2)
    ]
    assert found[0]["episodes"] != found[1]["episodes"]  # the images are drawn as spikes


def test_neurons_learn_to_fire_more_by_a_reward_that_comes_late(tmp_path: Path) -> None:
    """Those that are rewarded, and not the others, who are told the same."""
    rates = []
    for duration in ("10 s", "120 s"):
        summary = run(tmp_path / duration, "distal_reward.yaml", "--set", f"episode.duration={duration}")
        (episode,) = summary["episodes"]  # type: ignore[misc]
        rates.append([1000 * episode[f"firing_rate.{name}"] for name in ("rewarded", "other")])
    (rewarded, other), (rewarded_later, other_later) = rates
    assert rewarded_later > 1.15 * rewarded  # on average over all 120 s; in the end it is half as much again
    assert other_later < 1.1 * other


def test_a_path_is_walked_alone_after_an_agent_was_led_along_it(tmp_path: Path) -> None:
    """A bend of three stretches, in place of the figure of eight."""
    bend = "body.paths=[[[0.2, 0.2], [0.5, 0.2], [0.6, 0.45], [0.4, 0.6]]]"
    summary = run(tmp_path, "path_memory.yaml", "--seed", "1000", "--set", bend)
    (episode,) = summary["episodes"]  # type: ignore[misc]
    assert episode["waypoints_reached"] == episode["success"] == 1.0
    assert episode["deviation_m"] < 0.05


def test_a_cerebellum_learns_to_shut_the_eye_and_unlearns_it(tmp_path: Path) -> None:
    """Ten times as fast as the example, so that ten trials are enough."""
    phases = [
        {"name": "acquisition", "trials": 10},
        {"name": "extinction", "trials": 10, "stimuli": "tone"},
    ]
    changes = {
        "body.phases": json.dumps(phases),
        "regions.cerebellum.layers.purkinje.synapses.granule.learns.0.learning_rate": 10,
        "task.block": 3,
    }
    options = [word for path, value in changes.items() for word in ("--set", f"{path}={value}")]
    summary = run(tmp_path, "eyeblink.yaml", *options)
    (episode,) = summary["episodes"]  # type: ignore[misc]
    assert episode["late_conditioned.acquisition"] == 1.0
    assert episode["late_felt.acquisition"] < 0.7
    assert episode["late_conditioned.extinction"] == 0.0


@pytest.mark.parametrize(("wanted", "learns"), [(1.5, True), (0.5, True), (1.5, False)])
def test_the_vestibulo_ocular_reflex_is_adapted_and_stays_so_in_the_dark(
    tmp_path: Path, wanted: float, learns: bool
) -> None:
    """More than halfway within 20 s, by climbing fibres alone."""
    rate = "regions.flocculus.layers.purkinje.synapses.granule.learns.0.learning_rate"
    changes = ["record=[]", "body.phases.learning.cycles=20", f"body.phases.learning.wanted_gain={wanted}"]
    changes += [] if learns else [f"{rate}=0"]
    options = [word for change in changes for word in ("--set", change)]
    summary = run(tmp_path, "vestibulo_ocular_reflex.yaml", "--seed", "1000", *options)
    (episode,) = summary["episodes"]  # type: ignore[misc]
    before, after = episode["before.gain"], episode["after.gain"]
    assert before == pytest.approx(1.0, abs=0.1)
    if learns:
        assert 0.5 < (after - before) / (wanted - before) < 1.1
        assert episode["learning.slip_deg_s"] < episode["learning.first_slip_deg_s"] / 1.5
    else:
        assert after == pytest.approx(before, abs=0.01)


@pytest.mark.parametrize(
    ("file", "least"), [("pendulum.yaml", -500.0), pytest.param("double_pendulum.yaml", 5000.0, marks=needs_mujoco)]
)
def test_a_pendulum_is_held_up_by_the_weights_that_the_reward_has_left(tmp_path: Path, file: str, least: float) -> None:
    """Fresh weights gain -1400 and 30."""
    summary = run(tmp_path, file, "--seed", "1000", "--episodes", "4")
    assert summary["aggregate"]["return"]["mean"] > least  # type: ignore[index]
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {"summary.json", "trajectory.parquet"}


@needs_mujoco
@pytest.mark.parametrize("actor", ["spiking", "dense"])
def test_ppo_learns_an_environment_from_fresh_weights(tmp_path: Path, actor: str) -> None:
    """As the benchmark trains, only much shorter."""
    benchmark = runpy.run_path(str(EXAMPLES.parent / "benchmarks" / "control" / "returns.py"))
    file = EXAMPLES / "double_pendulum.yaml"
    shorter = ["train.0.iterations=10", "train.0.validation.episodes=4", "train.0.held_out.episodes=8"]
    changes = [*benchmark["overrides"](actor, load_experiment(file), 1000), *shorter]
    experiment = load_experiment(file, changes, registry := Registry.discover())
    reports = train_experiment(experiment, read_lessons(experiment, registry)[:1], tmp_path)
    found = reports[0].evaluation["held_out"]
    assert np.mean(found["after"]["return"]) > 1.5 * np.mean(found["before"]["return"])


def test_a_run_can_be_repeated_from_its_folder_bit_for_bit(tmp_path: Path) -> None:
    first = run(tmp_path, "peg_in_hole_teachers.yaml", "--seed", "1000")
    (tmp_path / "run").rename(tmp_path / "before")
    again = run(tmp_path, str(tmp_path / "before" / "config.resolved.yaml"), "--seed", "1000")
    assert first["episodes"] == again["episodes"]


def test_the_same_seed_gives_the_same_result_twice(tmp_path: Path) -> None:
    first = run(tmp_path, "peg_in_hole.yaml", "--seed", "1003", "--set", "record=[]")
    (tmp_path / "run").rename(tmp_path / "before")
    assert run(tmp_path, "peg_in_hole.yaml", "--seed", "1003", "--set", "record=[]")["episodes"] == first["episodes"]


def test_episodes_in_a_row_go_on_from_what_was_learned(tmp_path: Path) -> None:
    """The first of two is the same as alone; the second is not the one that starts from the weights."""
    options = ("--set", "record=[]", "--set", "body.length=300 um", "--set", "regions.gap.length=300 um")
    found = []
    for row in ((), ("--in-a-row",)):
        where = tmp_path / str(len(row))
        summary = run(where, "peg_in_hole_adaptive.yaml", "--seed", "1000", "--episodes", "2", *row, *options)
        found.append([episode["mean_force_mN"] for episode in summary["episodes"]])  # type: ignore[attr-defined]
    assert found[0][0] == found[1][0]
    assert found[0][1] != found[1][1]
