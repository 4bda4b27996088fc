"""Transactions on a line that fails in every way that a line can."""

import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import pytest
from stage_hardware.emulators.wire import PseudoTerminal, TcpPort, Wire
from stage_hardware.errors import InterruptedByStopError, LinkError, ReplyTimeoutError
from stage_hardware.links.serial_link import SerialLink

WIRES = [TcpPort] if sys.platform == "win32" else [TcpPort, PseudoTerminal]


class Echo:
    """Answers each line with itself, but for those that begin with a minus; remembers all bytes."""

    def __init__(self) -> None:
        self.heard, self._rest = b"", b""

    def answer(self, data: bytes) -> Iterable[bytes]:
        self.heard += data
        *lines, self._rest = (self._rest + data).split(b"\r\n")
        return [line + b"\r\n" for line in lines if not line.startswith(b"-")]


@pytest.fixture(params=WIRES)
def wire(request: pytest.FixtureRequest) -> Iterator[tuple[Wire, Echo]]:
    echo = Echo()
    with request.param(echo.answer) as opened:
        yield opened, echo


@contextmanager
def linked(wire: Wire, timeout_s: float = 0.2) -> Iterator[SerialLink]:
    link = SerialLink("stage", wire.url, baud=38400, ends=b"\r\n", reply_ends=b"\r\n", timeout_s=timeout_s)
    link.open()
    try:
        yield link
    finally:
        link.close()
        link.close()


def test_a_question_gets_its_answer(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0]) as link:
        assert [link.ask(f"Q:{number}") for number in range(20)] == [f"Q:{number}" for number in range(20)]
        link.send("-quiet")
        assert link.ask("after") == "after"


def test_an_answer_in_pieces_is_one_answer(wire: tuple[Wire, Echo]) -> None:
    wire[0].faults.split_reply = 1
    with linked(wire[0]) as link:
        assert link.ask("position") == "position"


def test_a_late_answer_is_not_taken_for_the_next(wire: tuple[Wire, Echo]) -> None:
    wire[0].faults.late_reply, wire[0].faults.late_s = 1, 0.3
    with linked(wire[0]) as link:
        with pytest.raises(ReplyTimeoutError, match=r"stage: no reply to 'first' within 0\.2 s; see that"):
            link.ask("first")
        assert link.ask("second") == "second"


def test_a_pulled_cable_is_told_apart_from_silence(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0]) as link:
        link.ask("there")
        wire[0].faults.hang_up = True
        with pytest.raises(LinkError, match="is gone"):
            for _ in range(20):
                link.ask("gone", timeout_s=0.2)


def test_a_stop_goes_out_while_another_thread_waits_for_an_answer(wire: tuple[Wire, Echo]) -> None:
    wire[0].faults.no_reply = 1
    raised: list[BaseException] = []

    def wait(link: SerialLink) -> None:
        try:
            link.ask("slow", timeout_s=5)
        except InterruptedByStopError as error:
            raised.append(error)

    with linked(wire[0]) as link:
        thread = threading.Thread(target=wait, args=(link,))
        thread.start()
        time.sleep(0.1)
        began = time.monotonic()
        link.urgent(b"-STOP\r\n")
        took = time.monotonic() - began
        thread.join(2)
        assert not thread.is_alive() and raised
        assert took < 0.1
        assert link.ask("after") == "after"
        assert b"-STOP" in wire[1].heard


def test_a_line_that_is_not_there_says_so() -> None:
    with pytest.raises(LinkError, match=r"stage: /dev/nowhere cannot be opened .*; see that it is connected"):
        SerialLink("stage", "/dev/nowhere", baud=9600, ends=b"\r", reply_ends=b"\r").open()
    with pytest.raises(LinkError, match="not connected; connect first"):
        SerialLink("stage", "/dev/nowhere", baud=9600, ends=b"\r", reply_ends=b"\r").ask("Q:")


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_the_emulator_sees_the_settings_of_the_line() -> None:
    with PseudoTerminal(Echo().answer) as wire:
        link = SerialLink("s", wire.url, baud=38400, ends=b"\r", reply_ends=b"\r", hardware_flow_control=True)
        link.open()
        assert wire.settings == (38400, True)
        link.close()


def test_bytes_take_their_time() -> None:
    with TcpPort(Echo().answer, baud=9600) as wire, linked(wire, 2.0) as link:
        link.ask("warm")
        began = time.monotonic()
        link.ask("x" * 22)
        assert 0.05 <= time.monotonic() - began < 0.2  # 24 bytes each way


def test_a_stop_keeps_what_a_motion_has_still_to_send_from_going_out(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0]) as link:
        since = link.stops
        assert link.ask("first", since=since) == "first"
        link.urgent(b"STOP\r\n", replies=1)
        for send in (link.ask, link.send):
            with pytest.raises(InterruptedByStopError, match="a stop came first"):
                send("second", since=since)
        assert link.ask("third", since=link.stops) == "third"
        assert b"second" not in wire[1].heard


def test_after_a_stop_whose_answer_is_known_nothing_waits_for_more(wire: tuple[Wire, Echo]) -> None:
    wire[0].faults.late_reply, wire[0].faults.late_s = 1, 0.2
    with linked(wire[0], timeout_s=5) as link:
        link.urgent(b"STOP\r\n", replies=1)
        began = time.monotonic()
        assert link.ask("after") == "after"
        assert 0.15 < time.monotonic() - began < 2


def test_an_answer_that_is_still_to_come_is_none_for_who_connects_next(wire: tuple[Wire, Echo]) -> None:
    wire[0].faults.late_reply, wire[0].faults.late_s = 1, 0.1
    with linked(wire[0]) as link:
        link.urgent(b"STOP\r\n", replies=1)
    with linked(wire[0]) as link:
        assert link.ask("other") == "other"


def test_a_question_costs_no_wait_when_nothing_is_to_come(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0]) as link:
        link.ask("warm")
        took = []
        for _ in range(20):
            began = time.monotonic()
            link.ask("?")
            took.append(time.monotonic() - began)
        assert min(took) < 0.004
