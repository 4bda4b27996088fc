"""What the compiler refuses, in which words, and where."""

import pytest

from neurorobo.bodies import Sensor
from neurorobo.clock import Clock
from neurorobo.codes import PopulationUniform
from neurorobo.errors import ConfigError
from neurorobo.graph.compile import compile_graph
from neurorobo.graph.spec import RepeatSpec, StepSpec
from neurorobo.regions import Port, RegionConfig
from tests.graph.toys import AddConfig, CountConfig, SpikingRelayConfig

MS = 1_000_000
CLOCK = Clock({"control": 1000 * MS, "fast": 250 * MS, "flash": 10 * MS}, MS, 50)


class NeedyConfig(AddConfig):
    """Its input `a` has no initial value."""

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"a": Port("mN"), "pair": Port("mN", 2, initial=(0.0, 0.0))}


class OutOfRangeConfig(SpikingRelayConfig):
    """Its input starts where its code does not reach."""

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"a": Port("mN", code=PopulationUniform(2, 20.0, 30.0), initial=(10.0,))}


REGIONS = {
    "add": AddConfig(),
    "speed": AddConfig(unit="um/s"),
    "count": CountConfig(),
    "relay": SpikingRelayConfig(),
    "needy": NeedyConfig(),
}


def step(name: str, use: str = "add", path: int = 0, **inputs: str) -> StepSpec:
    every = inputs.pop("every", "control")
    return StepSpec(name, use, every=every, inputs=inputs, path=("steps", path, name))


def faults(*steps: StepSpec | RepeatSpec, command: dict[str, str] | None = None) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        compile_graph(
            steps, command or {}, REGIONS, CLOCK, {"force": Sensor("mN")}, {"push": Sensor("mN")} if command else {}
        )
    return [str(fault) for fault in caught.value.faults]


@pytest.mark.parametrize(
    ("steps", "place", "words"),
    [
        ([step("x", "ad")], "steps.0.x.use", "did you mean `add`?"),
        ([step("x", a="body.forse")], "steps.0.x.a", "did you mean `force`?"),
        ([step("x", a="bodi.force")], "steps.0.x.a", "did you mean `body`?"),
        ([step("x", aa="body.force")], "steps.0.x.aa", "did you mean `a`?"),
        ([step("x", "speed", a="body.force")], "steps.0.x.a", "`body.force` is mN, but `a` takes um/s"),
        ([step("x", "needy", a="body.force", pair="body.force")], "steps.0.x.pair", "`pair` takes 2 x mN"),
        ([step("x", "needy")], "steps.0.x", "the input `a` (mN) of `needy` is not wired"),
        ([step("x", "needy", a="previous x.sum")], "steps.0.x.a", "declares no initial one"),
        ([step("x", every="fats")], "steps.0.x.every", "did you mean `fast` or `flash`?"),
        ([step("x", "relay", every="flash")], "steps.0.x.every", "does not fit the period"),
        ([step("x", a="x.sum")], "steps.0.x.a", "write `previous x.sum`"),
        ([step("x", a="previos x.sum")], "steps.0.x.a", "allowed: previous, first, last, sum, mean"),
        ([step("x", a="force")], "steps.0.x.a", "is not a reference"),
        ([step("x", a="body.force then x.sum")], "steps.0.x.a", "needs a step of the same repeat"),
        ([step("x"), step("y", path=1, a="first x.sum")], "steps.1.y.a", "`x` is in none"),
        ([step("x", a="body.force delayed 15 ms")], "steps.0.x.a", "not a multiple of the tick of 10 ms"),
        ([step("x"), step("x", path=1)], "steps.1.x", "already a step `x`"),
        ([step("body")], "steps.0.body", "the name is taken"),
        ([step("q", every="fast"), step("s", path=1, a="q.sum")], "steps.1.s.a", "`mean q.sum`"),
        (
            [step("x", a="y.sum"), step("y", path=1)],
            "steps.0.x.a",
            "move `y` up, or read its last value: `previous y.sum`",
        ),
        ([step("x", a="previous body.force delayed 1 s")], "steps.0.x.a", "both `previous` and `delayed`"),
        ([RepeatSpec(2, (step("x", a="body.force then first x.sum"),))], "steps.0.x.a", "write `then x.sum`"),
        ([RepeatSpec(2, (step("x", a="body.force then x.sum delayed 1 s"),))], "steps.0.x.a", "write `then x.sum`"),
        (
            [RepeatSpec(2, (step("x", a="y.sum then y.sum"), step("y")))],
            "steps.0.x.a",
            "move `y` up, or read its last value: `previous y.sum`",
        ),
        ([RepeatSpec(2, (step("x"), step("y", a="sum x.sum")))], "steps.0.y.a", "same repeat"),
        ([RepeatSpec(2, (step("x"), step("y", a="mean x.sum")))], "steps.0.y.a", "same repeat"),
        ([RepeatSpec(2, (step("x"), step("y", a="x.sum delayed 1 s")))], "steps.0.y.a", "`previous x.sum`"),
        (
            [step("y", "needy", a="first x.sum"), RepeatSpec(2, (step("x", path=1),))],
            "steps.0.y.a",
            "declares no initial one",
        ),
        ([step("s"), step("q", path=1, every="fast", a="sum s.sum")], "steps.1.q.a", "sees its value held"),
        (
            [RepeatSpec(2, (step("x"), step("y", every="fast")), ("steps", 0))],
            "steps.0",
            "have the periods control, fast",
        ),
    ],
)
def test_a_fault_names_place_and_cure(steps: list[StepSpec | RepeatSpec], place: str, words: str) -> None:
    (line,) = faults(*steps)
    assert line.startswith(place + ": ")
    assert words in line


@pytest.mark.parametrize("steps", [[step("x", "spare")], [step("x", "add")]])
@pytest.mark.parametrize(
    ("config", "message"),
    [
        (AddConfig(unit="foo"), "'foo' is not a unit"),
        (OutOfRangeConfig(), "`a` starts at 10 mN, outside the range 20..30"),
        (SpikingRelayConfig(neurons=-8), "a code needs at least one neuron (got -8); give it 1 or more"),
    ],
)
def test_the_ports_of_every_region_are_checked_once_whether_a_step_uses_it_or_not(
    steps: list[StepSpec], config: RegionConfig, message: str
) -> None:
    regions = {**REGIONS, "spare": config}
    with pytest.raises(ConfigError) as caught:
        compile_graph(steps, {}, regions, CLOCK, {}, {})
    (fault,) = caught.value.faults
    assert fault.path == ("regions", "spare")
    assert message in fault.message


def test_a_cycle_is_named_along_its_path() -> None:
    (line,) = faults(step("x", a="z.sum"), step("y", path=1, a="x.sum"), step("z", path=2, a="y.sum"))
    assert line.startswith("steps.0.x.a: a cycle without delay: x -> y -> z -> x")
    assert "`previous`" in line


def test_previous_breaks_a_cycle() -> None:
    steps = [step("x", a="previous z.sum"), step("y", path=1, a="x.sum"), step("z", path=2, a="y.sum")]
    compile_graph(steps, {}, REGIONS, CLOCK, {}, {})


def test_all_faults_are_reported_at_once() -> None:
    lines = faults(step("x", a="body.forse"), step("y", "ad", path=1), command={"pull": "x.sum"})
    assert len(lines) == 4
    assert any("no actuator `pull`" in line for line in lines)
    assert any("nothing drives the actuator `push`" in line for line in lines)


@pytest.mark.parametrize("text", ["mean x.sum", "sum x.sum", "previous x.sum", "x.sum delayed 1 s"])
def test_a_command_is_never_of_the_past(text: str) -> None:
    (line,) = faults(step("x"), command={"push": text})
    assert line.startswith("command.push: a command takes the value of its tick")


@pytest.mark.parametrize("word", ["", "last ", "sum ", "mean "])
def test_periods_that_do_not_divide_each_other_have_no_read_rule(word: str) -> None:
    clock = Clock({"control": 600 * MS, "two": 200 * MS, "three": 300 * MS}, MS, 50)
    steps = [step("x", every="two"), step("y", path=1, every="three", a=f"{word}x.sum")]
    with pytest.raises(ConfigError, match="does not divide that of its reader"):
        compile_graph(steps, {}, REGIONS, clock, {}, {})


def test_an_unknown_unit_of_a_sensor_is_a_fault_of_the_input_that_reads_it() -> None:
    with pytest.raises(ConfigError, match=r"steps\.0\.x\.a: 'foo' is not a unit"):
        compile_graph([step("x", a="body.force")], {}, REGIONS, CLOCK, {"force": Sensor("foo")}, {})
