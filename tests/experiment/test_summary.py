"""The figures of a summary, against numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurorobo.experiment.closed_loop import EpisodeResult
from neurorobo.experiment.summary import summarise

figures = st.floats(-1e6, 1e6)


@given(st.lists(st.tuples(figures, figures, st.floats(0, 1)), min_size=2, max_size=40))
def test_mean_standard_error_and_worst(episodes: list[tuple[float, float, float]]) -> None:
    results = [
        EpisodeResult(seed, {"force_mN": force, "score": score}, {"cortex": rate})
        for seed, (force, score, rate) in enumerate(episodes)
    ]
    summary = summarise(results, {"score"})
    assert [episode["seed"] for episode in summary["episodes"]] == list(range(len(episodes)))
    assert [episode["firing_rate.cortex"] for episode in summary["episodes"]] == [rate for *_, rate in episodes]
    columns = dict(zip(("force_mN", "score", "firing_rate.cortex"), np.transpose(episodes), strict=True))
    assert summary["aggregate"].keys() == {*columns, "saturations"}
    for name, values in columns.items():
        figure = summary["aggregate"][name]
        assert figure["mean"] == pytest.approx(values.mean(), rel=1e-9, abs=1e-6)
        error = values.std(ddof=1) / np.sqrt(len(values))
        assert figure["standard_error"] == pytest.approx(error, rel=1e-9, abs=1e-6)
        assert figure["worst"] == (values.min() if name == "score" else values.max())


def test_the_standard_error_of_one_episode_is_not_known() -> None:
    summary = summarise([EpisodeResult(4, {"force_mN": 2.0}, {})], ())
    assert summary["aggregate"]["force_mN"] == {"mean": 2.0, "standard_error": None, "worst": 2.0}


def test_nothing_is_summarised_as_nothing() -> None:
    assert summarise([], ()) == {"episodes": [], "aggregate": {}}


def test_an_input_is_listed_for_every_episode_if_it_saturated_in_any() -> None:
    results = [EpisodeResult(1, {}, {}, {"plan.force": 3, "move.speed": 1}), EpisodeResult(2, {}, {})]
    first, second = summarise(results, ())["episodes"]
    assert first == {"seed": 1, "saturations": 4, "saturations.move.speed": 1, "saturations.plan.force": 3}
    assert second == {"seed": 2, "saturations": 0, "saturations.move.speed": 0, "saturations.plan.force": 0}
