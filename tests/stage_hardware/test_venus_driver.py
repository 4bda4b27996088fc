"""The drivers of Venus-1 and Venus-2 against replies that are set by hand, taken from the tables of their words."""

import re
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from stage_hardware.drivers.venus import FRESH_NS, Venus1Stage, Venus2Stage, VenusAxis, VenusStage
from stage_hardware.emulators.wire import TcpPort
from stage_hardware.errors import (
    HardwareError,
    InterruptedByStopError,
    LinkError,
    RefusedError,
    ReplyError,
    ReplyTimeoutError,
)
from stage_hardware.stage import Axis

X = Axis("um", -1_000, 9_000, 0.1, 2_000, 20_000)
Y = Axis("um", 0, 5_000, 0.1, 4_000, 10_000)
AXES = {"x": VenusAxis(X, 1, origin=-1_000), "y": VenusAxis(Y, 2)}

CORVUS = {
    "identify": "Corvus 1 462 1 380",
    "getjoystick": "0",
    "-1 getunit": "2 2 2 2",
    "getvel": "2.000000",
    "getaccel": "10.000000",
    "p": "0.000000 0.000000 0.000000",
    "pos": "0.000000 0.000000 0.000000",
    "st": "0",
    "ge": "0",
    "1 getcaldone": "3",
    "2 getcaldone": "3",
    "1 getnlimit": "0.000000 20.000000",
    "2 getnlimit": "0.000000 20.000000",
    "1 getswst": "0 0",
    "2 getswst": "0 0",
}
POLLUX = {
    "1 nst": "0",
    "2 nst": "0",
    "1 np": "0.000000",
    "2 np": "0.000000",
    "1 gne": "0",
    "2 gne": "0",
    "1 gnv": "2.000000",
    "2 gnv": "4.000000",
}


class Peer:
    """Answers words with what a test has written down, and remembers them all, arguments first, in order."""

    def __init__(self, replies: dict[str, str]) -> None:
        self.replies, self.once, self.heard, self.bytes = dict(replies), dict[str, str](), list[str](), b""
        self._rest = b""

    def answer(self, data: bytes) -> Iterable[bytes]:
        self.bytes += data
        *tokens, self._rest = re.split(rb"[ \r\n]|(?<=\x03)", self._rest + data)
        for token in tokens:
            text = token.decode("ascii")
            if not text:
                continue
            self._arguments = [*getattr(self, "_arguments", []), text]
            if re.fullmatch(r"[a-z]+|\x03", text):
                phrase, self._arguments = " ".join(self._arguments), []
                self.heard.append(phrase)
                reply = self.once.pop(phrase, self.replies.get(phrase))
                if reply is not None:
                    yield reply.encode("ascii") + b"\r\n"

    def orders(self) -> list[str]:
        """Return what was no question, and forget it."""
        questions = r"(.* )?(get\w+|p|pos|st|ge|np|nst|gne|gnv|identify)"
        heard, self.heard = self.heard, []
        return [words for words in heard if not re.fullmatch(questions, words)]


@pytest.fixture
def corvus() -> Iterator[tuple[Peer, TcpPort]]:
    peer = Peer(CORVUS)
    with TcpPort(peer.answer) as wire:
        yield peer, wire


@pytest.fixture
def pollux() -> Iterator[tuple[Peer, TcpPort]]:
    peer = Peer(POLLUX)
    with TcpPort(peer.answer) as wire:
        yield peer, wire


def venus_1(wire: TcpPort, axes: dict[str, VenusAxis] = AXES, **more: str) -> Venus1Stage:
    return Venus1Stage("table", wire.url, axes, timeout_s=0.15, **more)


def venus_2(wire: TcpPort, axes: dict[str, VenusAxis] = AXES) -> Venus2Stage:
    return Venus2Stage("table", wire.url, axes, timeout_s=0.15)


def homed(stage: VenusStage, peer: Peer) -> None:
    """Home axes one after the other: whatever was begun has ended when it is asked for."""
    stage.home(stage.axes)
    for _ in stage.axes:
        state = stage.state()
    assert all(axis.referenced and not axis.moving for axis in state.axes.values()), state
    assert state.fault is None
    peer.orders()


# What both promise


@given(position=st.floats(-1_000, 9_000), resolution=st.sampled_from([0.1, 0.05, 0.25, 0.3, 1.0]))
def test_targets_go_out_as_the_nearest_step_exactly(position: float, resolution: float) -> None:
    axis = VenusAxis(Axis("um", -1_000, 9_000, resolution, 1, 1), origin=-1_000)
    from_switch = Fraction(axis.controller_value(position)) * 1000
    assert (from_switch / Fraction(repr(resolution))).denominator == 1
    assert 0 <= from_switch <= 10_000
    assert (
        abs(from_switch - 1_000 - Fraction(position)) <= Fraction(repr(resolution)) / 2 or position > 9_000 - resolution
    )
    assert axis.position(float(from_switch) / 1000) == pytest.approx(float(from_switch) - 1_000)


def test_axes_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match="in um or mdeg, got 'mm'"):
        VenusAxis(Axis("mm", 0, 1, 0.1, 1, 1))
    with pytest.raises(ValueError, match="above its lower switch at 0, got -1000"):
        VenusAxis(X)
    with pytest.raises(ValueError, match="numbered from 1, got 0"):
        VenusAxis(Y, 0)
    with pytest.raises(ValueError, match=r"connectors of their own, got \[2, 2\]"):
        Venus1Stage("table", "nowhere", {"x": VenusAxis(Y, 2), "y": VenusAxis(Y, 2)})


@pytest.mark.parametrize("dialect", [1, 2])
def test_moves_before_homing_or_beyond_limits_go_nowhere(
    dialect: int, corvus: tuple[Peer, TcpPort], pollux: tuple[Peer, TcpPort]
) -> None:
    peer, wire = corvus if dialect == 1 else pollux
    with venus_1(wire) if dialect == 1 else venus_2(wire) as stage:
        peer.orders()
        with pytest.raises(HardwareError, match="axis x does not know where it is; home it first"):
            stage.move_to({"x": 5.0})
        homed(stage, peer)
        for target in (9_000.1, -1_000.1, float("nan"), float("inf")):
            with pytest.raises(HardwareError, match=r"axis x would go to .* um; stay within -1000\.\.9000 um"):
                stage.move_to({"x": target})
        for order in (stage.home, lambda axes: stage.move_to(dict.fromkeys(axes, 0.0))):
            with pytest.raises(HardwareError, match="no axis 'z'; it has x, y"):
                order(["z"])
        stage.move_to({})
        stage.home([])
        assert peer.orders() == []


# Venus-1


def test_a_corvus_is_set_to_mm_and_speeds_and_nothing_moves(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    peer.once["getvel"] = "2.0"
    with venus_1(wire) as stage:
        assert peer.bytes.startswith(b" 0 mode ge ")
        assert peer.orders() == ["0 mode", "0 joystick", "2 1 setunit", "2 2 setunit", "2 setvel", "10 setaccel"]
        before = time.monotonic_ns()
        state = stage.state()
        assert before <= state.time_ns <= time.monotonic_ns()
        assert not any(axis.moving or axis.referenced for axis in state.axes.values())
        assert state.fault is None and (state.axes["x"].position, state.axes["y"].position) == (-1_000, 0)


def test_a_velocity_in_another_unit_is_converted(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    peer.replies |= {"-1 getunit": "2 2 2 1", "getvel": "2000.0", "getaccel": "10000.0"}
    with venus_1(wire):
        assert peer.orders()[-2:] == ["2000 setvel", "10000 setaccel"]


@pytest.mark.parametrize(
    ("reply", "match"),
    [
        ({"identify": "Hydra 1"}, "it says 'Hydra 1', where 'Corvus' is missing"),
        ({"pos": "0.0"}, "axis y is number 2, and it is set to 1 axes"),
        ({"-1 getunit": "2 1 2 2"}, r"its units are \[2, 1, 2, 2\] after they were set to 2, which is mm"),
        ({"-1 getunit": "2 2 2 0"}, "its velocity has the unit 0; set it to a length"),
        ({"getvel": "26.0"}, "setvel set to 2 leaves 26; see what the controller allows"),
        ({"getaccel": "1"}, "setaccel set to 10 leaves 1"),
        ({"getjoystick": "1"}, "its joystick stays on"),
        ({"st": "1"}, "it moves already"),
        ({"st": "idle"}, "'idle' is no answer to 'st'"),
        ({"p": "0.0 0.0"}, "'0.0 0.0' is no answer to 'p'"),
        ({"p": "nan 0.0 0.0"}, "is no answer to 'p'"),
    ],
)
def test_a_corvus_that_is_not_as_it_should_be_is_not_connected(
    corvus: tuple[Peer, TcpPort], reply: dict[str, str], match: str
) -> None:
    peer, wire = corvus
    peer.replies |= reply
    stage = venus_1(wire)
    with pytest.raises(HardwareError, match=match):
        stage.connect()
    with pytest.raises(LinkError, match="not connected"):
        stage.state()
    stage.close()
    stage.close()


def test_a_setting_that_is_refused_is_told(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    peer.replies["ge"] = "1007"
    with pytest.raises(RefusedError, match=r"'0 joystick' was refused: an argument is out of range \(error 1007\)"):
        venus_1(wire).connect()


def test_a_corvus_homes_one_axis_after_the_other_unless_there_are_no_more(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        peer.orders()
        stage.home(["y", "x"])
        assert peer.orders() == ["1 ncal"]
        peer.replies["st"] = "1"
        state = stage.state()
        assert state.axes["x"].moving and state.axes["y"].moving and not state.axes["x"].referenced
        assert peer.orders() == []
        peer.replies["st"] = "0"
        state = stage.state()
        assert state.axes["x"].referenced and not state.axes["x"].moving and state.axes["y"].moving
        assert peer.orders() == ["2 ncal"]
        state = stage.state()
        assert state.axes["y"].referenced and state.fault is None
        assert not state.axes["y"].moving
    peer.replies |= {"p": "0.0 0.0", "pos": "0.0 0.0"}
    with venus_1(wire) as stage:
        peer.orders()
        stage.home(["x", "y"])
        assert peer.orders() == ["cal"]
        assert all(axis.referenced for axis in stage.state().axes.values())


@pytest.mark.parametrize(
    ("replies", "fault"),
    [
        ({"1 getcaldone": "2"}, "axis x has not found its switch: home it again"),
        ({"p": "0.5 0.0 0.0"}, "axis x has not found its switch: home it again"),
        (
            {"1 getnlimit": "0.0 9.0"},
            "the limits of axis x, -1000..9000 um, are wider than the controller's, -1000..8000: narrow them, or let "
            "the controller measure its range",
        ),
    ],
)
def test_an_origin_is_checked(corvus: tuple[Peer, TcpPort], replies: dict[str, str], fault: str) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        stage.home(["x"])
        peer.replies |= replies
        state = stage.state()
        assert state.fault == fault and not state.axes["x"].referenced
        with pytest.raises(HardwareError, match="home it first"):
            stage.move_to({"x": 0.0})


def test_one_axis_moves_by_itself_and_several_together(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        homed(stage, peer)
        stage.move_to({"x": 500.04})
        assert peer.orders() == ["1.5 1 nmove"]
        peer.replies |= {"st": "1", "p": "0.75 0.0 0.0"}
        state = stage.state()
        assert state.axes["x"].moving and not state.axes["y"].moving and state.axes["x"].position == -250
        with pytest.raises(RefusedError, match="axis x moves; wait until it rests, or stop it"):
            stage.move_to({"y": 0.0})
        with pytest.raises(RefusedError, match="axis x moves"):
            stage.home(["x"])
        assert peer.orders() == []
        peer.replies |= {"st": "0", "p": "1.500000 0.000000 0.250000"}
        state = stage.state()
        assert state.axes["x"].position == 500 and state.axes["x"].referenced and state.fault is None
        stage.move_to({"y": 100.0, "x": 0.0})
        assert peer.orders() == ["1.0 0.1 0.250000 move"]


def test_a_refused_move_is_told_in_words_and_forgotten(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        homed(stage, peer)
        for code, words in (("1004", "the target is out of range"), ("3", "an error of its own"), ("77", "not know")):
            peer.once["ge"] = code
            with pytest.raises(RefusedError, match=rf"{words}.* \(error {code}\); see to its limits"):
                stage.move_to({"x": 100.0})
            state = stage.state()
            assert state.fault is None and state.axes["x"].referenced and not state.axes["x"].moving


def test_a_stop_is_a_byte_and_a_word_and_ends_homing(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        stage.home(["x", "y"])
        peer.replies["st"] = "1"
        stage.state()
        stage.stop()
        peer.replies["st"] = "0"
        state = stage.state()
        assert b"\x03abort " in peer.bytes
        assert not any(axis.referenced or axis.moving for axis in state.axes.values())
        assert state.fault is None
        stage.home(["x"])
        assert stage.state().axes["x"].referenced


def test_an_error_that_a_stop_leaves_is_not_that_of_the_next_order(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        homed(stage, peer)
        stage.stop()
        peer.once["ge"] = "1015"
        stage.move_to({"x": 0.0})
        assert peer.orders()[-1] == "1.0 1 nmove"


def test_an_error_of_a_motion_is_a_fault_until_the_next_one(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        homed(stage, peer)
        stage.move_to({"x": 0.0})
        peer.once["ge"] = "1015"
        peer.replies["p"] = "1.0 0.0 0.0"
        assert stage.state().fault == "the position is outside its working range (error 1015)" == stage.state().fault
        stage.move_to({"x": 0.0})
        assert stage.state().fault is None


def test_a_stop_goes_past_a_question_that_is_not_answered(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    raised: list[HardwareError] = []
    stage = Venus1Stage("table", wire.url, AXES, timeout_s=3.0)
    stage.link.timeout_s = 0.15
    with stage:
        stage.link.timeout_s = 3.0
        del peer.replies["st"]

        def ask() -> None:
            try:
                stage.state()
            except HardwareError as error:
                raised.append(error)

        thread = threading.Thread(target=ask)
        thread.start()
        time.sleep(0.1)
        began = time.monotonic()
        stage.stop()
        assert time.monotonic() - began < 0.2
        thread.join(2)
        assert isinstance(raised[0], InterruptedByStopError)
        stage.link.timeout_s = 0.15
        peer.replies["st"] = "0"
        assert stage.state().fault is None


def test_a_move_that_was_decided_on_before_a_stop_does_not_go_out(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        homed(stage, peer)
        time.sleep(FRESH_NS * 1e-9)
        read = stage._read

        def stopped_meanwhile() -> object:
            reading = read()
            stage.stop()
            return reading

        stage._read = stopped_meanwhile  # type: ignore[method-assign, assignment]
        with pytest.raises(InterruptedByStopError):
            stage.move_to({"x": 0.0})
        assert not any("move" in words for words in peer.orders())


def test_a_loop_that_asks_and_sends_at_once_does_not_ask_twice(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        homed(stage, peer)

        def asked_before_move(waits_s: float = 0.0) -> bool:
            assert not stage.state().axes["x"].moving
            peer.heard.clear()
            time.sleep(waits_s)
            stage.move_to({"x": X.lo})
            return "st" in peer.heard

        assert not asked_before_move()
        assert asked_before_move(FRESH_NS * 1e-9)
        stage.state()
        stage.move_to({"x": X.lo})
        peer.heard.clear()
        stage.move_to({"x": X.lo})
        assert "st" in peer.heard, "after an order it is not known any more"
        assert not asked_before_move()
        stage.state()
        stage.stop()
        peer.heard.clear()
        with suppress(HardwareError):
            stage.move_to({"x": X.lo})
        assert "st" in peer.heard, "nor after a stop"


def test_after_a_missing_reply_it_looks_before_it_moves_and_never_sends_twice(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        homed(stage, peer)
        del peer.replies["ge"]
        with pytest.raises(ReplyTimeoutError, match="no reply to 'ge'"):
            stage.move_to({"x": 0.0})
        assert peer.orders() == ["1.0 1 nmove"]
        peer.replies |= {"ge": "0", "st": "1", "p": "0.4 0.0 0.0"}
        with pytest.raises(RefusedError, match="axis x moves"):
            stage.move_to({"x": 0.0})
        peer.replies |= {"st": "0", "p": "1.0 0.0 0.0"}
        assert stage.state().axes["x"].referenced
        assert peer.orders() == []


def test_a_late_reply_is_not_taken_for_another(corvus: tuple[Peer, TcpPort]) -> None:
    _, wire = corvus
    with venus_1(wire) as stage:
        wire.faults.late_reply, wire.faults.late_s = 1, 0.2
        with pytest.raises(ReplyTimeoutError):
            stage.state()
        assert stage.state().axes["x"].position == -1_000
        wire.faults.late_reply, wire.faults.late_s = 1, 2.5 * stage.link.timeout_s
        with pytest.raises(ReplyTimeoutError):
            stage.state()
        with pytest.raises(ReplyError, match="is no answer to 'identify'"):  # it comes when the next was asked
            stage.state()
        assert stage.state().axes["x"].position == -1_000
        wire.faults.garbled_reply = 1
        with pytest.raises(ReplyError, match="is no answer to 'st'"):
            stage.state()
        assert stage.state().fault is None
        wire.faults.split_reply = 2
        assert stage.state().fault is None
        wire.faults.wrong_terminator = 1
        with pytest.raises(ReplyTimeoutError):
            stage.state()
        assert stage.state().fault is None


def test_a_pulled_cable_is_told(corvus: tuple[Peer, TcpPort]) -> None:
    _, wire = corvus
    stage = venus_1(wire)
    stage.connect()
    wire.faults.hang_up = True
    with pytest.raises(LinkError, match="is gone"):
        for _ in range(20):
            stage.state()
    stage.close()


@pytest.mark.parametrize("lost", [{"1 getcaldone": "0"}, {"getvel": "10.0"}])
def test_a_power_cycle_is_found_out_and_settings_are_written_again(
    corvus: tuple[Peer, TcpPort], lost: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    peer, wire = corvus
    monkeypatch.setattr("stage_hardware.drivers.venus.RESTART_NS", 0)
    with venus_1(wire) as stage:
        homed(stage, peer)
        peer.replies |= lost
        state = stage.state()
        assert state.fault == "it has been switched off and on: home its axes"
        assert not any(axis.referenced for axis in state.axes.values())
        peer.replies |= CORVUS
        with pytest.raises(HardwareError, match="home it first"):
            stage.move_to({"x": 0.0})
        homed(stage, peer)
    with venus_1(wire) as stage:
        homed(stage, peer)
        peer.replies |= lost
        stage.state()
        peer.replies |= CORVUS
        stage.home(["x"])
        assert peer.orders()[:4] == ["0 mode", "0 joystick", "2 1 setunit", "2 2 setunit"]


def test_an_axis_that_rests_elsewhere_has_lost_its_reference(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        homed(stage, peer)
        peer.replies["p"] = "0.0004 0.0 0.0"  # within the tolerance
        assert stage.state().fault is None
        peer.replies["p"] = "0.25 0.0 0.0"
        state = stage.state()
        assert state.fault is not None and state.fault.startswith("axis x rests at -750 um and was not sent there")
        assert not state.axes["x"].referenced and state.axes["y"].referenced


def test_a_switch_on_the_way_is_told_and_not_asked_for_while_it_moves(corvus: tuple[Peer, TcpPort]) -> None:
    peer, wire = corvus
    with venus_1(wire) as stage:
        homed(stage, peer)
        stage.move_to({"x": 5_000.0})
        peer.replies |= {"st": "1", "p": "2.0 0.0 0.0", "1 getswst": "0 1"}
        peer.heard.clear()
        assert not stage.state().axes["x"].at_upper_limit
        assert "1 getswst" not in peer.heard
        peer.replies |= {"st": "0"}
        state = stage.state()
        assert state.axes["x"].at_upper_limit and not state.axes["x"].at_lower_limit
        assert state.fault == "axis x ran onto a limit switch: move it back"
        stage.move_to({"x": 500.0})
        peer.replies |= {"p": "1.5 0.0 0.0", "1 getswst": "0 0"}
        peer.heard.clear()
        state = stage.state()
        assert state.fault is None and not state.axes["x"].at_upper_limit
        assert "1 getswst" not in peer.heard, "it is where it was sent"


# Venus-2


def test_a_pollux_is_set_axis_by_axis(pollux: tuple[Peer, TcpPort]) -> None:
    peer, wire = pollux
    with venus_2(wire) as stage:
        assert peer.orders() == ["0 nmode", "2 1 snv", "20 1 sna", "4 2 snv", "10 2 sna"]
        stage.home(["x", "y"])
        assert peer.orders() == ["1 ncal", "2 ncal"]
        peer.replies["1 nst"] = "1"
        state = stage.state()
        assert state.axes["x"].moving and not state.axes["x"].referenced
        assert not state.axes["y"].moving and state.axes["y"].referenced
        assert peer.orders() == ["0.0 5.0 2 setnlimit"]
        stage.move_to({"y": 250.0})  # while the other one moves
        assert peer.orders() == ["0.25 2 nm"]
        peer.replies["2 nst"] = "1"
        with pytest.raises(RefusedError, match="axis x moves"):
            stage.home(["x"])
        peer.replies |= {"1 nst": "0", "2 nst": "0", "2 np": "0.250000"}
        state = stage.state()
        assert all(axis.referenced and not axis.moving for axis in state.axes.values()) and state.fault is None
        assert peer.orders() == ["0.0 10.0 1 setnlimit"]
        stage.stop()
        stage.state()
        assert b"\x031 nabort 2 nabort \r" in peer.bytes


@pytest.mark.parametrize(
    ("status", "fault"),
    [
        (0x04, "axis x reports an error of its machine"),
        (0x80, "axis x has its motor off"),
        (0x02, "axis x is under manual control"),
    ],
)
def test_what_hinders_an_axis_of_a_pollux_is_a_fault(pollux: tuple[Peer, TcpPort], status: int, fault: str) -> None:
    peer, wire = pollux
    with venus_2(wire) as stage:
        homed(stage, peer)
        peer.replies["1 nst"] = str(status)
        assert stage.state().fault == fault
        with pytest.raises(RefusedError, match=fault):
            stage.move_to({"x": 0.0})
        stage.move_to({"y": 0.0})
        assert peer.orders() == ["0.0 2 nm"]
        peer.replies["1 nst"] = "0"
        stage.home(["x"])
        peer.replies["1 nst"] = str(status)
        state = stage.state()
        assert not state.axes["x"].referenced and "has not found its switch" in str(state.fault)


def test_an_end_of_travel_is_the_one_it_went_to(pollux: tuple[Peer, TcpPort]) -> None:
    peer, wire = pollux
    with venus_2(wire) as stage:
        homed(stage, peer)
        stage.move_to({"x": 8_000.0})
        peer.replies |= {"1 nst": str(0x40), "1 np": "6.0"}
        state = stage.state()
        assert state.axes["x"].at_upper_limit and not state.axes["x"].at_lower_limit
        assert state.fault == "axis x ran onto a limit switch: move it back"


def test_a_refusal_of_a_pollux_is_told(pollux: tuple[Peer, TcpPort]) -> None:
    peer, wire = pollux
    with venus_2(wire) as stage:
        homed(stage, peer)
        peer.once["2 gne"] = "1004"
        with pytest.raises(RefusedError, match=r"'0\.1 2 nm' was refused: the target is out of range \(error 1004\)"):
            stage.move_to({"y": 100.0})
        assert stage.state().fault is None


def test_a_pollux_that_falls_silent_at_its_origin_may_have_lost_its_power(pollux: tuple[Peer, TcpPort]) -> None:
    peer, wire = pollux
    with venus_2(wire) as stage:
        homed(stage, peer)
        stage.move_to({"y": 300.0})
        peer.replies["2 np"] = "0.3"
        stage.state()
        wire.faults.no_reply = 1
        with pytest.raises(ReplyTimeoutError):
            stage.state()
        state = stage.state()
        assert state.fault == "axis x may have lost its power while no reply came: home it"
        assert not state.axes["x"].referenced and state.axes["y"].referenced


def test_a_pollux_that_was_restarted_has_other_speeds(
    pollux: tuple[Peer, TcpPort], monkeypatch: pytest.MonkeyPatch
) -> None:
    peer, wire = pollux
    with venus_2(wire) as stage:
        homed(stage, peer)
        monkeypatch.setattr("stage_hardware.drivers.venus.RESTART_NS", 0)
        peer.replies["2 gnv"] = "1.0"
        state = stage.state()
        assert state.fault == "it has been switched off and on: home its axes"
        assert not any(axis.referenced for axis in state.axes.values())


def test_the_driver_adds_little_to_the_time_of_the_wire() -> None:
    import serial

    def raw(port: serial.Serial, words: bytes) -> None:
        port.write(words)
        port.read_until(b"\r\n")

    peer, count = Peer(CORVUS), 30
    with TcpPort(peer.answer, baud=57600) as wire:
        with venus_1(wire) as stage:
            stage.state()
            began = time.perf_counter()
            for _ in range(count):
                stage.state()
            took = (time.perf_counter() - began) / count
        with serial.serial_for_url(wire.url, timeout=1) as port:
            began = time.perf_counter()
            for _ in range(count):
                raw(port, b"st ")
                raw(port, b"p ")
            bare = (time.perf_counter() - began) / count
    print(f"{1e3 * took:.2f} ms, and {1e3 * bare:.2f} ms by bare bytes")
    assert took < 1.5 * bare + 0.005
