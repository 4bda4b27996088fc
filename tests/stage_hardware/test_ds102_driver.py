"""The driver of the DS102 against byte exchanges that follow from the tables of its manual."""

import statistics
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction

import pytest
import serial
from stage_hardware.drivers.ds102 import DS102Axis, DS102Stage
from stage_hardware.emulators.wire import PseudoTerminal, TcpPort, Wire
from stage_hardware.errors import (
    HardwareError,
    InterruptedByStopError,
    LinkError,
    RefusedError,
    ReplyError,
    ReplyTimeoutError,
)
from stage_hardware.stage import Axis

WIRES: list[type[Wire]] = [TcpPort] if sys.platform == "win32" else [PseudoTerminal, TcpPort]
WIRE = WIRES[0]
TRAVEL = Axis("um", -15000, 15000, 2, 2000, 10000)
X = DS102Axis(TRAVEL, 1, Fraction(1, 2), origin_type=4)
Y = DS102Axis(TRAVEL, 2, Fraction(1, 2), origin_type=4, drive_division=3)


def settings_of(number: int) -> dict[str, list[str]]:
    values = {
        "UNIT": 0, "SELSP": 0, "L0": 100, "R0": 200, "S0": 0, "F0": 1000, "MEMSW0": 4, "CWSLP": 7500, "CCWSLP": -7500,
        "DRDIV": 3, "SB1": 0, "SB2": 0x30, "SB3": 1, "POS": 0,
    }  # fmt: skip
    return {f"AXI{number}:{word}?": [str(value)] for word, value in values.items()}


class Peer:
    """Answers queries from lists, whose last element stays, and hears the rest; what it ``says`` is unasked.

    Soft limits are in the status as they were last switched.
    """

    def __init__(self) -> None:
        self.heard: list[str] = []
        self.replies = {"*IDN?": ["SURUGA,DS102,0,VER4.00"], "CONTA?": ["2"]} | settings_of(1) | settings_of(2)
        self.says: dict[str, str] = {}
        self._rest = b""

    def answer(self, data: bytes) -> Iterable[bytes]:
        *lines, self._rest = (self._rest + data).split(b"\r")
        for line in lines:
            text = line.decode()
            self.heard.append(text)
            axis, _, command = text.partition(":")
            if command.startswith("CWSLE"):
                self.replies[f"{axis}:SB2?"] = [str(0x30 if command == "CWSLE 1:CCWSLE 1" else 0)]
            if text in self.says:
                yield self.says[text].encode() + b"\r"
            if text in self.replies:
                replies = self.replies[text]
                yield (replies.pop(0) if len(replies) > 1 else replies[0]).encode() + b"\r"

    def orders(self, since: int) -> list[str]:
        return [line for line in self.heard[since:] if not line.endswith("?")]


@contextmanager
def connected(
    *, timeout_s: float = 0.25, wire_type: type[Wire] = WIRE, **axes: DS102Axis
) -> Iterator[tuple[DS102Stage, Peer, Wire]]:
    peer = Peer()
    with (
        wire_type(peer.answer) as wire,
        DS102Stage("rig", wire.url, axes or {"x": X}, timeout_s=timeout_s, begins_within_s=0.1) as stage,
    ):
        yield stage, peer, wire


def homed(stage: DS102Stage, peer: Peer) -> None:
    for name in stage.axes:
        peer.replies[f"AXI{'xy'.index(name) + 1}:SB1?"] = ["64", "16"]
    stage.home(list(stage.axes))
    assert all(axis.referenced for axis in stage.state().axes.values())
    peer.heard.clear()


def test_connecting_moves_nothing_and_reads_back_all_that_it_writes() -> None:
    with connected(x=X, y=Y) as (_, peer, _):
        assert peer.heard[:5] == ["*IDN?", "STOP 0", "CONTA?", "AXI1:SB3?", "AXI1:SB1?"]
        orders = peer.orders(5)
        assert orders[:4] == [
            "AXI1:UNIT 0:SELSP 0:L0 100:R0 200",
            "AXI1:S0 0:F0 1000:MEMSW0 4:CWSLP 7500",
            "AXI1:CCWSLP -7500:MEMSW7 0",
            "AXI1:CWSLE 1:CCWSLE 1",
        ]
        assert orders[4] == "AXI2:UNIT 0:SELSP 0:DRDIV 3:L0 100"
        assert not any("GO" in line for line in peer.heard)
        words = ["UNIT", "SELSP", "L0", "R0", "S0", "F0", "MEMSW0", "CWSLP", "CCWSLP"]
        assert {f"AXI1:{word}?" for word in words} <= set(peer.heard)


@pytest.mark.parametrize(
    ("query", "reply", "fault"),
    [
        ("*IDN?", "SURUGA,DA1000,0,VER1.00", "it says that it is"),
        ("CONTA?", "0", "x is axis 1, which is not there"),
        ("AXI1:SB3?", "0", "x is axis 1, which is not there"),
        ("AXI1:F0?", "9999", "F0 of axis 1 is 9999 after it was set to 1000; see what"),
        ("AXI1:CWSLP?", "99999999", "CWSLP of axis 1 is 99999999"),
        ("AXI1:SB1?", "64", "x does not stop"),
        ("AXI1:UNIT?", "um", "'um' does not answer AXI1:UNIT?"),
        ("AXI1:SB1?", "640", "'640' does not answer AXI1:SB1?"),
        ("AXI1:MEMSW0?", "E20", "a command breaks the rules"),
    ],
)
def test_a_controller_that_is_not_as_meant_is_not_connected(query: str, reply: str, fault: str) -> None:
    peer = Peer()
    peer.replies[query] = [reply]
    with WIRE(peer.answer) as wire:
        stage = DS102Stage("rig", wire.url, {"x": X}, timeout_s=0.1, begins_within_s=0.1)
        with pytest.raises(HardwareError) as raised:
            stage.connect()
        assert fault in str(raised.value)
        with pytest.raises(LinkError, match="connect first"):
            stage.state()


def test_soft_limits_that_stay_off_are_noticed() -> None:
    peer = Peer()
    with WIRE(lambda data: (b"0\r" if data.endswith(b"SB2?\r") else reply for reply in peer.answer(data))) as wire:
        stage = DS102Stage("rig", wire.url, {"x": X}, timeout_s=0.2)
        with pytest.raises(HardwareError, match="the soft limits of x do not go on"):
            stage.connect()


def test_a_device_of_another_kind_says_what_it_is() -> None:
    with (
        WIRE(lambda _: [b"Corvus 1 462\r"]) as wire,
        pytest.raises(ReplyError, match="'Corvus 1 462' is not what a DS102 says that it is; see which port"),
    ):
        DS102Stage("rig", wire.url, {"x": X}, timeout_s=0.1).connect()


@pytest.mark.parametrize("wire_type", WIRES)
def test_homing_is_without_soft_limits_and_ends_at_zero_with_them(wire_type: type[Wire]) -> None:
    with connected(wire_type=wire_type) as (stage, peer, _):
        assert not stage.state().axes["x"].referenced
        peer.heard.clear()
        peer.replies["AXI1:SB1?"] = ["64", "64", "16"]
        stage.home(["x"])
        assert peer.orders(0)[-2:] == ["AXI1:CWSLE 0:CCWSLE 0", "AXI1:GO ORG"]
        state = stage.state().axes["x"]
        assert state.moving and not state.referenced
        peer.heard.clear()
        state = stage.state().axes["x"]
        assert not state.moving and state.referenced
        assert peer.orders(0) == ["AXI1:POS 0", "AXI1:CWSLE 1:CCWSLE 1"]


@pytest.mark.parametrize("status", ["0", "8", "24"])
def test_homing_that_finds_no_origin_is_a_fault_and_no_reference(status: str) -> None:
    with connected() as (stage, peer, _):
        peer.replies["AXI1:SB1?"] = ["64", status]
        stage.home(["x"])
        state = stage.state()
        assert state.fault == "x has not found its origin" and not state.axes["x"].referenced
        with pytest.raises(HardwareError, match="x is not referenced; home it first"):
            stage.move_to({"x": 0})


def test_homing_that_a_stop_has_ended_is_none() -> None:
    with connected() as (stage, peer, _):
        peer.replies["AXI1:SB1?"] = ["64", "16"]
        stage.home(["x"])
        stage.stop()
        state = stage.state()
        assert not state.axes["x"].referenced and state.fault is None
        assert "AXI1:POS 0" not in peer.heard


def test_a_search_that_does_not_begin_is_refused_even_if_an_earlier_one_was_successful() -> None:
    with connected() as (stage, peer, _):
        homed(stage, peer)
        peer.replies["AXI1:POS?"] = ["250"]
        with pytest.raises(RefusedError, match="x does not move"):
            stage.home(["x"])
        assert not stage.state().axes["x"].referenced


@pytest.mark.parametrize(("target_um", "pulses"), [(1000, 500), (-3.1, -2), (2.9, 1), (15000, 7500), (0, 0)])
def test_moves_are_absolute_and_go_to_the_nearest_pulse(target_um: float, pulses: int) -> None:
    with connected() as (stage, peer, _):
        homed(stage, peer)
        peer.replies |= {"AXI1:SB1?": ["64", "65", "0"], "AXI1:POS?": ["1", str(pulses)]}
        stage.move_to({"x": target_um})
        assert peer.orders(0) == [f"AXI1:GOABS {pulses}"]
        assert stage.state().axes["x"].moving
        state = stage.state()
        assert not state.axes["x"].moving and state.axes["x"].position == 2 * pulses and state.fault is None


def test_a_move_that_has_ended_before_anybody_asked_is_one() -> None:
    with connected() as (stage, peer, _):
        homed(stage, peer)
        peer.replies |= {"AXI1:SB1?": ["0"], "AXI1:POS?": ["500"]}
        stage.move_to({"x": 1000})
        assert stage.state().fault is None


@pytest.mark.parametrize("target", [15000.1, -15001, float("nan"), float("inf")])
def test_a_target_beyond_the_limits_is_not_sent(target: float) -> None:
    with connected() as (stage, peer, _):
        homed(stage, peer)
        with pytest.raises(HardwareError, match=r"x cannot go to .*, its limits are -15000\.\.15000; stay within"):
            stage.move_to({"x": target})
        with pytest.raises(HardwareError, match="it has no axis z; there are: x"):
            stage.move_to({"z": 0})
        assert peer.heard == []


def test_a_move_that_does_not_begin_is_refused_and_all_axes_are_stopped() -> None:
    with connected(x=X, y=Y) as (stage, peer, _):
        homed(stage, peer)
        peer.replies |= {"AXI1:SB1?": ["64"], "AXI2:SB1?": ["0"]}
        with pytest.raises(RefusedError, match="y does not move; see to"):
            stage.move_to({"x": 100, "y": 100})
        stage.state()
        assert peer.orders(0) == ["AXI1:GOABS 50", "AXI2:GOABS 50", "STOP 0"]


def test_a_moving_axis_takes_no_other_target() -> None:
    with connected() as (stage, peer, _):
        homed(stage, peer)
        peer.replies["AXI1:SB1?"] = ["64"]
        stage.move_to({"x": 100})
        with pytest.raises(RefusedError, match="x is in motion; wait until it stands, or stop it"):
            stage.move_to({"x": 200})
        assert peer.orders(0) == ["AXI1:GOABS 50"]


def test_an_error_code_is_seen_whenever_it_is_sent() -> None:
    with connected() as (stage, peer, _):
        homed(stage, peer)
        # at once after the command, so that the next query has two replies
        peer.says["AXI1:GOABS 50"] = "E02"
        peer.replies["AXI1:SB1?"] = ["0"]
        with pytest.raises(RefusedError, match=r"a motion of x: the axis is at a limit \(E02\); find out why"):
            stage.move_to({"x": 100})
        # in place of the reply to a query
        peer.replies["AXI1:SB1?"] = ["E03", "0"]
        with pytest.raises(RefusedError, match=r"there is an emergency stop \(E03\)"):
            stage.state()
        assert stage.state().fault is not None
    with connected() as (stage, peer, _):
        homed(stage, peer)
        # long after a command that was accepted
        peer.says["AXI1:SB1?"] = "E00"
        state = stage.state()
        assert state.axes["x"].position == 0 and state.fault is not None and "E00" in state.fault


def test_an_error_code_of_which_half_has_come_is_none_of_the_reply() -> None:
    with connected() as (stage, peer, wire):
        homed(stage, peer)
        pieces = {b"AXI1:GOABS 50\r": [b"E0"], b"AXI1:SB1?\r": [b"1\r", b"0\r"]}

        def answer(data: bytes) -> Iterable[bytes]:
            return pieces.get(data) or peer.answer(data)

        wire.answer = answer
        send = stage._link.send

        def send_and_wait(command: str, *, stops: int | None = None) -> None:
            send(command, stops=stops)
            time.sleep(0.1)

        stage._link.send = send_and_wait  # type: ignore[method-assign]
        with pytest.raises(RefusedError, match="E01"):
            stage.move_to({"x": 100})


def test_switches_soft_limits_and_stages_that_are_not_there_are_told() -> None:
    with connected() as (stage, peer, _):
        homed(stage, peer)
        for limits, lower, upper in ((0x30, False, False), (0x31, False, True), (0x38, True, False)):
            peer.replies["AXI1:SB2?"] = [str(limits)]
            axis = stage.state().axes["x"]
            assert (axis.at_lower_limit, axis.at_upper_limit) == (lower, upper)
        peer.replies["AXI1:SB2?"] = ["51"]
        assert stage.state().fault == "no stage is connected as x"


def test_a_drive_that_ends_elsewhere_is_a_fault_until_the_next_order() -> None:
    with connected() as (stage, peer, _):
        homed(stage, peer)
        peer.replies |= {"AXI1:SB1?": ["64", "10"], "AXI1:SB2?": [str(0x30), str(0x31)], "AXI1:POS?": ["40"]}
        stage.move_to({"x": 1000})
        for _ in range(2):
            state = stage.state()
            assert state.fault == "x stands at 80 and not at 1000 um: it is at its upper limit"
            assert state.axes["x"].at_upper_limit
        peer.replies |= {"AXI1:SB1?": ["64", "0"], "AXI1:POS?": ["0"]}
        stage.move_to({"x": 0})
        assert stage.state().fault is None


def test_where_a_stop_ends_a_move_is_no_fault() -> None:
    with connected() as (stage, peer, _):
        homed(stage, peer)
        peer.replies |= {"AXI1:SB1?": ["64", "8"], "AXI1:POS?": ["40"]}
        stage.move_to({"x": 1000})
        stage.stop()
        state = stage.state()
        assert state.fault is None and state.axes["x"].referenced
        assert "STOP 0" in peer.heard


def test_a_power_cycle_is_noticed_before_anything_moves() -> None:
    for look in (True, False):
        with connected(x=X, y=Y) as (stage, peer, _):
            homed(stage, peer)
            peer.replies |= {"AXI2:SB2?": ["0"], "AXI2:SB1?": ["0"]}
            if look:
                state = stage.state()
                assert state.fault == "settings are gone, as after a power cycle; home the axes"
                assert not any(axis.referenced for axis in state.axes.values())
            with pytest.raises(HardwareError, match="y is not referenced"):
                stage.move_to({"y": 100})
            with pytest.raises(HardwareError, match="x is not referenced"):
                stage.move_to({"x": 100})
            assert peer.orders(0) == []
            homed(stage, peer)
            assert stage.state().fault is None


def test_a_lost_reply_to_a_motion_is_followed_by_a_look_and_not_by_the_motion() -> None:
    with connected() as (stage, peer, _):
        homed(stage, peer)
        status = peer.replies.pop("AXI1:SB1?")
        with pytest.raises(ReplyTimeoutError):
            stage.move_to({"x": 100})
        peer.replies["AXI1:SB1?"] = ["64"]
        with pytest.raises(RefusedError, match="x is in motion"):
            stage.move_to({"x": 100})
        assert stage.state().axes["x"].moving
        assert peer.orders(0) == ["AXI1:GOABS 50"]
        peer.replies |= {"AXI1:SB1?": status, "AXI1:POS?": ["50"]}
        stage.move_to({"x": 100})  # it is absolute, so that a second one does no harm
        assert stage.state().fault is None


@pytest.mark.parametrize("wire_type", WIRES)
@pytest.mark.parametrize("fault", ["no_reply", "late_reply", "garbled_reply", "wrong_terminator"])
def test_after_a_fault_of_the_line_no_number_is_taken_for_another(fault: str, wire_type: type[Wire]) -> None:
    with connected(wire_type=wire_type) as (stage, peer, wire):
        homed(stage, peer)
        peer.replies |= {"AXI1:POS?": ["77"], "AXI1:SB1?": ["0"]}
        wire.faults.late_s = 0.4
        setattr(wire.faults, fault, 1)
        with pytest.raises((ReplyTimeoutError, ReplyError)):
            stage.state()
        state = stage.state()
        assert state.axes["x"].position == 154 and not state.axes["x"].moving and not state.axes["x"].at_lower_limit


def test_a_reply_in_pieces_is_one() -> None:
    with connected() as (stage, _, wire):
        wire.faults.split_reply = 3
        assert stage.state().axes["x"].position == 0


@pytest.mark.parametrize("wire_type", WIRES)
def test_a_pulled_cable_says_so(wire_type: type[Wire]) -> None:
    with wire_type(Peer().answer) as wire:
        stage = DS102Stage("rig", wire.url, {"x": X}, timeout_s=0.2)
        stage.connect()
        wire.faults.hang_up = True
        with pytest.raises(LinkError, match=r"rig: .* is gone"):
            for _ in range(50):
                stage.state()
        stage.close()
        stage.close()


def test_a_stop_passes_a_query_that_waits_and_a_move_that_was_decided_on() -> None:
    with connected(timeout_s=2.0, x=X, y=Y) as (stage, peer, _):
        homed(stage, peer)
        waits = threading.Event()
        raised: list[HardwareError] = []
        silenced = peer.replies.pop("AXI2:SB2?")

        def move() -> None:
            waits.set()
            try:
                stage.move_to({"x": 100, "y": 100})
            except HardwareError as error:
                raised.append(error)

        thread = threading.Thread(target=move)
        thread.start()
        waits.wait()
        while "AXI2:SB2?" not in peer.heard:
            time.sleep(0.005)
        began = time.monotonic()
        stage.stop()
        took = time.monotonic() - began
        thread.join(5)
        assert took < 0.2 and isinstance(raised[0], InterruptedByStopError)
        peer.replies["AXI2:SB2?"] = silenced
        began = time.monotonic()
        stage.state()
        assert time.monotonic() - began < 1.0  # whether it has stopped is known before any reply is late
        assert peer.orders(0) == ["STOP 0"]


def test_what_the_controller_cannot_be_set_to_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"the origin type of an axis of a DS102 is within 1\.\.12, got 0"):
        DS102Axis(TRAVEL, 1, Fraction(1, 2), origin_type=0)
    with pytest.raises(ValueError, match="speed in pulses per second"):
        DS102Axis(Axis("um", 0, 1, 2, 1, 1), 1, Fraction(1, 2), origin_type=3)
    with pytest.raises(ValueError, match="time to the speed in ms"):
        DS102Axis(Axis("um", 0, 1, 2, 2000, 1), 1, Fraction(1, 2), origin_type=3)
    with pytest.raises(ValueError, match="the resolution of the axis is 1 um, a pulse is 2"):
        DS102Axis(Axis("um", 0, 1, 1, 2000, 10000), 1, Fraction(1, 2), origin_type=3)
    mdeg = DS102Axis(Axis("mdeg", 0, 360000, 2.5, 10000, 20000), 1, Fraction("0.4"), origin_type=3)
    assert mdeg.pulses(1000) == 400 and mdeg.position(400) == 1000


def test_the_driver_costs_little_beside_the_wire() -> None:
    peer = Peer()
    queries = [b"AXI1:SB1?\r", b"AXI1:SB2?\r", b"AXI1:POS?\r"]
    with WIRE(peer.answer) as wire:
        with DS102Stage("rig", wire.url, {"x": X}, timeout_s=1.0) as stage:
            wire.baud = 38400
            stage.state()
            driven = []
            for _ in range(15):
                began = time.perf_counter()
                stage.state()
                driven.append(time.perf_counter() - began)
            wire.baud = 0
        time.sleep(0.1)  # the wire takes one client after the other
        wire.baud = 38400
        port = serial.serial_for_url(wire.url, timeout=1.0)
        bare = []
        for _ in range(16):
            began = time.perf_counter()
            for query in queries:
                port.write(query)
                port.read_until(b"\r")
            bare.append(time.perf_counter() - began)
        port.close()
    assert statistics.median(driven) < 1.5 * statistics.median(bare)  # 5 % on a machine with nothing else to do
