"""What the views print, word for word, for a plan and summaries that are small enough to read."""

import io
import sys
from collections.abc import Sequence

import pytest
from rich.console import Console
from rich.table import Table

from neurorobo.bodies import Actuator, Sensor
from neurorobo.clock import Clock
from neurorobo.graph.compile import compile_graph
from neurorobo.graph.plan import Plan
from neurorobo.graph.spec import RepeatSpec, StepSpec
from neurorobo.views.mermaid import mermaid_lines
from neurorobo.views.progress import LINES_PER_PHASE, RunProgress, training_progress
from neurorobo.views.schedule import schedule_lines
from neurorobo.views.tables import comparison_table, summary_table
from tests.graph.toys import AddConfig, CountConfig, SpikingRelayConfig

MS = 1_000_000


def three_steps() -> Plan:
    """Steps whose names are words of Mermaid's: one that is fast, two that repeat."""
    return compile_graph(
        [
            StepSpec("style", "relay", every="fast", inputs={"a": "body.force"}),
            RepeatSpec(
                2,
                (
                    StepSpec("end", "sum", "fork", inputs={"a": "last style.same then end.sum"}),
                    StepSpec("click", "count", "fresh", inputs={"a": "previous click.count"}),
                ),
            ),
        ],
        {"push": "end.sum"},
        {"relay": SpikingRelayConfig(), "sum": AddConfig(), "count": CountConfig()},
        Clock({"control": 1000 * MS, "fast": 250 * MS}, MS, 50),
        {"force": Sensor("mN")},
        {"push": Actuator("mN")},
    )


SCHEDULE = """\
periods     control 1 s, fast 250 ms
tick        250 ms; the schedule repeats every 4 ticks
window      50 steps of 1 ms

at each tick: read body.force
at each tick: style = relay
    a <- body.force [encode: 1 x mN -> 4 neurons]
every 1 s: repeat 2 times
  end = sum, forked state
      a <- last style.same [decode: 4 neurons -> 1 x mN], then end.sum
      b <- its initial value (1) mN
  click = count, fresh state
      a <- previous click.count
every 1 s: command push <- end.sum"""

CHART = """\
flowchart LR
  sensors(["body"])
  step_style["style<br/><i>relay</i>"]
  subgraph repeat1["2 times"]
    step_end["end<br/><i>sum</i>"]
    step_click["click<br/><i>count</i>"]
  end
  actuators(["body"])
  sensors -->|force mN| step_style
  step_style -->|same mN| step_end
  step_end -.->|sum mN| step_end
  step_end -->|sum mN| actuators
  step_click -.->|count mN| step_click"""


def test_the_schedule() -> None:
    assert "\n".join(schedule_lines(three_steps())) == SCHEDULE


def test_the_chart_takes_no_name_of_a_step_for_a_word_of_its_own() -> None:
    assert "\n".join(mermaid_lines(three_steps())) == CHART


SUMMARY = {
    "episodes": [{}, {}],
    "aggregate": {
        "success": {"mean": 0.5, "standard_error": 0.5, "worst": 0.0},
        "duration_s": {"mean": 1234.56, "standard_error": 0.012345, "worst": 2000.0},
    },
}
ONE = {"episodes": [{}], "aggregate": {"success": {"mean": 1.0, "standard_error": None, "worst": 1.0}}}

SEVERAL_EPISODES = """\
cart, 2 episodes
┏━━━━━━━━━━━━┳━━━━━━━━━━━━━━┳━━━━━━━┓
┃ figure     ┃         mean ┃ worst ┃
┡━━━━━━━━━━━━╇━━━━━━━━━━━━━━╇━━━━━━━┩
│ success    │    0.5 ± 0.5 │     0 │
│ duration_s │ 1235 ± 0.012 │  2000 │
└────────────┴──────────────┴───────┘"""

ONE_EPISODE = """\
cart, 1 episode
┏━━━━━━━━━┳━━━━━━━┓
┃ figure  ┃ value ┃
┡━━━━━━━━━╇━━━━━━━┩
│ success │     1 │
└─────────┴───────┘"""

COMPARISON = """\
mean ± standard error, and the worst episode
┏━━━━━━━━━━━━━━━━━━━━┳━━━━━━━━━━━━━━┳━━━━━━━┓
┃ figure             ┃         mean ┃ worst ┃
┡━━━━━━━━━━━━━━━━━━━━╇━━━━━━━━━━━━━━╇━━━━━━━┩
│ episodes           │              │       │
│   cart             │            2 │       │
│   record=[scripts] │            1 │       │
│ success            │              │       │
│   cart             │    0.5 ± 0.5 │     0 │
│   record=[scripts] │            1 │     1 │
│ duration_s         │              │       │
│   cart             │ 1235 ± 0.012 │  2000 │
└────────────────────┴──────────────┴───────┘"""


def shown(table: Table) -> str:
    console = Console(file=io.StringIO(), width=80)
    console.print(table)
    assert isinstance(console.file, io.StringIO)
    return "\n".join(line.rstrip() for line in console.file.getvalue().splitlines())


def test_the_summary_of_several_episodes_and_of_one() -> None:
    assert shown(summary_table("cart", SUMMARY)) == SEVERAL_EPISODES
    assert shown(summary_table("cart", ONE)) == ONE_EPISODE


def test_a_comparison_has_under_each_figure_a_row_for_every_experiment_that_has_it() -> None:
    assert shown(comparison_table({"cart": SUMMARY, "record=[scripts]": ONE})) == COMPARISON


def test_a_comparison_of_many_experiments_fits_a_narrow_terminal() -> None:
    name = "regions.prefrontal_cortex=acme.teacher"
    lines = shown(comparison_table({f"{name}{index}": SUMMARY for index in range(9)})).splitlines()
    assert sum(name in line for line in lines) == 9 * 3
    assert max(map(len, lines)) <= 80


def test_training_is_told_in_a_few_lines_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    steps = 10 * LINES_PER_PHASE + 1
    with training_progress() as show:
        for done in range(1, steps + 1):
            show("0 cortex", done, steps, {"speed": 0.123456, "move": 20.0}, 0.257)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "0 cortex: 10 of 201  speed 0.123  move 20  rate 0.26"
    assert lines[-1] == "0 cortex: 201 of 201  speed 0.123  move 20  rate 0.26"
    assert len(lines) == LINES_PER_PHASE + 1


def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """Let the error stream be a terminal that keeps what it shows."""

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    for name, value in {"TERM": "xterm", "COLUMNS": "100", "NO_COLOR": "1"}.items():
        monkeypatch.setenv(name, value)
    return stream


def assert_in_order(words: Sequence[str], text: str) -> None:
    for word in words:
        assert word in text
        text = text.partition(word)[2]


def test_bars_are_shown_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = terminal(monkeypatch)
    with training_progress() as show:
        show("0 cortex", 3, 4, {"speed": 0.5}, 0.1)
        show("0 cortex", 4, 4, {"speed": 0.25}, 0.1)
    assert_in_order(["0 cortex", "━━━", "speed 0.25  rate 0.10", "0:00:00"], stream.getvalue())


def test_a_run_shows_its_tick_on_a_terminal_and_nothing_elsewhere(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with RunProgress() as progress:
        progress(17, 3)
    assert capsys.readouterr().err == ""
    stream = terminal(monkeypatch)
    with RunProgress() as progress:
        progress(17, 3)
    assert_in_order(["tick 17, 3 running", "0:00:00"], stream.getvalue())
