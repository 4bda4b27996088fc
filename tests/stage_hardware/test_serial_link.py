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


def test_a_port_that_is_no_file_answers_as_well() -> None:
    """As on Windows; this one sends back what is written to it."""
    link = SerialLink("stage", "loop://", baud=115200, ends=b"\n", reply_ends=b"\n", timeout_s=0.1)
    link.open()
    try:
        assert [link.ask(word) for word in ("one", "two")] == ["one", "two"]
        with pytest.raises(ReplyTimeoutError):
            link.read_line()
    finally:
        link.close()


def test_what_does_not_fit_into_the_line_at_once_goes_out_all_the_same(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0], timeout_s=5.0) as link:
        long = "x" * 100_000
        link.send(f"-{long}")
        assert link.ask("after") == "after"
        assert wire[1].heard == f"-{long}\r\nafter\r\n".encode()


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_a_port_is_not_shared_with_another_program() -> None:
    with PseudoTerminal(Echo().answer) as wire:
        with linked(wire), pytest.raises(LinkError, match="not in use"), linked(wire):
            pass
        with linked(wire) as again:
            assert again.ask("mine") == "mine"


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


def test_several_questions_at_once_get_their_answers_in_turn(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0]) as link:
        asked = b"one\r\nmore \r\nand more \r\ntwo\r\nthree\r\n"
        answers = link.ask_all(asked, 3, goes_on=lambda line: line.endswith(" "))
        assert answers == [["one"], ["more ", "and more ", "two"], ["three"]]
        assert link.ask("last") == "last"


def test_a_stop_between_two_answers_is_told_as_such(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0], timeout_s=5.0) as link:
        later = threading.Timer(0.1, link.urgent, [b"L:E\r\n"])
        later.start()
        with pytest.raises(InterruptedByStopError):
            link.ask_all(b"one\r\n-never\r\n", 2)
        later.join()
        link.timeout_s = 0.2
        assert link.ask("after") == "after"


def test_an_answer_after_ctrl_c_is_none_to_the_next_question(
    wire: tuple[Wire, Echo], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> str:
        raise KeyboardInterrupt

    with linked(wire[0]) as link:
        monkeypatch.setattr(link, "_line", interrupt)
        with pytest.raises(KeyboardInterrupt):
            link.ask_all(b"one\r\ntwo\r\n", 2)
        monkeypatch.undo()
        assert link.ask("after") == "after"


def test_after_an_answer_that_was_lost_the_next_question_gets_its_own(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0]) as link:
        with pytest.raises(ReplyTimeoutError):
            link.ask_all(b"-lost\r\ntwo\r\n", 2)
        assert link.ask_all(b"three\r\nfour\r\n", 2) == [["three"], ["four"]]


def test_who_waits_for_an_answer_leaves_when_another_thread_closes(wire: tuple[Wire, Echo]) -> None:
    link = SerialLink("stage", wire[0].url, baud=38400, ends=b"\r\n", reply_ends=b"\r\n", timeout_s=5.0)
    link.open()
    later = threading.Timer(0.1, link.close)
    later.start()
    began = time.monotonic()
    with pytest.raises(LinkError):
        link.ask("-never")
    later.join()
    assert time.monotonic() - began < 1.0


def test_a_command_that_was_decided_on_before_a_stop_does_not_go_out_after_it(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0]) as link:
        stops = link.stops
        assert link.ask("before", stops=stops) == "before"
        link.urgent(b"-STOP\r\n")
        with pytest.raises(InterruptedByStopError):
            link.ask("after", stops=stops)
        with pytest.raises(InterruptedByStopError):
            link.send("after", stops=stops)
        assert link.ask("anew", stops=link.stops) == "anew"
        assert b"after" not in wire[1].heard


def test_a_stop_without_a_reply_costs_the_next_command_nothing(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0], 1.0) as link:
        link.ask("warm")
        link.urgent(b"-STOP\r\n", is_answered=False)
        began = time.monotonic()
        assert link.ask("next") == "next"
        assert time.monotonic() - began < 0.5


def test_what_follows_a_reply_that_made_no_sense_is_thrown_away(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0], 0.3) as link:
        assert link.ask("first\r\nof two") == "first"
        link.distrust()
        assert link.ask("next") == "next"


def test_what_nobody_asked_for_can_be_looked_at_before_it_is_thrown_away() -> None:
    heard: list[str] = []
    with TcpPort(lambda _: [b"E01\r", b"7\r"]) as wire:
        link = SerialLink("s", wire.url, baud=9600, ends=b"\r", reply_ends=b"\r", unasked=heard.append)
        link.open()
        link.send("GO 0")
        time.sleep(0.1)
        assert link.ask("ask") == "E01"
        time.sleep(0.05)
        assert link.ask("again") == "E01"
        link.close()
    assert heard == ["E01\r7\r", "7\r"]


def test_asking_costs_little_more_than_the_wire(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0]) as link:
        link.ask("warm")
        began = time.monotonic()
        for _ in range(50):
            link.ask("position")
        assert (time.monotonic() - began) / 50 < 0.004  # a wait before each command would be 5 ms


def test_commands_without_replies_do_not_hold_up_the_next(wire: tuple[Wire, Echo]) -> None:
    with linked(wire[0]) as link:
        link.ask("warm")
        began = time.monotonic()
        for _ in range(10):
            link.send("-quiet")
            link.send("-quiet")
            link.ask("next")
        assert (time.monotonic() - began) / 10 < 0.02  # TCP that waits for acknowledgements would take 40 ms


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


def test_after_a_stop_whose_answer_is_known_nothing_waits_for_more(wire: tuple[Wire, Echo]) -> None:
    wire[0].faults.late_reply, wire[0].faults.late_s = 1, 0.2
    with linked(wire[0], timeout_s=5) as link:
        link.urgent(b"STOP\r\n", lines=1)
        began = time.monotonic()
        assert link.ask("after") == "after"
        assert 0.15 < time.monotonic() - began < 2


def test_what_a_stop_gave_up_is_waited_for_as_well(wire: tuple[Wire, Echo]) -> None:
    wire[0].faults.late_reply, wire[0].faults.late_s = 1, 0.4

    def ask(link: SerialLink) -> None:
        with pytest.raises(InterruptedByStopError):
            link.ask("slow")

    with linked(wire[0], timeout_s=5) as link:
        thread = threading.Thread(target=ask, args=(link,))
        thread.start()
        time.sleep(0.1)
        link.urgent(b"STOP\r\n", lines=1)
        thread.join(2)
        began = time.monotonic()
        assert link.ask("after") == "after"
        assert time.monotonic() - began < 2


def test_an_answer_that_is_still_to_come_is_none_for_who_connects_next(wire: tuple[Wire, Echo]) -> None:
    wire[0].faults.late_reply, wire[0].faults.late_s = 1, 0.1
    with linked(wire[0]) as link:
        link.urgent(b"STOP\r\n", lines=1)
    with linked(wire[0]) as link:
        assert link.ask("other") == "other"
