"""Small graphs of any shape, against an interpreter that keeps the whole past and answers every reading by definition.

It is written without buffers, offsets and edges, on purpose: what it shares with the brain is what the words mean.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from neurorobo.bodies import Sensor
from neurorobo.clock import Clock
from neurorobo.errors import ConfigError
from neurorobo.graph.brain import Brain
from neurorobo.graph.compile import compile_graph
from neurorobo.graph.plan import Plan
from neurorobo.graph.spec import RepeatSpec, StepSpec
from neurorobo.regions import RegionConfig
from tests.graph.test_brain import MS, run
from tests.graph.toys import Tally, TallyConfig

CLOCK = Clock({"control": 1000 * MS, "half": 500 * MS, "fast": 250 * MS}, MS, 50)
FORCES = [3.0, 1.0, 4.0, 1.5, 9.0, 2.0, 6.0, 5.0, 3.5, 8.0]
REGIONS: dict[str, RegionConfig] = {
    "a_never": TallyConfig(carry="never"),
    "a_repeat": TallyConfig(carry="repeat"),
    "an_always": TallyConfig(carry="always"),
}
INITIAL = 0.25
Steps = Sequence[StepSpec | RepeatSpec]


class Said(NamedTuple):
    tick: int
    iteration: int
    value: float


class Interpreter:
    """Runs steps one after the other and remembers all that was ever said."""

    def __init__(self, steps: Steps) -> None:
        self.blocks = [(s.count, s.steps) if isinstance(s, RepeatSpec) else (1, (s,)) for s in steps]
        self.repeat_of = {step.name: spec for spec in steps if isinstance(spec, RepeatSpec) for step in spec.steps}
        self.said: dict[str, list[Said]] = {"body": []} | {step.name: [] for _, block in self.blocks for step in block}
        self.known: dict[tuple[str, int], int] = {}
        self.committed: dict[str, int] = {}

    def run(self, forces: Sequence[float]) -> list[tuple[int, str, int, float]]:
        seen = []
        for tick, force in enumerate(forces):
            self.said["body"].append(Said(tick, 0, force))
            for count, block in self.blocks:
                if tick % CLOCK.ticks(block[0].every):
                    continue
                in_block: dict[str, int] = {}
                for iteration in range(count):
                    for step in block:
                        heard = self.read(step, tick, iteration) if step.inputs else INITIAL
                        value = heard / 2 + self.count(step, in_block)
                        self.said[step.name].append(Said(tick, iteration, value))
                        seen.append((tick, step.name, iteration, value))
        return seen

    def count(self, step: StepSpec, in_block: dict[str, int]) -> int:
        carry = REGIONS[step.use].carry
        committed = {"never": {}, "repeat": in_block, "always": self.committed}[carry]
        before = 0 if carry == "never" or step.state == "fresh" else committed.get(step.use, 0)
        if step.state == "commit":
            committed[step.use] = before + 1
        elif step.state == "fork" and carry != "never":
            before = in_block.get(f"fork {step.name}", before)
            in_block[f"fork {step.name}"] = before + 1
        return before + 1

    def read(self, step: StepSpec, tick: int, iteration: int) -> float:
        present, _, later = step.inputs["a"].partition(" then ")
        if later and iteration > 0:
            (value,) = [s.value for s in self.said[later[0]] if s[:2] == (tick, iteration - 1)]
            return value
        match = re.fullmatch(r"(?:(\w+) )?(\w+)\.\w+(?: delayed (\d+) ms)?", present)
        assert match
        word, source, delay = match.groups()
        said = self.said[source]
        repeat = self.repeat_of.get(source)
        if repeat is not None and repeat == self.repeat_of.get(step.name):
            if word == "previous":
                said = [s for s in said if s[:2] == (tick, iteration - 1)]
            elif word == "first":
                said = [s for s in said if s.iteration == 0]
            return said[-1].value if said else INITIAL
        final = 0 if repeat is None or word == "first" else repeat.count - 1
        said = [s for s in said if s.iteration == final]
        if word in ("sum", "mean"):
            self.known[step.name, tick] = len(said)
            new = [s.value for s in said[self.known.get((step.name, tick - CLOCK.ticks(step.every)), 0) :]]
            return sum(new) / (len(new) if word == "mean" else 1) if new else INITIAL
        if word == "previous":
            said = [s for s in said if s.tick < tick]
        elif delay:
            said = [s for s in said if s.tick <= tick - int(delay) // 250]
        return said[-1].value if said else INITIAL


def plan_of(steps: Steps) -> Plan:
    return compile_graph(steps, {}, REGIONS, CLOCK, {"force": Sensor("mN")}, {})


@st.composite
def references(draw: st.DrawFn, sources: Sequence[str], then: str) -> str:
    source = draw(st.sampled_from(sources))
    source = "body.force" if source == "body" else f"{source}.sum"
    word = draw(st.sampled_from(["", "", "previous ", "first ", "last ", "sum ", "mean ", "delayed"]))
    text = f"{source} delayed {draw(st.integers(1, 9)) * 250} ms" if word == "delayed" else word + source
    return f"{text} then {draw(st.sampled_from(then))}.sum" if then and draw(st.booleans()) else text


@st.composite
def graphs(draw: st.DrawFn) -> Steps:
    """A repeat with steps before and after it; inputs that the compiler refuses are left unwired."""
    before, inner, after = (names[: draw(st.integers(least, 2))] for names, least in (("ab", 0), ("cd", 1), ("ef", 0)))
    periods = st.sampled_from(["control", "half", "fast"])

    def step(name: str, every: str, then: str = "") -> StepSpec:
        inputs = {"a": draw(references(["body", *before, *inner, *after], then))}
        state = draw(st.sampled_from(["commit", "fork", "fresh"]))
        return StepSpec(name, draw(st.sampled_from(list(REGIONS))), state, every, inputs, (name,))  # type: ignore[arg-type]

    every = draw(periods)
    steps: list[StepSpec | RepeatSpec] = [
        *(step(name, draw(periods)) for name in before),
        RepeatSpec(draw(st.integers(1, 3)), tuple(step(name, every, inner) for name in inner)),
        *(step(name, draw(periods)) for name in after),
    ]
    try:
        plan_of(steps)
    except ConfigError as error:
        refused = {fault.path for fault in error.faults}

        def mended(step: StepSpec) -> StepSpec:
            inputs = {} if (step.name, "a") in refused else step.inputs
            return StepSpec(step.name, step.use, step.state, step.every, inputs, step.path)

        steps = [
            RepeatSpec(s.count, tuple(map(mended, s.steps))) if isinstance(s, RepeatSpec) else mended(s) for s in steps
        ]
    return steps


@settings(max_examples=300)
@given(graphs())
def test_a_brain_does_what_the_words_say(steps: Steps) -> None:
    generator = torch.Generator().manual_seed(0)
    brain = Brain(plan_of(steps), {name: Tally(config, CLOCK, generator) for name, config in REGIONS.items()})
    found, _ = run(brain, FORCES)
    wanted = Interpreter(steps).run(FORCES)
    assert [place[:3] for place in found] == [place[:3] for place in wanted]
    assert [place[3] for place in found] == pytest.approx([place[3] for place in wanted], rel=1e-5)
