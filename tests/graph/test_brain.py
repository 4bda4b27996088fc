"""What a compiled graph computes: order, memory, periods, state policies."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from neurorobo.bodies import Sensor
from neurorobo.clock import Clock
from neurorobo.codes import Poisson
from neurorobo.errors import NeuroroboError
from neurorobo.graph.brain import Brain, BrainState
from neurorobo.graph.compile import compile_graph
from neurorobo.graph.spec import RepeatSpec, StepSpec
from neurorobo.regions import Port, RegionConfig
from tests.graph.toys import Add, AddConfig, Count, CountConfig, SpikingRelay, SpikingRelayConfig

MS = 1_000_000


class NoisyRelayConfig(SpikingRelayConfig):
    """Hears the quantity in random spikes."""

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"a": Port("mN", code=Poisson(self.neurons, 0.0, self.hi), initial=(10.0,))}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"same": Port("mN", code=Poisson(self.neurons, 0.0, self.hi))}


IMPLEMENTATIONS = {
    AddConfig: Add,
    CountConfig: Count,
    SpikingRelayConfig: SpikingRelay,
    NoisyRelayConfig: SpikingRelay,
}
CLOCK = Clock({"control": 1000 * MS, "fast": 250 * MS}, MS, 50)


def brain_of(
    regions: Mapping[str, RegionConfig],
    steps: Sequence[StepSpec | RepeatSpec],
    command: Mapping[str, str] | None = None,
) -> Brain:
    plan = compile_graph(
        steps, command or {}, regions, CLOCK, {"force": Sensor("mN")}, {name: Sensor("mN") for name in command or {}}
    )
    generator = torch.Generator().manual_seed(0)
    return Brain(plan, {n: IMPLEMENTATIONS[type(c)](c, CLOCK, generator) for n, c in regions.items()})


class Listener:
    """Keeps the outputs of every use."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, str, int, float]] = []
        self.tick = 0

    def used(self, use, iteration, inputs, outputs, numbers) -> None:  # type: ignore[no-untyped-def]
        (value,) = outputs.values()
        self.seen.append((self.tick, use.name, iteration, float(value.flatten()[0])))

    def probe(self, use, *, last):  # type: ignore[no-untyped-def]
        return None

    def saturated(self, edge, count):  # type: ignore[no-untyped-def]
        pass


def run(
    brain: Brain, forces: Sequence[float], state: BrainState | None = None
) -> tuple[list[tuple[int, str, int, float]], BrainState]:
    state = state or brain.init_state([0])
    listener = Listener()
    for force in forces:
        listener.tick = state.tick
        _, state = brain.tick({"force": torch.tensor([[float(force)]])}, state, listener)
    return listener.seen, state


def values(seen: Sequence[tuple[int, str, int, float]], name: str) -> list[float]:
    return [value for _, step, _, value in seen if step == name]


def test_previous_reads_the_value_before_this_tick_wherever_the_source_stands() -> None:
    regions = {"add": AddConfig()}
    before = brain_of(
        regions,
        [
            StepSpec("x", "add", every="fast", inputs={"a": "body.force"}),
            StepSpec("y", "add", every="fast", inputs={"a": "previous x.sum"}),
        ],
    )
    after = brain_of(
        regions,
        [
            StepSpec("y", "add", every="fast", inputs={"a": "previous x.sum"}),
            StepSpec("x", "add", every="fast", inputs={"a": "body.force"}),
        ],
    )
    for brain in (before, after):
        seen, _ = run(brain, [10, 20, 30])
        assert values(seen, "y") == [1.0, 12.0, 22.0]


def test_an_accumulator_through_previous_itself() -> None:
    brain = brain_of({"add": AddConfig()}, [StepSpec("x", "add", every="fast", inputs={"a": "previous x.sum"})])
    seen, _ = run(brain, [0] * 5)
    assert values(seen, "x") == [1, 2, 3, 4, 5]


def test_slow_steps_run_at_their_period_and_fast_readers_see_the_held_value() -> None:
    brain = brain_of(
        {"add": AddConfig()},
        [
            StepSpec("slow", "add", inputs={"a": "body.force"}),
            StepSpec("quick", "add", every="fast", inputs={"a": "slow.sum"}),
        ],
    )
    seen, _ = run(brain, [1, 2, 3, 4, 5, 6])
    assert values(seen, "slow") == [2, 6]
    assert values(seen, "quick") == [3, 3, 3, 3, 7, 7]


@pytest.mark.parametrize(("rule", "expected"), [("last", [5.0, 9.0]), ("sum", [14.0, 30.0]), ("mean", [3.5, 7.5])])
def test_slow_readers_of_fast_sources_read_by_their_rule(rule: str, expected: list[float]) -> None:
    brain = brain_of(
        {"add": AddConfig(), "plain": AddConfig(amount=0.0)},
        [
            StepSpec("slow", "plain", inputs={"a": f"{rule} quick.sum"}),
            StepSpec("quick", "add", every="fast", inputs={"a": "body.force"}),
        ],
    )
    seen, _ = run(brain, [1, 2, 3, 4, 5, 6, 7, 8, 9])
    assert values(seen, "slow")[0] == 0.0
    assert values(seen, "slow")[1:] == expected


@pytest.mark.parametrize("delay_ms", [250, 500, 1000, 1750])
def test_a_delay_shifts_by_whole_ticks(delay_ms: int) -> None:
    brain = brain_of(
        {"plain": AddConfig(amount=0.0)},
        [StepSpec("x", "plain", every="fast", inputs={"a": f"body.force delayed {delay_ms} ms"})],
    )
    seen, _ = run(brain, list(range(1, 13)))
    ticks = delay_ms // 250
    assert values(seen, "x") == [0.0] * ticks + [float(i) for i in range(1, 13 - ticks)]


def test_a_delay_reads_the_last_value_of_a_slow_source_before_it() -> None:
    brain = brain_of(
        {"plain": AddConfig(amount=0.0)},
        [
            StepSpec("slow", "plain", inputs={"a": "body.force"}),
            StepSpec("x", "plain", every="fast", inputs={"a": "slow.sum delayed 500 ms"}),
        ],
    )
    seen, _ = run(brain, list(range(1, 13)))
    assert values(seen, "x") == [0, 0, 1, 1, 1, 1, 5, 5, 5, 5, 9, 9]


def test_a_repeat_looks_ahead_from_the_body_and_starts_anew_each_time() -> None:
    brain = brain_of(
        {"add": AddConfig()},
        [
            RepeatSpec(
                3,
                (
                    StepSpec("imagine", "add", inputs={"a": "body.force then imagine.sum"}),
                    StepSpec("sofar", "add", inputs={"a": "previous sofar.sum"}),
                ),
            ),
            StepSpec("last", "add", inputs={"a": "imagine.sum"}),
            StepSpec("first", "add", inputs={"a": "first imagine.sum"}),
        ],
    )
    seen, _ = run(brain, [10, 0, 0, 0, 20])
    assert values(seen, "imagine") == [11, 12, 13, 21, 22, 23]
    assert values(seen, "sofar") == [1, 2, 3, 1, 2, 3]
    assert values(seen, "last") == [14, 24]
    assert values(seen, "first") == [12, 22]


def test_the_previous_iteration_is_not_the_present_one_when_the_source_runs_first() -> None:
    block = RepeatSpec(
        3,
        (
            StepSpec("x", "add", inputs={"a": "body.force then y.sum"}),
            StepSpec("y", "add", inputs={"a": "x.sum"}),
            StepSpec("z", "add", inputs={"a": "body.force then x.sum"}),
        ),
    )
    seen, _ = run(brain_of({"add": AddConfig()}, [block]), [0])
    assert values(seen, "x") == [1, 3, 5]
    assert values(seen, "z") == [1, 2, 4]


@pytest.mark.parametrize(
    ("carry", "expected"),
    [
        ("never", {"imagine": [1, 1, 1, 1], "act": [1, 1]}),
        ("repeat", {"imagine": [1, 2, 1, 2], "act": [1, 1]}),
        ("always", {"imagine": [1, 2, 2, 3], "act": [1, 2]}),
    ],
)
def test_forked_states_are_thrown_away_and_carried_as_long_as_the_region_says(
    carry: str, expected: dict[str, list[float]]
) -> None:
    brain = brain_of(
        {"count": CountConfig(carry=carry)},  # type: ignore[arg-type]
        [RepeatSpec(2, (StepSpec("imagine", "count", state="fork"),)), StepSpec("act", "count")],
    )
    seen, _ = run(brain, [0] * 5)
    assert {name: values(seen, name) for name in expected} == expected


def test_a_fresh_use_neither_reads_nor_writes_the_state() -> None:
    brain = brain_of(
        {"count": CountConfig(carry="always")},
        [StepSpec("look", "count", state="fresh", every="fast"), StepSpec("act", "count", every="fast")],
    )
    seen, _ = run(brain, [0] * 3)
    assert values(seen, "look") == [1, 1, 1]
    assert values(seen, "act") == [1, 2, 3]


def test_numbers_become_spikes_and_back_and_different_codes_are_recoded() -> None:
    brain = brain_of(
        {"wide": SpikingRelayConfig(neurons=8), "narrow": SpikingRelayConfig(neurons=2)},
        [
            StepSpec("a", "wide", every="fast", inputs={"a": "body.force"}),
            StepSpec("b", "narrow", every="fast", inputs={"a": "a.same"}),
        ],
        {"push": "b.same"},
    )
    assert [edge.conversion for use in brain.plan.uses() for edges in use.inputs.values() for edge in edges] == [
        "encode",
        "recode",
    ]
    commands, _ = brain.tick({"force": torch.tensor([[41.3], [99.0]])}, brain.init_state([0, 0]))
    assert commands["push"].flatten().tolist() == pytest.approx([41.0, 99.0])


def test_an_unwired_spiking_input_carries_its_initial_value() -> None:
    brain = brain_of({"relay": SpikingRelayConfig()}, [StepSpec("a", "relay")], {"push": "a.same"})
    commands, _ = brain.tick({"force": torch.zeros(3, 1)}, brain.init_state([0, 0, 0]))
    assert commands["push"].flatten().tolist() == [10.0] * 3


def test_what_leaves_a_repeat_counts_once_per_period() -> None:
    brain = brain_of(
        {"add": AddConfig(), "plain": AddConfig(amount=0.0)},
        [
            RepeatSpec(3, (StepSpec("imagine", "add", every="fast", inputs={"a": "body.force then imagine.sum"}),)),
            StepSpec("before", "plain", every="fast", inputs={"a": "previous imagine.sum"}),
            StepSpec("delayed", "plain", every="fast", inputs={"a": "imagine.sum delayed 500 ms"}),
            StepSpec("mean", "plain", inputs={"a": "mean imagine.sum"}),
        ],
    )
    seen, _ = run(brain, [10, 20, 30, 40, 50])
    assert values(seen, "before") == [0, 13, 23, 33, 43]
    assert values(seen, "delayed") == [0, 0, 13, 23, 33]
    assert values(seen, "mean") == [13, 38]


@pytest.mark.parametrize("carry", ["repeat", "always"])
def test_imagination_leaves_no_trace_in_the_same_repeat(carry: str) -> None:
    steps = (
        StepSpec("imagine", "count", state="fork"),
        StepSpec("wonder", "count", state="fork"),
        StepSpec("look", "count", state="fresh"),
        StepSpec("act", "count"),
    )
    brain = brain_of({"count": CountConfig(carry=carry)}, [RepeatSpec(3, steps)])  # type: ignore[arg-type]
    seen, _ = run(brain, [0])
    assert values(seen, "imagine") == values(seen, "wonder") == values(seen, "act") == [1, 2, 3]
    assert values(seen, "look") == [1, 1, 1]


@pytest.mark.parametrize(("rule", "expected"), [("sum", [10.0, 140.0]), ("mean", [10.0, 35.0])])
def test_nothing_is_added_up_that_was_never_said(rule: str, expected: list[float]) -> None:
    regions = {"plain": AddConfig(amount=0.0)}
    brain = brain_of(regions, [StepSpec("slow", "plain", inputs={"a": f"{rule} body.force"})])
    seen, _ = run(brain, [10, 20, 30, 40, 50])
    assert values(seen, "slow") == expected


@pytest.mark.parametrize("name", ["train", "type", "keys", "pop", "float", "regions"])
def test_a_region_may_have_any_name(name: str) -> None:
    seen, _ = run(brain_of({name: CountConfig(carry="always")}, [StepSpec("x", name)]), [0] * 5)
    assert values(seen, "x") == [1, 2]


def test_a_region_without_state_survives_a_checkpoint() -> None:
    brain = brain_of({"add": AddConfig(carry="always")}, [StepSpec("x", "add", every="fast")])
    _, state = run(brain, [0])
    seen, _ = run(brain, [0], BrainState.from_tensors(state.tensors()))
    assert values(seen, "x") == [1]


def test_an_observation_that_does_not_fit_is_refused() -> None:
    brain = brain_of({"add": AddConfig()}, [StepSpec("x", "add", inputs={"a": "body.force"})])
    state = brain.init_state([0, 0])
    with pytest.raises(NeuroroboError, match=r"sensor `force` gives the shape \(3, 1\).*need \(2, 1\)"):
        brain.tick({"force": torch.zeros(3, 1)}, state)
    with pytest.raises(NeuroroboError, match="lacks the sensor `force`, which `x` reads"):
        brain.tick({}, state)


def test_what_a_code_cannot_say_is_counted_for_each_run() -> None:
    class Counter(Listener):
        def saturated(self, edge, count):  # type: ignore[no-untyped-def]
            counts.append((edge.name, count.tolist()))

    counts: list[tuple[str, list[int]]] = []
    brain = brain_of(
        {"wide": SpikingRelayConfig(neurons=3), "narrow": SpikingRelayConfig(neurons=7, hi=50.0)},
        [StepSpec("a", "wide", inputs={"a": "body.force"}), StepSpec("b", "narrow", inputs={"a": "mean a.same"})],
        {"push": "b.same"},
    )
    brain.tick({"force": torch.tensor([[-1.0], [50.0], [100.0], [101.0]])}, brain.init_state([0] * 4), Counter())
    assert counts == [("a.a", [1, 0, 0, 1]), ("b.a", [0, 0, 1, 1])]


def test_what_the_next_iteration_reads_is_not_encoded_after_the_last() -> None:
    class Counter(Listener):
        def saturated(self, edge, count):  # type: ignore[no-untyped-def]
            counted.append(edge.name)

    counted: list[str] = []
    block = RepeatSpec(
        3,
        (
            StepSpec("a", "narrow", inputs={"a": "body.force then b.sum"}),
            StepSpec("b", "add", inputs={"a": "a.same"}),
        ),
    )
    brain = brain_of({"narrow": SpikingRelayConfig(hi=50.0), "add": AddConfig()}, [block])
    brain.tick({"force": torch.tensor([[100.0]])}, brain.init_state([0]), Counter())
    assert counted == ["a.a", "a.a then", "a.a then"]


def test_a_recoding_into_a_wider_range_is_not_asked_whether_it_saturates() -> None:
    brain = brain_of(
        {"wide": SpikingRelayConfig(neurons=3), "narrow": SpikingRelayConfig(neurons=7, hi=50.0)},
        [
            StepSpec("a", "wide", inputs={"a": "body.force"}),
            StepSpec("b", "narrow", inputs={"a": "a.same"}),
            StepSpec("c", "wide", inputs={"a": "b.same"}),
        ],
        {"push": "c.same"},
    )
    assert {edge.name: edge.can_saturate for edge in brain.plan.edges()} == {
        "a.a": True,
        "b.a": True,
        "c.a": False,
        "command.push": False,
    }


def test_what_is_returned_may_be_overwritten() -> None:
    brain = brain_of({"relay": SpikingRelayConfig()}, [StepSpec("x", "relay")], {"push": "x.same"})
    state = brain.init_state([0])
    before = brain.tick({}, state)[0]["push"].clone()
    commands, after = brain.tick({}, state)
    commands["push"].fill_(7.0)
    for values in after.buffers.values():
        for value in values:
            value.fill_(1.0)
    assert torch.equal(brain.tick({}, state)[0]["push"], before)


def test_a_sensor_is_encoded_only_where_it_is_read() -> None:
    class Counter(Listener):
        def saturated(self, edge, count):  # type: ignore[no-untyped-def]
            counted.append((edge.name, state.tick))

    counted: list[tuple[str, int]] = []
    brain = brain_of(
        {"relay": SpikingRelayConfig()},
        [
            StepSpec("slow", "relay", inputs={"a": "body.force"}),
            StepSpec("quick", "relay", every="fast", inputs={"a": "body.force"}),
            StepSpec("late", "relay", inputs={"a": "previous body.force"}),
        ],
        {"push": "slow.same", "pull": "late.same"},
    )
    state, commands = brain.init_state([0, 0]), []
    for tick in range(6):  # the second run is always out of range
        due, state = brain.tick({"force": torch.tensor([[20.0 + tick], [200.0]])}, state, Counter())
        commands.append({name: float(value[0]) for name, value in due.items()})
    assert [tick for name, tick in counted if name == "slow.a"] == [0, 4]
    assert [tick for name, tick in counted if name == "quick.a"] == [0, 1, 2, 3, 4, 5]
    assert [tick for name, tick in counted if name == "late.a"] == [
        0,
        1,
        2,
        3,
        4,
        5,
    ]  # of which it reads the one before
    assert [command for command in commands if command] == [{"push": 20.0, "pull": 10.0}, {"push": 24.0, "pull": 23.0}]


def everything() -> Brain:
    return brain_of(
        {
            "add": AddConfig(),
            "count": CountConfig(carry="always"),
            "relay": SpikingRelayConfig(),
            "noisy": NoisyRelayConfig(),
        },
        [
            RepeatSpec(
                2, (StepSpec("imagine", "add", inputs={"a": "body.force then imagine.sum", "b": "previous act.same"}),)
            ),
            StepSpec("plan", "count", inputs={"a": "mean quick.count"}),
            StepSpec("quick", "count", every="fast", inputs={"a": "plan.count delayed 750 ms"}),
            StepSpec("act", "relay", every="fast", inputs={"a": "quick.count"}),
            StepSpec("doubt", "noisy", every="fast", inputs={"a": "body.force delayed 500 ms"}),
        ],
        {"push": "act.same", "pull": "doubt.same"},
    )


def test_twice_n_ticks_equal_n_ticks_saved_loaded_and_n_more_bit_for_bit(tmp_path: Path) -> None:
    forces = [float(i * 7 % 13) for i in range(14)]
    seen, straight = run(everything(), forces)
    _, half = run(everything(), forces[:7])
    save_file(half.tensors(), tmp_path / "state.safetensors")
    later, resumed = run(everything(), forces[7:], BrainState.from_tensors(load_file(tmp_path / "state.safetensors")))
    assert later == seen[-len(later) :]
    assert straight.tensors().keys() == resumed.tensors().keys()
    for name, tensor in straight.tensors().items():
        assert torch.equal(tensor, resumed.tensors()[name]), name


def test_a_tick_leaves_the_state_it_was_given_as_it_was() -> None:
    brain = everything()
    _, state = run(brain, [1, 2, 3])
    before = {name: tensor.clone() for name, tensor in state.tensors().items()}
    brain.tick({"force": torch.tensor([[5.0]])}, state)
    assert all(torch.equal(tensor, before[name]) for name, tensor in state.tensors().items())


def test_a_reset_run_is_at_its_start_and_the_others_go_on() -> None:
    brain = everything()
    state = brain.init_state([0, 0])
    for force in (3.0, 4.0, 5.0, 6.0):
        _, state = brain.tick({"force": torch.full((2, 1), force)}, state)
    reset = brain.reset(state, torch.tensor([True, False]), seeds=[0, 0])
    start = brain.init_state([0, 0])
    for name, values_now in reset.buffers.items():
        for now, old, new in zip(values_now, state.buffers[name], start.buffers[name], strict=True):
            row = now.dim() - 2
            assert torch.equal(now.select(row, 0), new.select(row, 0))
            assert torch.equal(now.select(row, 1), old.select(row, 1))


def test_the_hyperperiod_is_the_longest_period_in_use() -> None:
    assert everything().plan.hyperperiod == 4


def test_a_run_starts_where_every_step_runs() -> None:
    brain = everything()
    _, state = run(brain, [1.0])
    with pytest.raises(NeuroroboError, match="multiple of the hyperperiod of 4 ticks"):
        brain.reset(state, torch.tensor([True]), seeds=[0])
    _, state = run(brain, [2.0, 3.0, 4.0], state)
    again, _ = run(brain, [5.0, 6.0, 7.0, 8.0, 9.0], brain.reset(state, torch.tensor([True]), seeds=[0]))
    start, _ = run(brain, [5.0, 6.0, 7.0, 8.0, 9.0])
    assert [place[1:] for place in again] == [place[1:] for place in start]
