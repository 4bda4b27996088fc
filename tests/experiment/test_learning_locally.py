"""Local learning in a running graph, from a file: a reward that comes late, states, and what a plugin adds."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Literal

import pytest
import torch
from torch import Tensor

from neurorobo.config.document import parse_document
from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.config.schema import experiment_schema
from neurorobo.errors import ConfigError
from neurorobo.experiment.build import build_brain
from neurorobo.experiment.memory import Memory
from neurorobo.graph.brain import Brain, BrainState
from neurorobo.plasticity import Activity, LearningRule, Term
from neurorobo.plugins import Registrar, Registry, hookimpl

EXAMPLE = Path(__file__).parents[2] / "examples" / "distal_reward.yaml"
LEARNED = "output.noise.change"


@torch.no_grad()
def tick(brain: Brain, state: BrainState, times: int) -> BrainState:
    for _ in range(times):
        _, state = brain.tick({}, state)
    return state


def equal(one: BrainState, other: BrainState, member: int) -> bool:
    return all(
        torch.equal(value[member], other.regions[name][key][member])
        for name, state in one.regions.items()
        for key, value in state.items()
    )


def test_a_run_does_not_depend_on_its_batch_and_can_begin_anew_alone() -> None:
    brain = build_brain(load_experiment(EXAMPLE))
    together = tick(brain, brain.init_state([1000, 1001]), 100)
    assert together.regions["rewarded"][LEARNED].abs().max() > 1e-3
    assert equal(together, tick(brain, brain.init_state([1000]), 100), 0)
    begun = brain.reset(together, torch.tensor([False, True]), [0, 1000])
    assert not begun.regions["rewarded"][LEARNED][1].any()
    further = tick(brain, begun, 100)
    assert equal(further, tick(brain, together, 100), 0)
    assert torch.equal(further.regions["rewarded"][LEARNED][1], together.regions["rewarded"][LEARNED][0])


def test_a_checkpoint_holds_what_was_learned_and_a_memory_keeps_that_alone() -> None:
    brain = build_brain(load_experiment(EXAMPLE))
    state = tick(brain, brain.init_state([1000]), 50)
    assert equal(tick(brain, BrainState.from_tensors(state.tensors()), 50), tick(brain, state, 50), 0)
    memory = Memory()
    memory.keep(brain, state)
    recalled = memory.recall(brain.init_state([1001])).regions["rewarded"]
    assert torch.equal(recalled[LEARNED], state.regions["rewarded"][LEARNED])
    assert not recalled["output.noise.0.source"].any()


def load(text: str, registry: Registry | None = None) -> Experiment:
    experiment = Experiment.from_document(parse_document(text, "test.yaml"), registry or Registry())
    build_brain(experiment)
    return experiment


def test_a_modulator_that_is_not_wired_is_refused() -> None:
    text = EXAMPLE.read_text().replace("initial: 20 Hz, baseline", "baseline")
    with pytest.raises(ConfigError, match=r"act\.rate delayed 200 ms` has no value at the start"):
        load(text)
    with pytest.raises(ConfigError, match=r"idle: .*the input `reward`"):
        load(text.replace(", reward: act.rate delayed 200 ms", ""))


def test_what_synapses_learn_by_is_no_phase_of_training() -> None:
    with pytest.raises(ConfigError, match="not a phase of training; write it under `learns`"):
        load(EXAMPLE.read_text() + "train: [{phase: pair_stdp, a_plus: 1}]\n")


class Hebb(LearningRule):
    """Whatever fires together is wired together."""

    source_traces: ClassVar[tuple[str, ...]] = ()
    type: Literal["acme.hebb"] = "acme.hebb"

    def terms(self, activity: Activity, traces: Mapping[str, Tensor]) -> tuple[Sequence[Term], Mapping[str, Tensor]]:
        return [Term(activity.targets, activity.sources)], {}


class Plugin:
    @hookimpl
    def neurorobo_register(self, registry: Registrar) -> None:
        registry.add("rule", "acme.hebb", f"{__name__}:Hebb", "what fires together")


def test_a_plugin_can_add_a_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    registry = Registry()
    registry.add_plugin("acme", Plugin())
    text = EXAMPLE.read_text().replace(
        "learns: [{type: pair_stdp, modulator: reward, eligibility: 200 ms, a_minus: 0.0045,",
        "learns: [{type: acme.hebb,",
    )
    text = text.replace("    modulators: {reward: {unit: Hz, initial: 20 Hz, baseline: 500 ms}}\n", "").replace(
        ", reward: act.rate delayed 200 ms", ""
    )
    brain = build_brain(load(text, registry))
    assert tick(brain, brain.init_state([1]), 5).regions["other"][LEARNED].max() > 0
    schema = experiment_schema(registry)["$defs"]
    assert "acme.hebb" in str(schema["rule"])
    assert "acme.hebb" not in str(schema["rule by its phase"])
    assert "supervise" not in str(schema["rule"])
