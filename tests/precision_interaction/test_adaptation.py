"""Regions that learn while they run: what they learn, what they must not touch, and that it lasts."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from precision_interaction import table_one
from precision_interaction.regions.adaptive_cerebellum import AdaptiveCerebellum
from precision_interaction.regions.adaptive_cerebellum_config import AdaptiveCerebellumConfig
from precision_interaction.regions.adaptive_hippocampus import AdaptiveHippocampus
from precision_interaction.regions.adaptive_hippocampus_config import AdaptiveHippocampusConfig
from precision_interaction.regions.cerebellum import Cerebellum
from precision_interaction.regions.cerebellum_config import CerebellumConfig
from precision_interaction.regions.comparator import Comparator
from precision_interaction.regions.comparator_config import ComparatorConfig
from precision_interaction.regions.hippocampus import Hippocampus
from precision_interaction.regions.hippocampus_config import HippocampusConfig
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.config.experiment import load_experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.memory import Memory
from neurorobo.graph.brain import Brain, BrainState
from neurorobo.regions.region import Region, State
from neurorobo.regions.values import from_numbers, to_numbers
from neurorobo.regions.weights import load_weights
from neurorobo.regions.weights_file import pretrained_path
from neurorobo.testing import check_region

EXAMPLES = Path(__file__).parents[2] / "examples"
CLOCK = Clock({"control": 10**9, "radial": 10**9}, 10**6, 50)
FAST = Clock({"control": 10**9, "radial": 50 * 10**6}, 10**6, 50)
SMALL = {"granule_cells": 400, "purkinje_cells": 80}
AT_20_HZ = ('time.radial="50 ms"',)
OFF = ("regions.hippocampus.learning_rate=0", "regions.hippocampus.variance_learning_rate=0")


def spikes(region: Region, values: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: from_numbers(values[name], port.code, 50, []) for name, port in region.input_ports.items()}


def felt(batch: int, error_mN: Tensor, seed: int = 1) -> dict[str, Tensor]:
    """States of a radial loop at 20 Hz, and what the climbing fibres tell."""
    generator = torch.Generator().manual_seed(seed)
    force_mN = 8 * torch.randn(batch, 2, generator=generator)
    there = {"velocity": (0.7, 1.3), "mean": (3.0, 5.0), "variance": (6.0, 3.0)}
    return {"force": force_mN, "error": error_mN, **{n: torch.tensor([v]).expand(batch, 2) for n, v in there.items()}}


def cerebellum(**options: Any) -> AdaptiveCerebellum:
    config = AdaptiveCerebellumConfig.model_validate({**SMALL, **options})
    return AdaptiveCerebellum(config, FAST, torch.Generator().manual_seed(1))


def pretrained(region: Region) -> Any:
    load_weights(region, pretrained_path(region.config, region.clock))
    return region


@pytest.fixture(scope="module")
def shipped() -> AdaptiveCerebellum:
    return pretrained(AdaptiveCerebellum(AdaptiveCerebellumConfig(), FAST, torch.Generator()))  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def hippocampus() -> AdaptiveHippocampus:
    return pretrained(AdaptiveHippocampus(AdaptiveHippocampusConfig(), CLOCK, torch.Generator()))  # type: ignore[no-any-return]


@pytest.mark.parametrize("config", [AdaptiveCerebellumConfig(**SMALL), AdaptiveHippocampusConfig(), ComparatorConfig()])  # type: ignore[arg-type]
def test_they_keep_the_contract(config: Any) -> None:
    check_region(config, CLOCK)


@pytest.mark.parametrize("clock", [CLOCK, FAST])
def test_weights_are_those_of_the_plain_regions(clock: Clock) -> None:
    for adaptive, plain in (
        (AdaptiveCerebellumConfig(learning_rate=0.5), CerebellumConfig()),
        (AdaptiveHippocampusConfig(learning_rate=0.5), HippocampusConfig()),
    ):
        assert pretrained_path(adaptive, clock) == pretrained_path(plain, clock)


# ---- The cerebellum ----


def lessons(region: AdaptiveCerebellum, error_mN: Tensor, count: int) -> State:
    """Feel the same error again and again."""
    state = region.init_state(len(error_mN))
    with torch.inference_mode():
        for lesson in range(count):
            _, state = region.step(spikes(region, felt(len(error_mN), error_mN, lesson)), state)
    return state


def moves(region: Cerebellum, values: dict[str, Tensor], state: State) -> Tensor:
    with torch.inference_mode():
        outputs, _ = region.step(spikes(region, values), state)
    return to_numbers(outputs["move"], region.output_ports["move"].code)


def test_before_learning_it_is_the_plain_cerebellum(shipped: AdaptiveCerebellum) -> None:
    plain = pretrained(Cerebellum(CerebellumConfig(), FAST, torch.Generator()))
    values = felt(4, torch.zeros(4, 2))
    with torch.inference_mode():
        ours, _ = shipped.step(spikes(shipped, values), shipped.init_state(4))
        theirs, _ = plain.step({n: s for n, s in spikes(shipped, values).items() if n != "error"}, {})
    for name, value in theirs.items():
        assert torch.equal(ours[name], value)


def test_no_synapse_changes_its_sign_however_much_is_learned() -> None:
    region = cerebellum(learning_rate=10.0)
    for error_mN in (100.0, -100.0):
        state = lessons(region, torch.tensor([[error_mN, -error_mN]]), 5)
        assert state["synapses"].abs().max() == 1
        weights = region.parallel_fibre_weights(state)
        assert weights.min() >= 0
        assert weights.max() <= 2 * region.config.plastic_weight
        assert weights.max() > 1.5 * region.config.plastic_weight  # it did learn


def test_force_that_is_left_on_one_axis_leads_to_larger_moves_on_that_axis(shipped: AdaptiveCerebellum) -> None:
    values = felt(8, torch.zeros(8, 2), seed=99)
    before = moves(shipped, values, shipped.init_state(8))
    for axis in range(2):
        for sign in (1.0, -1.0):
            error_mN = torch.zeros(8, 2)
            error_mN[:, axis] = sign * 12.0
            state = {**lessons(shipped, error_mN, 10), "trace": torch.zeros(8, 4000)}
            change = (moves(shipped, values, state) - before).mean(0) * sign
            assert change[axis] > 0.002
            assert change[axis] > 1.2 * change[1 - axis].abs()


def test_microzones_move_one_axis_and_leave_the_rest(shipped: AdaptiveCerebellum) -> None:
    """A current by one axis' microzone, of either sign, moves that axis at least three times as far as the other."""
    values = felt(32, torch.zeros(32, 2), seed=5)
    before = moves(shipped, values, shipped.init_state(32))
    assert shipped.microzones().abs().sum(1).max() == pytest.approx(1)
    for axis in range(2):
        for sign in (1.0, -1.0):
            state = shipped.init_state(32)
            state["synapses"][:, axis] = sign * 0.002
            change = (moves(shipped, values, state) - before).mean(0) * sign
            assert change[axis] > 3 * change[1 - axis].abs()


def test_nothing_is_learned_from_noise_within_the_dead_zone_or_without_a_window_before() -> None:
    region = cerebellum()
    quiet = lessons(region, torch.tensor([[3.9, -3.9]]), 3)
    assert not quiet["synapses"].any()
    first = lessons(region, torch.tensor([[50.0, 50.0]]), 1)
    assert not first["synapses"].any()


def test_members_of_a_batch_learn_each_its_own() -> None:
    region = cerebellum(learning_rate=0.01)
    error_mN = torch.tensor([[20.0, -9.0], [0.0, 0.0], [-15.0, 30.0]])
    together = region.init_state(3)
    alone = [region.init_state(1) for _ in range(3)]
    with torch.inference_mode():
        for seed in range(4):
            inputs = spikes(region, felt(3, error_mN.roll(seed, 0), seed))  # each feels nothing now and then
            outputs, together = region.step(inputs, together)
            for i in range(3):
                own = {n: v[:, i : i + 1] if v.dim() == 3 else v[i : i + 1] for n, v in inputs.items()}
                one, alone[i] = region.step(own, alone[i])
                assert torch.equal(outputs["move"][:, i : i + 1], one["move"])
                for name, value in alone[i].items():
                    assert torch.equal(together[name][i : i + 1], value)
    assert all(synapses.any() for synapses in together["synapses"])


def test_what_was_learned_fades_while_nothing_is_felt() -> None:
    region = cerebellum(learning_rate=0.01, forgetting=0.25)
    learned = lessons(region, torch.tensor([[20.0, -9.0]]), 3)
    with torch.inference_mode():
        _, faded = region.step(spikes(region, felt(1, torch.zeros(1, 2))), learned)
    assert learned["synapses"].any()
    torch.testing.assert_close(faded["synapses"], 0.75 * learned["synapses"])


def test_plastic_cells_hear_the_force_of_one_axis_and_no_velocity(shipped: AdaptiveCerebellum) -> None:
    cells = shipped.plastic_cells()
    assert not (cells[0] & cells[1]).any() and (cells.sum(1) > 100).all()
    quiet = felt(1, torch.zeros(1, 2))
    for changed, deaf in (("velocity", cells.any(0)), ("force", ~cells[0])):
        other = {**quiet, changed: quiet[changed].clone()}
        other[changed][:, 0] += 0.5 if changed == "velocity" else 20.0
        with torch.inference_mode():
            one, two = (shipped.step(spikes(shipped, v), shipped.init_state(1))[1]["trace"][0] for v in (quiet, other))
        same = one == two
        assert same[cells[1] if changed == "force" else deaf].all()
        assert not same[cells[0] if changed == "force" else ~deaf].all()


# ---- The hippocampus ----


def look(region: Region, speed_um_s: float, windows: int, state: State | None = None) -> list[dict[str, Tensor]]:
    """Look some windows ahead; of an adaptive region, from a committed state."""
    state = region.init_state(1) if state is None else state
    feedback = {"mean": torch.zeros(1, 2), "variance": torch.zeros(1, 2)}
    found = []
    with torch.inference_mode():
        for _ in range(windows):
            values = {"speed": torch.tensor([[speed_um_s]]), **{f"{n}_feedback": v for n, v in feedback.items()}}
            values |= {f"{n}_error": torch.zeros(1, 2) for n in feedback}
            outputs, state = region.step(spikes(region, values), state)
            feedback = {n: to_numbers(v, region.output_ports[n].code) for n, v in outputs.items()}
            found.append(feedback)
    return found


def test_without_lessons_it_is_the_plain_hippocampus_at_every_speed(hippocampus: AdaptiveHippocampus) -> None:
    plain = pretrained(Hippocampus(HippocampusConfig(), CLOCK, torch.Generator()))
    speeds = torch.arange(2501).unsqueeze(1) * 0.04
    with torch.inference_mode():
        stirred = hippocampus.init_state(2501)
        ours, theirs = {**stirred, "hidden": torch.full_like(stirred["hidden"], 0.3)}, plain.init_state(2501)
        last = {n: torch.zeros(2501, 2) for n in ("mean", "variance")}
        for _ in range(3):
            values = {"speed": speeds, **{f"{n}_feedback": v for n, v in last.items()}}
            values |= {f"{n}_error": torch.zeros(2501, 2) for n in last}
            inputs = spikes(hippocampus, values)
            got, ours = hippocampus.step(inputs, ours)
            wanted, theirs = plain.step({n: inputs[n] for n in plain.input_ports}, theirs)
            for name in wanted:
                assert torch.equal(got[name], wanted[name])
            last = {n: to_numbers(v, plain.output_ports[n].code) for n, v in wanted.items()}


@pytest.mark.parametrize("distance_um", [20.0, 60.0, 100.0])
def test_the_delta_rule_finds_a_stationary_law(hippocampus: AdaptiveHippocampus, distance_um: float) -> None:
    """Taught the measured law without noise, it comes as near as two spikes of its code, which stand for 1.44 mN."""
    config = hippocampus.config.model_copy(update={"learning_rate": 1.0, "variance_learning_rate": 1.0})
    region = pretrained(AdaptiveHippocampus(config, CLOCK, torch.Generator()))
    line = {
        "mean": (table_one.MEASURED_MEAN_INTERCEPT_MN, table_one.MEASURED_MEAN_SLOPE_MN_UM),
        "variance": (table_one.MEASURED_VARIANCE_INTERCEPT_MN2, table_one.MEASURED_VARIANCE_SLOPE_MN2_UM),
    }
    law = {n: torch.tensor([intercept]) + distance_um * torch.tensor([slope]) for n, (intercept, slope) in line.items()}
    state, errors = region.init_state(1), []
    error = {name: torch.zeros(1, 2) for name in law}
    with torch.inference_mode():
        for _ in range(100):
            values = {"speed": torch.tensor([[distance_um]]), **{f"{n}_feedback": torch.zeros(1, 2) for n in law}}
            values |= {f"{n}_error": value for n, value in error.items()}
            outputs, state = region.step(spikes(region, values), state)
            error = {n: law[n] - to_numbers(v, region.output_ports[n].code) for n, v in outputs.items()}
            errors.append(max(value.abs().max().item() for value in error.values()))
    assert errors[0] > 5
    assert max(errors[-20:]) < 1.5
    at_rest = look(region, 0.0, 3, state)
    assert not any(value.any() for window in at_rest for value in window.values())


def test_what_is_felt_is_the_contact_whatever_the_stage_did() -> None:
    region = Comparator(ComparatorConfig(), CLOCK, torch.Generator())
    state = region.init_state(1)
    expected = {"mean": torch.tensor([[10.0, 20.0]]), "variance": torch.tensor([[4.0, 4.0]])}
    here = {"force": torch.tensor([[5.0, -5.0]]), "stage": torch.tensor([[1.0, 1.0]]), **expected}
    first, state = region.step(here, state)
    assert not any(value.any() for value in first.values())
    moved_um = torch.tensor([[0.5, -0.25]])
    there = {**here, "force": here["force"] + torch.tensor([[13.0, 19.0]]) - 80 * moved_um, "stage": 1 + moved_um}
    second, _ = region.step(there, state)
    torch.testing.assert_close(second["contact"], torch.tensor([[13.0, 19.0]]))
    torch.testing.assert_close(second["mean_error"], torch.tensor([[3.0, -1.0]]))
    rounding = (1000 / 128) ** 2 / 6
    torch.testing.assert_close(second["variance_error"], torch.tensor([[9.0, 1.0]]) - rounding - 4)


# ---- In the closed loop ----


def loop(file: str, *changes: str) -> tuple[Brain, Any]:
    experiment = load_experiment(EXAMPLES / f"{file}.yaml", changes)
    return build_brain(experiment), build_task(experiment)


def test_learning_off_gives_the_same_as_the_plain_examples() -> None:
    for plain, adaptive, changes, off in (
        ("peg_in_hole", "peg_in_hole_adaptive", (), OFF),
        (
            "peg_in_hole_fast",
            "peg_in_hole_fast_adaptive",
            ('time.radial="50 ms"',),
            (*OFF, "regions.cerebellum.learning_rate=0"),
        ),
    ):
        found = []
        for file, more in ((plain, ()), (adaptive, off)):
            brain, task = loop(file, *changes, *more)
            duration = None if plain == "peg_in_hole" else 7 * 10**9
            found.append([r.metrics for r in run_episodes(brain, task, [1000, 1001], duration_ns=duration)])
        assert found[0] == found[1]


def test_what_is_learned_survives_a_checkpoint_and_lasts_from_insertion_to_insertion() -> None:
    brain, task = loop("peg_in_hole_adaptive")
    memory = Memory()
    run_episodes(brain, task, [1000, 1001], memory=memory)
    known = memory.learned["hippocampus"]["synapses"]
    assert known.any() and not torch.equal(known[0], known[1])

    state = memory.recall(brain.init_state([1000, 1001]))
    assert torch.equal(state.regions["hippocampus"]["synapses"], known)
    assert not state.regions["hippocampus"]["trace"].any()  # all else starts anew
    sensors = {"force": 2, "stage": 2, "remaining": 1, "travel": 1}
    seen = {name: torch.full((2, width), 30.0) for name, width in sensors.items()}
    with torch.inference_mode():
        _, state = brain.tick(seen, state)
        _, on = brain.tick(seen, state)
        _, restored = brain.tick(seen, BrainState.from_tensors(state.tensors()))
    for name, value in on.tensors().items():
        assert torch.equal(value, restored.tensors()[name]), name


def test_an_episode_that_has_ended_learns_nothing_more() -> None:
    brain, task = loop("peg_in_hole_adaptive", "body.length=300 um", "regions.gap.length=300 um")
    together, alone = Memory(), Memory()
    episodes = run_episodes(brain, task, [1000, 1004, 1008], memory=together)
    first = int(np.argmin([episode.metrics["duration_s"] for episode in episodes]))
    run_episodes(brain, task, [(1000, 1004, 1008)[first]], memory=alone)
    for name, value in alone.learned["hippocampus"].items():
        assert torch.equal(together.learned["hippocampus"][name][first : first + 1], value)


def test_a_memory_is_of_so_many_episodes() -> None:
    brain, task = loop("peg_in_hole_adaptive")
    memory = Memory({"hippocampus": {"synapses": torch.zeros(2, 4, 343)}})
    with pytest.raises(ValueError, match="another number of episodes"):
        run_episodes(brain, task, [1000], memory=memory)


def test_insertions_in_a_row_take_less_force_as_the_law_is_learned() -> None:
    """From the wrong law on, eight sessions: the second insertion's force is 7 % below that without learning."""
    forces = []
    for changes in (OFF, ()):
        brain, task = loop("peg_in_hole_adaptive", *changes)
        memory = Memory()
        for number in (0, 1) if not changes else [1]:
            seeds = [1000 + 100 * number + session for session in range(8)]
            found = run_episodes(brain, task, seeds, memory=memory)
        forces.append(np.mean([episode.metrics["mean_force_mN"] for episode in found]))
    assert forces[1] < 0.93 * forces[0]
