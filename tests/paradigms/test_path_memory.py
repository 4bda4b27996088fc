"""The arena leads and lets go, the task counts what is found again, and the regions compute what they say."""

import numpy as np
import pytest
import torch
from neurorobo_paradigms.path_memory.arena import Arena
from neurorobo_paradigms.path_memory.arena_config import ArenaConfig, DrawnPaths
from neurorobo_paradigms.path_memory.liquid import Liquid
from neurorobo_paradigms.path_memory.liquid_config import LiquidConfig
from neurorobo_paradigms.path_memory.path_recall import PathRecall
from neurorobo_paradigms.path_memory.path_recall_config import PathRecallConfig
from neurorobo_paradigms.path_memory.polyline import Polyline, draw_path
from neurorobo_paradigms.path_memory.readout import LeastSquaresReadout
from neurorobo_paradigms.path_memory.readout_config import LeastSquaresReadoutConfig
from pydantic import ValidationError

from neurorobo.bodies import Array
from neurorobo.clock import Clock
from neurorobo.codes.config import GaussianReceptiveFieldsConfig, PopulationUniformConfig
from neurorobo.regions.feedforward_config import CodedPort
from neurorobo.regions.ranged_port import RangedPort
from neurorobo.testing import check_body, check_region

TICK_NS = 50_000_000
CLOCK = Clock({"control": TICK_NS}, 5_000_000, 10)
CORNER = ((0.1, 0.1), (0.5, 0.1), (0.5, 0.5))
PLACE = CodedPort(unit="m", width=2, range="0..1 m", code=GaussianReceptiveFieldsConfig(neurons=14))
SPIKES = CodedPort(unit="1", range="0..1", code=PopulationUniformConfig(neurons=12))
GOAL = RangedPort(unit="m", width=2, range="0..1 m")


def arena(**settings: object) -> Arena:
    """One agent on a path around a corner."""
    body = Arena(ArenaConfig.model_validate({"paths": (CORNER,), "disturbance": "0 m/s", **settings}))
    body.reset([0])
    return body


def walk(body: Arena, goal_m: Array) -> None:
    body.advance({"goal": goal_m.reshape(1, 2)}, TICK_NS)


def finish(body: Arena, knows: bool) -> dict[str, float]:
    """Finish an episode of an agent that knows the path, or of one that stays where it is."""
    task = PathRecall(PathRecallConfig(), body)
    task.reset(1)
    (agent,) = body.agents
    while not task.terminated()[0]:
        ahead_s = (agent.elapsed_ns - body.config.cue + body.config.horizon) * 1e-9
        walk(body, agent.path.at(body.config.speed * ahead_s) if knows else agent.place_m)
        task.observe(TICK_NS, np.ones(1, dtype=np.bool_))
    return dict(task.metrics()[0])


def test_body_and_regions_keep_their_contracts() -> None:
    noisy = {"disturbance": "0.1 m/s", "sensor_noise": "0.02 m", "start_offset": "0.1 m", "cue": "1 ms"}
    drawn = {"paths": {"number": 2}, "led_runs": 0, "guided_runs": 0}
    check_body(ArenaConfig.model_validate(noisy), period_ns=TICK_NS)
    check_body(ArenaConfig.model_validate({**noisy, **drawn}), period_ns=TICK_NS)
    check_region(LiquidConfig(inputs={"place": PLACE}, neurons=60, fan_in=6), CLOCK)
    check_region(LeastSquaresReadoutConfig(inputs={"spikes": SPIKES}, output=GOAL), CLOCK)


def test_whoever_is_led_goes_along_the_path_whatever_its_goal() -> None:
    body = arena()
    (agent,) = body.agents
    ticks = 0
    while not agent.over:
        walk(body, np.array([0.9, 0.9]))
        assert min(agent.path.distance_m(agent.place_m, stretch) for stretch in (1, 2)) < 1e-9
        ticks += agent.moved
    assert agent.place_m == pytest.approx(CORNER[-1], abs=0.3 * 0.05)
    assert ticks == np.ceil(0.8 / (0.3 * 0.05))


def test_the_correction_is_what_the_goal_lacks_of_the_place_after_the_horizon() -> None:
    body, goal_m = arena(cue="50 ms"), np.array([0.3, 0.4])
    walk(body, goal_m)
    assert body.read()["correction"].tolist() == [[0.0, 0.0]]
    walk(body, goal_m)
    assert body.read()["correction"][0] == pytest.approx(np.array([0.1 + 0.3 * 0.4, 0.1]) - goal_m)


def test_nobody_is_corrected_alone() -> None:
    body = arena(led_runs=0, guided_runs=0)
    (agent,) = body.agents
    while not agent.finished:
        walk(body, np.array([0.9, 0.9]))
        assert not body.read()["correction"].any()
        assert body.read()["alone"][0, 0] == agent.moved


def test_who_knows_the_path_finds_it_and_who_stays_does_not() -> None:
    found = finish(arena(), knows=True)
    assert found["waypoints_reached"] == found["success"] == 1.0
    assert found["deviation_m"] < 0.03
    assert found["last_correction_m"] == pytest.approx(0.0, abs=1e-9)
    stayed = finish(arena(), knows=False)
    assert stayed["waypoints_reached"] == stayed["success"] == 0.0


def test_waypoints_count_in_their_order_only() -> None:
    """An agent that goes to the last one at once reaches none, and is lost on the way."""
    body = arena(led_runs=0, guided_runs=0)
    task = PathRecall(PathRecallConfig(), body)
    task.reset(1)
    while not task.terminated()[0]:
        walk(body, np.array(CORNER[-1]))
        task.observe(TICK_NS, np.ones(1, dtype=np.bool_))
    (found,) = task.metrics()
    assert found["waypoints_reached"] == 0.0
    assert 0 < found["steps_until_lost"] < 0.15 * 2**0.5 / (1.5 * 0.3 * 0.05) + 1


def test_drawn_paths_are_within_their_limits() -> None:
    drawn = DrawnPaths(waypoints=12)
    for seed in range(20):
        path = draw_path(drawn, 1.0, np.random.default_rng(seed))
        assert ((path.waypoints_m >= 0.1) & (path.waypoints_m <= 0.9)).all()
        way_m = np.diff(path.waypoints_m, axis=0)
        lengths_m = np.hypot(*way_m.T)
        assert ((lengths_m >= 0.25) & (lengths_m <= 0.45)).all()
        cosines = (way_m[1:] * way_m[:-1]).sum(1) / (lengths_m[1:] * lengths_m[:-1])
        assert (cosines >= np.cos(np.deg2rad(110.0)) - 1e-9).all()


def test_a_polyline_is_measured_along_its_stretches() -> None:
    path = Polyline.through(np.array(CORNER))
    assert path.length_m == pytest.approx(0.8)
    assert path.at(0.6) == pytest.approx([0.5, 0.3])
    assert path.distance_m(np.array([0.2, 0.2]), 1) == pytest.approx(0.1)
    assert path.distance_m(np.array([0.2, 0.2]), 2) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"paths": []}, "there is no path"),
        ({"paths": [[[0.1, 0.1], [0.1, 0.1]]]}, "twice in a row"),
        ({"paths": {"shortest": "0.5 m", "longest": "0.3 m"}}, "exchange them"),
        ({"paths": {"longest": "0.9 m"}}, "do not fit"),
    ],
)
def test_paths_that_cannot_be_are_refused(settings: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        ArenaConfig.model_validate(settings)


def test_the_liquid_is_the_equations_of_its_docstring_and_of_sparse_synapses_of_fixed_sign() -> None:
    config = LiquidConfig(inputs={"place": PLACE}, neurons=50, fan_in=5)
    liquid = Liquid(config, CLOCK, torch.Generator().manual_seed(0))
    weight, recurrent = liquid.input_weight.detach(), liquid.recurrent_weight.detach()
    assert ((weight != 0).sum(1) <= 4).all() and (weight >= 0).all()
    assert ((recurrent != 0).sum(1) <= 5).all()
    assert (recurrent[:, :40] >= 0).all() and (recurrent[:, 40:] <= 0).all()
    heard = torch.rand(10, 1, 28, generator=torch.Generator().manual_seed(1)).round()
    found, _ = liquid.step({"place": heard}, liquid.init_state(1))
    m, c = np.exp(-5 / 50), np.exp(-5 / 300)
    potential = current = last = np.zeros(50)
    for step in range(10):
        current = c * current + (1 - c) * recurrent.double().numpy() @ last
        potential = m * potential * (1 - last) + weight.double().numpy() @ heard[step, 0].double().numpy() + current
        last = (potential >= 1).astype(float)
        assert found["spikes"][step, 0].tolist() == last.tolist()
    assert found["spikes"].any()


def test_the_liquid_remembers_by_its_recurrence() -> None:
    """States that began at two places, 300 ms after both came to a third one: how different they are in spikes."""
    differ = {}
    for strength in (0.0, 0.6):
        config = LiquidConfig(inputs={"place": PLACE}, recurrent_strength=strength)
        liquid = Liquid(config, CLOCK, torch.Generator().manual_seed(0))
        code = PLACE.port().code
        assert code is not None
        counts = []
        for start in (0.2, 0.8):
            state = liquid.init_state(1)
            for place in [start] * 10 + [0.5] * 6:
                spoken, state = liquid.step({"place": code.encode(torch.full((1, 2), place), 10)}, state)
            counts.append(spoken["spikes"].sum((0, 1)))
        differ[strength] = float((counts[0] - counts[1]).abs().sum() / (counts[0] + counts[1]).sum())
    assert differ[0.0] < 0.03
    assert differ[0.6] > 0.1


def test_the_readout_has_the_weights_of_ridge_regression_on_all_that_it_was_told() -> None:
    config = LeastSquaresReadoutConfig(inputs={"spikes": SPIKES}, output=GOAL, ridge=0.05)
    readout = LeastSquaresReadout(config, CLOCK, torch.Generator())
    generator = torch.Generator().manual_seed(0)
    state, error = readout.init_state(1), torch.zeros(1, 2)
    heard, wanted = [], []
    for _ in range(30):
        spikes = torch.rand(10, 1, 12, generator=generator).round()
        said, state = readout.step({"spikes": spikes, "error": error}, state)
        heard.append(state["filtered"][0])
        wanted.append(0.3 + 0.4 * torch.rand(2, generator=generator).double())
        unclipped = 0.5 + state["weight"][0] @ heard[-1]
        assert said["said"][0].tolist() == pytest.approx(unclipped.clamp(0, 1).tolist(), abs=1e-6)
        error = (wanted[-1] - unclipped).float().unsqueeze(0)
    _, state = readout.step({"spikes": spikes, "error": error}, state)
    x, y = torch.stack(heard), torch.stack(wanted) - 0.5
    ridge = torch.linalg.solve(x.t() @ x + 0.05 * torch.eye(12, dtype=torch.double), x.t() @ y)
    assert state["weight"][0].t().numpy() == pytest.approx(ridge.numpy(), abs=1e-4)
    _, after = readout.step({"spikes": spikes, "error": torch.zeros(1, 2)}, state)
    assert torch.equal(after["weight"], state["weight"]) and torch.equal(after["inverse"], state["inverse"])
