"""Send on delta: what arrives is within a threshold of what is, and nothing is sent in vain."""

from collections.abc import Mapping, Sequence
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from neurorobo.bodies import Sensor
from neurorobo.clock import Clock
from neurorobo.codes.population_signed import PopulationSigned
from neurorobo.config.plugged_reader import read_plugged
from neurorobo.errors import ConfigError
from neurorobo.graph.brain import Brain
from neurorobo.graph.compile import compile_graph
from neurorobo.graph.spec import RepeatSpec, StepSpec
from neurorobo.plugins import Registry
from neurorobo.regions import Port
from neurorobo.regions.delta import DeltaDecoder, DeltaEncoder
from neurorobo.regions.delta_config import DeltaDecoderConfig, DeltaEncoderConfig
from neurorobo.testing import check_region

MS = 1_000_000
WINDOW = 20
CLOCK = Clock({"control": 1000 * MS, "fast": 250 * MS}, MS, WINDOW)

values = st.floats(-1000, 1000, width=32)


def encoder(threshold: str = "0.5 mN", width: int = 1) -> DeltaEncoder:
    config = DeltaEncoderConfig(unit="mN", width=width, threshold=threshold)
    return DeltaEncoder(config, CLOCK, torch.Generator())


def decoder(width: int = 1) -> DeltaDecoder:
    return DeltaDecoder(DeltaDecoderConfig(unit="mN", width=width), CLOCK, torch.Generator())


def sent(course: Sequence[float], threshold_mN: float = 0.5) -> tuple[list[Tensor], list[float], list[float]]:
    """The spikes of each window, what the encoder knows that it has told, and what the decoder makes of it."""
    one, other = encoder(f"{threshold_mN} mN"), decoder()
    code = one.output_ports["change"].code
    assert code is not None
    state, heard = one.init_state(1), other.init_state(1)
    spikes, told, arrived = [], [], []
    for value in course:
        outputs, state = one.step({"value": torch.tensor([[value]])}, state)
        said, heard = other.step({"change": code.decode(outputs["change"])}, heard)
        spikes.append(outputs["change"])
        told.append(state["told"].item())
        arrived.append(said["value"].item())
    return spikes, told, arrived


@pytest.mark.parametrize("width", [1, 3])
def test_both_keep_the_contract_of_regions(width: int) -> None:
    check_region(DeltaEncoderConfig(unit="mN", width=width, threshold="0.1 mN"), CLOCK)
    check_region(DeltaDecoderConfig(unit="mN", width=width), CLOCK)


@given(course=st.lists(values, min_size=1, max_size=6), threshold_mN=st.sampled_from([0.125, 0.5, 0.3, 7.0]))
def test_what_arrives_is_what_was_told_to_the_last_bit(course: list[float], threshold_mN: float) -> None:
    _, told, arrived = sent(course, threshold_mN)
    assert arrived == told


@given(moves=st.lists(st.floats(-1, 1, width=32), min_size=1, max_size=12), threshold_mN=st.sampled_from([0.5, 0.3]))
def test_what_arrives_is_within_a_threshold_while_no_window_moves_further_than_it_has_steps(
    moves: list[float], threshold_mN: float
) -> None:
    fastest = WINDOW * threshold_mN
    course = [fastest * sum(moves[: i + 1]) for i in range(len(moves))]
    _, _, arrived = sent(course, threshold_mN)
    assert max(abs(a - v) for a, v in zip(arrived, course, strict=True)) <= threshold_mN * (1 + 1e-4)


@given(value=values, threshold_mN=st.sampled_from([0.5, 0.3, 7.0]))
def test_what_moves_further_is_caught_up_with_at_the_stated_pace(value: float, threshold_mN: float) -> None:
    fastest = WINDOW * threshold_mN
    windows = int(abs(value) / fastest) + 1
    spikes, _, arrived = sent([value] * (windows + 1), threshold_mN)
    for number, said in enumerate(arrived[:-2], start=1):
        assert abs(said) == pytest.approx(fastest * number, rel=1e-4)
    assert abs(arrived[-2] - value) <= threshold_mN * (1 + 1e-4)
    assert all(window.sum() <= WINDOW for window in spikes)


@given(start=values, wiggle=st.lists(st.floats(-0.49, 0.49), min_size=1, max_size=5))
def test_nothing_is_sent_while_nothing_has_gone_a_threshold_from_what_was_told(
    start: float, wiggle: list[float]
) -> None:
    grid = round(start)
    windows = 1 + abs(grid) // 10  # twenty steps of 0.5 mN
    spikes, _, _ = sent([grid] * windows + [grid + each for each in wiggle])
    assert sum(window.sum() for window in spikes[windows:]) == 0
    assert sum(window.sum() for window in spikes) == 2 * abs(grid)


def test_rising_is_told_by_on_spikes_and_falling_by_off_spikes() -> None:
    spikes, _, _ = sent([2.0, -1.0])
    assert spikes[0].sum((0, 1)).tolist() == [4, 0]
    assert spikes[1].sum((0, 1)).tolist() == [0, 6]


def test_the_resolution_of_its_port_is_the_threshold() -> None:
    port = encoder("300 uN").output_ports["change"]
    assert port == Port("mN", 1, PopulationSigned(2, -6.0, 6.0), description=port.description)
    assert port.code is not None
    assert port.code.resolution(WINDOW) == pytest.approx(0.3)


class Listener:
    """Keeps what each step says, as numbers."""

    def __init__(self) -> None:
        self.values: list[float] = []

    def used(self, use: Any, iteration: int, inputs: Any, outputs: Mapping[str, Tensor], numbers: Any) -> None:
        if use.name == "receive":
            self.values.append(outputs["value"].item())

    def probe(self, use: Any, *, last: bool) -> None: ...

    def saturated(self, edge: Any, count: Tensor) -> None: ...


@pytest.mark.parametrize(
    ("every", "change"), [("fast", "send.change"), ("control", "sum send.change")], ids=["as often", "less often"]
)
def test_in_a_graph_no_change_is_lost_also_where_the_receiver_runs_less_often(every: str, change: str) -> None:
    regions = {"sender": DeltaEncoderConfig(unit="mN", threshold="0.5 mN"), "receiver": DeltaDecoderConfig(unit="mN")}
    steps = [
        StepSpec("send", "sender", every="fast", inputs={"value": "body.force"}),
        StepSpec("receive", "receiver", every=every, inputs={"change": change}),
    ]
    plan = compile_graph(steps, {}, regions, CLOCK, {"force": Sensor("mN")}, {})
    brain = Brain(plan, {"sender": encoder(), "receiver": decoder()})
    state, listener = brain.init_state([0]), Listener()
    course = [0.5 * tick for tick in range(1, 18)]
    for value in course:
        _, state = brain.tick({"force": torch.tensor([[value]])}, state, listener)
    assert listener.values == course[:: 1 if every == "fast" else 4]


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"threshold": "0 mN"}, "a threshold is above zero (got '0 mN')"),
        ({"threshold": "-1 mN"}, "a threshold is above zero"),
        ({"threshold": "1 um"}, "is a length, wanted a force"),
        ({"threshold": 3}, "needs a unit"),
        ({"carry": "never"}, "must be 'always'"),
        ({"unit": "mNN"}, "'mNN' is not a unit"),
        ({"width": 0}, "greater than or equal to 1"),
    ],
)
def test_what_makes_no_sense_is_refused(setting: dict[str, Any], words: str) -> None:
    described = {"type": "delta_encoder", "unit": "mN", "threshold": "0.5 mN", **setting}
    with pytest.raises(ConfigError) as caught:
        read_plugged("region", described, Registry())
    assert words in str(caught.value)


def test_a_decoder_has_no_threshold_to_be_told_wrong() -> None:
    with pytest.raises(ConfigError, match="unknown key `threshold`"):
        read_plugged("region", {"type": "delta_decoder", "unit": "mN", "threshold": "1 mN"}, Registry())


@pytest.mark.parametrize(
    ("send", "receive", "repeat", "words"),
    [
        ({"every": "control"}, {"every": "fast"}, (), "would add the same change again"),
        ({"every": "control"}, {"every": "fast", "change": "previous send.change"}, (), "add the same change again"),
        ({}, {}, ("receive",), "would add the same change again"),
        ({}, {}, ("send",), "would miss iterations"),
        ({"every": "fast"}, {"change": "last send.change"}, (), "write `sum send.change`"),
        ({"state": "fork"}, {}, (), "no step keeps the state of `sender`"),
        ({}, {"state": "fresh"}, (), "no step keeps the state of `receiver`"),
        ({}, {}, ("send", "receive"), None),
        ({}, {"change": "previous send.change"}, (), None),
    ],
)
def test_a_graph_in_which_changes_would_be_lost_or_added_twice_is_refused(
    send: dict[str, str], receive: dict[str, str], repeat: tuple[str, ...], words: str | None
) -> None:
    regions = {"sender": DeltaEncoderConfig(unit="mN", threshold="0.5 mN"), "receiver": DeltaDecoderConfig(unit="mN")}
    change = receive.pop("change", "send.change")
    uses = {
        "send": StepSpec("send", "sender", inputs={"value": "body.force"}, **send),  # type: ignore[arg-type]
        "receive": StepSpec("receive", "receiver", inputs={"change": change}, **receive),  # type: ignore[arg-type]
    }
    steps: list[StepSpec | RepeatSpec] = [use for name, use in uses.items() if name not in repeat]
    if repeat:
        steps.insert(0 if "send" in repeat else 1, RepeatSpec(3, tuple(uses[name] for name in repeat)))
    if words is None:
        compile_graph(steps, {}, regions, CLOCK, {"force": Sensor("mN")}, {})
        return
    with pytest.raises(ConfigError, match=words):
        compile_graph(steps, {}, regions, CLOCK, {"force": Sensor("mN")}, {})
