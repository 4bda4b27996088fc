"""Brain, body and task in a closed loop, many episodes side by side."""

from collections.abc import Sequence
from contextlib import nullcontext

import numpy as np
import pytest

from neurorobo.bodies import Array
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.closed_loop import EpisodeResult, run_episodes
from neurorobo.graph.brain import Brain
from tests.experiment.toys import SECOND, NoisyConfig, Notes, brain
from tests.tasks.toys import Cart, CartConfig, Reach, ReachConfig, reach

SEEDS = list(range(3, 11))


def together_and_alone(brain: Brain) -> tuple[Sequence[EpisodeResult], Sequence[EpisodeResult]]:
    return run_episodes(brain, reach(0.8), SEEDS), [run_episodes(brain, reach(0.8), [seed])[0] for seed in SEEDS]


def test_what_an_episode_does_depends_on_its_seed_and_not_on_its_batch() -> None:
    together, alone = together_and_alone(brain())
    assert together == alone
    assert [result.seed for result in together] == SEEDS
    assert len({result.metrics["error_um"] for result in together}) == len(SEEDS)
    assert np.ptp([result.metrics["duration_s"] for result in together]) > 2  # some go on while others have ended
    assert all(0 < result.firing_rates["watcher"] < 1 for result in together)


def test_also_with_a_code_that_draws_its_spikes() -> None:
    together, alone = together_and_alone(brain(watcher=NoisyConfig()))
    assert together == alone


def test_equal_seeds_give_equal_episodes_and_others_others() -> None:
    first, again, other = (run_episodes(brain(), reach(), [seed]) for seed in (1, 1, 2))
    assert first == again
    assert first[0].metrics != other[0].metrics


def test_an_episode_is_watched_until_its_end_and_no_longer() -> None:
    notes = Notes()
    results = run_episodes(brain(), reach(0.8), SEEDS, recorders=[notes])
    ticks = np.sum([sample.running for sample in notes.samples], axis=0)
    assert ticks.tolist() == [result.metrics["duration_s"] for result in results]
    assert [sample.tick for sample in notes.samples] == list(range(max(ticks)))
    assert [sample.time_s for sample in notes.samples] == [float(tick) for tick in range(max(ticks))]


def test_the_firing_rate_is_that_of_the_layers_while_the_episode_runs() -> None:
    notes = Notes()
    results = run_episodes(brain(), reach(0.8), SEEDS, recorders=[notes])
    fired, chances = np.zeros(len(SEEDS)), np.zeros(len(SEEDS))
    for sample in notes.samples:
        for spikes in sample.spikes.get("watch", {}).values():
            fired += np.where(sample.running, spikes.some.sum((0, 2)), 0)
            chances += np.where(sample.running, spikes.some.shape[0] * spikes.neurons, 0)
    assert [result.firing_rates for result in results] == [
        {"watcher": pytest.approx(rate)} for rate in (fired / chances).tolist()
    ]


def test_samples_hold_what_was_read_what_was_done_and_what_was_computed() -> None:
    notes = Notes()
    run_episodes(brain(), reach(noise=0.0), [1], recorders=[notes])
    first, second = notes.samples[:2]
    assert first.observation["position"].tolist() == [[0.0, 0.0]]
    assert first.outputs["drive"]["speed"].tolist() == [[14.0]]
    assert first.given["speed"].tolist() == [[1.0]]
    assert second.observation["position"].tolist() == [[1.0, 0.0]]
    assert set(first.outputs) == {"drive", "watch"}
    assert set(second.outputs) == {"drive"}  # the other step is a slow one
    assert {layer: spikes.some.shape for layer, spikes in first.spikes["watch"].items()} == {
        "hidden": (20, 1, 10),
        "output": (20, 1, 6),
    }
    for spikes in first.spikes["watch"].values():
        assert spikes.rate.tolist() == pytest.approx(spikes.some.mean((0, 2)).tolist())
    assert first.outputs["watch"]["move"].shape == (1, 1)  # decoded


def test_interventions_are_counted_among_the_metrics() -> None:
    asked_for_too_much, content = (run_episodes(brain(gain), reach(noise=0.0), [1])[0].metrics for gain in (4.0, 0.25))
    assert asked_for_too_much == {"duration_s": 3.0, "success": 1.0, "error_um": 0.0, "command_interventions": 3.0}
    assert content["command_interventions"] == 0.0


def test_a_recorder_sees_each_intervention_beside_what_was_sensed() -> None:
    notes = Notes()
    results = run_episodes(brain(), reach(0.8), SEEDS, recorders=[notes])
    counts = {name: np.zeros(len(SEEDS)) for name in ("speed", "nudge")}
    for sample in notes.samples:
        assert sample.interventions.keys() == counts.keys()
        for name, count in sample.interventions.items():
            counts[name] += count
        too_fast = 4 * np.abs(3.5 - sample.observation["position"][:, 0]) > 1 + 1e-5
        assert np.array_equal(sample.interventions["speed"], too_fast & sample.running)
    assert counts["speed"].all()
    assert [result.metrics["command_interventions"] for result in results] == sum(counts.values()).tolist()


def test_a_duration_cuts_a_run_off_and_replaces_a_task() -> None:
    notes = Notes()
    (result,) = run_episodes(brain(), reach(), [1], duration_ns=2 * SECOND, recorders=[notes])
    assert result.metrics["duration_s"] == 2.0
    assert len(notes.samples) == 2
    with pytest.raises(ValueError, match="the duration must be given"):
        run_episodes(brain(), None, [1])


def test_progress_tells_the_tick_and_how_many_are_running() -> None:
    told: list[tuple[int, int]] = []
    results = run_episodes(brain(), reach(0.8), SEEDS, progress=lambda tick, running: told.append((tick, running)))
    durations = np.array([result.metrics["duration_s"] for result in results])
    assert told == [(tick, (durations > tick).sum()) for tick in range(int(durations.max()))]


@pytest.mark.parametrize("error", [None, KeyboardInterrupt, ZeroDivisionError])
def test_the_body_stands_still_however_a_run_ends(error: type[BaseException] | None) -> None:
    task = reach(0.0)

    def progress(tick: int, running: int) -> None:
        if error is not None and tick == 2:
            assert task.body.speed.tolist() == [[1.0]]
            raise error

    with nullcontext() if error is None else pytest.raises(error):
        run_episodes(brain(), task, [1], progress=progress)
    assert task.body.stopped == 1
    assert task.body.speed.tolist() == [[0.0]]


class Failing(Cart):
    """Its force sensor breaks, in all carts or those beyond a place."""

    beyond = -np.inf

    def read(self) -> dict[str, Array]:
        sensed = super().read()
        return {**sensed, "force": np.where(self.position[:, :1] >= self.beyond, np.nan, sensed["force"])}


def test_a_sensor_that_is_no_number_ends_the_run() -> None:
    task = Reach(ReachConfig(), Failing(CartConfig()))
    with pytest.raises(NeuroroboError, match="the sensor `force` reports nan: the body was stopped"):
        run_episodes(brain(), task, [1])
    assert task.body.stopped == 1


def test_a_sensor_may_fail_in_an_episode_that_has_ended() -> None:
    body = Failing(CartConfig(noise=0.8))
    body.beyond = ReachConfig().goal_um
    results = run_episodes(brain(), Reach(ReachConfig(), body), SEEDS)
    assert len({result.metrics["duration_s"] for result in results}) > 1


def test_saturations_are_the_components_out_of_range_while_an_episode_runs() -> None:
    notes = Notes()
    results = run_episodes(brain(), reach(0.8), SEEDS, recorders=[notes])
    wanted = np.zeros(len(SEEDS))
    for sample in notes.samples:
        if "watch" not in sample.outputs:
            continue  # what is not read does not count
        outside = (np.abs(sample.observation["force"]) > 1.0).sum(axis=1)  # the range of the watcher's code
        wanted += np.where(sample.running, outside, 0)
    assert (wanted.any() and not wanted.all()) or len(set(wanted)) > 1
    assert [dict(result.saturations) for result in results] == [
        {"watch.force": int(count)} if count else {} for count in wanted
    ]
