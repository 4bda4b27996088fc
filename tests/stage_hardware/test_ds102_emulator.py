"""The emulated DS102, byte by byte as the tables of its commands have it."""

import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import pytest
from stage_hardware.emulators.ds102 import DS102Emulator, ErrorReports
from stage_hardware.emulators.wire import PseudoTerminal, TcpPort

FAST = b"AXI1:L0 1000:F0 20000:R0 50\r"
SILENCE_S = 0.08


class Client:
    """A bare connection."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection, self.rest = connection, b""

    def tell(self, data: bytes) -> None:
        self.connection.sendall(data)

    def line(self, within_s: float = 3.0) -> bytes:
        """Return what comes up to the next CR, and with it; or what has come in the time."""
        self.connection.settimeout(within_s)
        try:
            while b"\r" not in self.rest:
                if not (came := self.connection.recv(4096)):
                    break
                self.rest += came
        except TimeoutError:
            pass
        line, end, self.rest = self.rest.partition(b"\r")
        return line + end

    def ask(self, data: bytes) -> bytes:
        self.tell(data)
        return self.line()

    def is_silent(self) -> bool:
        return self.line(SILENCE_S) == b""

    def number(self, data: bytes) -> float:
        return float(self.ask(data))

    def until(self, holds: Callable[[], bool], within_s: float = 8.0) -> None:
        deadline = time.monotonic() + within_s
        while not holds():
            assert time.monotonic() < deadline
            time.sleep(0.005)

    def rests(self, axis: int = 1) -> int:
        """Wait until an axis moves no more; return the status byte."""
        byte = 0x40

        def is_at_rest() -> bool:
            nonlocal byte
            byte = int(self.ask(b"AXI%d:SB1?\r" % axis))
            return not byte & 0x40

        self.until(is_at_rest)
        return byte


@contextmanager
def running(
    positions: Sequence[float] = (200, 200),
    *,
    errors_come: ErrorReports = ErrorReports.AT_ONCE,
    travel: tuple[float, float] = (-20_000, 20_000),
    connectors: int = 2,
    has_micro_steps: bool = True,
    origin_type: int = 4,
    processing_s: float = 0.0,
    reset_s: float = 0.2,
    baud: int = 0,
) -> Iterator[tuple[DS102Emulator, Client]]:
    emulator = DS102Emulator(
        positions,
        travel=travel,
        connectors=connectors,
        errors_come=errors_come,
        has_micro_steps=has_micro_steps,
        origin_type=origin_type,
        wire=TcpPort,
        processing_s=processing_s,
        reset_s=reset_s,
        baud=baud,
    )
    with emulator:
        host, port = emulator.url.removeprefix("socket://").split(":")
        with socket.create_connection((host, int(port))) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            yield emulator, Client(connection)


def test_it_says_what_it_is_and_what_it_has() -> None:
    with running(connectors=4) as (_, client):
        assert client.ask(b"*IDN?\r") == b"SURUGA,DS102,0,VER4.00\r"
        assert client.ask(b"DS102VER?\r") == b"DS102 4.00\r"
        assert client.ask(b"CONTA?\r") == b"4\r"
        assert client.ask(b"AXI1:SB3?\r") == b"3\r"
        assert client.ask(b"AXI4:SB2?\r") == b"3\r"  # both limits: nothing connected
        assert client.ask(b"AXI4:POS?\r") == b"E00\r"
        assert client.ask(b"AXI6:SB3?\r") == b"0\r"
        assert client.ask(b"AXI1:SB1?\r") == b"32\r"  # at home, which is 0
        assert client.ask(b"READY?\r") == b"1\r"


def test_commands_that_are_accepted_are_not_answered() -> None:
    with running() as (_, client):
        client.tell(b"AXI1:L0 100:R0 100:S0 0:F0 1000:PULS 10:GO CW\r")
        client.tell(b"STOP 0\rWRITE\r")
        assert client.is_silent()
        assert client.ask(b"F0?\r") == b"1000\r"


def test_keywords_may_be_cut_and_case_does_not_matter() -> None:
    with running() as (_, client):
        client.tell(b"AXIs1:PULSe 25:Go cw\r")
        client.rests()
        assert client.ask(b"axi1:pos?\r") == b"25\r"
        client.tell(b"Axix:PULS 5:GO 1\r")
        client.rests()
        assert client.ask(b"AXIS1:POS?\r") == b"20\r"


def test_the_axis_that_was_selected_stays_selected() -> None:
    with running() as (_, client):
        client.tell(b"AXIY:POS 7\r")
        assert client.ask(b"POS?\r") == b"7\r"
        assert client.ask(b"AXI1:POS?\r") == b"0\r"
        assert client.ask(b"POS?\r") == b"0\r"
        client.tell(b"AXIALL:POS 3\r")
        assert [client.ask(b"AXI%d:POS?\r" % axis) for axis in (1, 2)] == [b"3\r", b"3\r"]


def test_bytes_may_come_in_any_pieces_and_lines_end_with_cr_alone() -> None:
    with running() as (_, client):
        for piece in (b"AX", b"I1:PO", b"S?"):
            client.tell(piece)
            assert client.is_silent()
        assert client.ask(b"\rAXI1:SB2?\r") == b"0\r"
        assert client.line() == b"0\r"
        assert client.ask(b"\nPOS?\r") == b"E20\r"


def test_questions_that_are_joined_are_answered_in_turn() -> None:
    with running() as (_, client):
        assert [client.ask(b"AXI2:POS 4:POS?:SB2?:UNIT?\r"), client.line(), client.line()] == [b"4\r", b"0\r", b"0\r"]


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b"AXI1:NONSENSE 1\r", b"E20\r"),
        (b"AXI1:GO UP\r", b"E20\r"),
        (b"AXI1:F0\r", b"E20\r"),
        (b"AXI1:PULS500\r", b"E21\r"),
        (b"AXI1:F0 1000000\r", b"E22\r"),
        (b"AXI1:R0 0\r", b"E22\r"),
        (b"AXI1:GO 7\r", b"E22\r"),
        (b"AXI9:POS 0\r", b"E22\r"),
        (b"AXI1:MEMSW0 13\r", b"E22\r"),
        (b"AXI3:GO CW\r", b"E00\r"),
        (b"AXI1:" + b"F0 10:" * 20 + b"F1 20\r", b"E20\r"),
    ],
)
def test_every_way_of_telling_an_error(line: bytes, code: bytes) -> None:
    with running() as (_, client):
        assert client.ask(line) == code
        assert client.is_silent()
    with running(errors_come=ErrorReports.NEXT_QUERY) as (_, client):
        client.tell(line)
        assert client.is_silent()
        assert client.ask(b"AXI1:POS?\r") == code
        assert client.ask(b"AXI1:POS?\r") == b"0\r"
    with running(errors_come=ErrorReports.NEVER) as (_, client):
        client.tell(line)
        assert client.is_silent()
        assert client.ask(b"AXI1:POS?\r") == b"0\r"
        assert client.ask(b"AXI1:NONSENSE?\r") == b"E20\r"


def test_what_follows_a_refused_command_is_not_carried_out() -> None:
    with running() as (emulator, client):
        assert client.ask(b"AXI1:PULS 500:F0 0:GO CW\r") == b"E22\r"
        assert client.is_silent() and not emulator.axes[0].moving


def test_an_order_of_refusals_is_followed_and_guesses_are_answered() -> None:
    with running() as (emulator, client):
        emulator.refusals += ["E40", "E41"]
        assert client.ask(b"AXI1:POS 5\r") == b"E40\r"
        assert client.ask(b"WRITE\r") == b"E41\r"
        client.tell(b"AXI1:POS 5\r")
        assert client.ask(b"POS?\r") == b"5\r"
        emulator.guesses = True
        assert client.ask(b"HUMIDITY?\r") == b"0\r"


def test_a_fraction_of_a_pulse_is_ignored_without_a_word() -> None:
    with running() as (_, client):
        client.tell(b"AXI1:PULS 20:PULS 500.0000:GO CW\r")
        client.rests()
        assert client.ask(b"POS?\r") == b"20\r"
        assert client.is_silent()


@pytest.mark.parametrize(
    ("drive", "ends"),
    [
        (b"PULS 30:GO CW", 130),
        (b"PULS 30:GO 1", 70),
        (b"PULSA -40:GO ABS", -40),
        (b"PULSA -40:GO 4", -40),
        (b"GOABS 12", 12),
        (b"HOMEP 60:GO HOME", 60),
        (b"HOMEP 60:GO 3", 60),
        (b"PULS 0:GO CW", 100),
    ],
)
def test_every_drive_ends_where_it_should(drive: bytes, ends: int) -> None:
    with running() as (_, client):
        client.tell(FAST + b"AXI1:POS 100:" + drive + b"\r")
        byte = client.rests()
        assert client.number(b"POS?\r") == ends
        assert bool(byte & 0x01) is (ends >= 100) and not byte & 0x08
        assert bool(byte & 0x20) is (b"HOME" in drive)


@pytest.mark.parametrize(("target", "start", "ramp_ms"), [(-15_000, 1, 100), (3_000, 9999, 300), (40, 500, 10)])
def test_a_drive_takes_its_time(target: int, start: int, ramp_ms: int) -> None:
    fast = 60_000
    with running() as (_, client):
        client.tell(b"AXI1:L0 %d:F0 %d:R0 %d\r" % (start, fast, ramp_ms))
        began = time.monotonic()
        client.tell(b"AXI1:GOABS %d\r" % target)
        client.rests()
        took = time.monotonic() - began
        assert client.number(b"POS?\r") == target
        way, acceleration = abs(target), (fast - start) * 1000 / ramp_ms
        if way >= (fast + start) * ramp_ms / 1000:
            due = 2 * ramp_ms / 1000 + (way - (fast + start) * ramp_ms / 1000) / fast
        else:
            due = 2 * ((start**2 + acceleration * way) ** 0.5 - start) / acceleration
        assert due - 0.001 <= took < due + 0.5


def test_speeds_come_from_the_table_that_is_selected() -> None:
    with running() as (emulator, client):
        client.tell(b"AXI1:F0 1000:L3 200:F3 7000:R3 40:SELSP 3:PULS 10:GO CW\r")
        client.rests()
        assert (emulator.axes[0].start_speed, emulator.axes[0].speed) == (200, 7000)
        assert emulator.axes[0].acceleration == pytest.approx(6800 / 0.04)
        assert client.ask(b"SELSP?\r") == b"3\r"


def test_in_motion_it_says_so_and_is_not_to_be_disturbed() -> None:
    with running() as (_, client):
        client.tell(FAST + b"AXI1:GO CWJ\r")
        assert int(client.ask(b"AXI1:SB1?\r")) & 0x41 == 0x41
        assert client.ask(b"MOTION?\r") == b"1\r"
        assert client.ask(b"MOTIONA?\r") == b"1\r"
        assert client.ask(b"READY?\r") == b"0\r"
        assert client.ask(b"AXI1:PULS 5\r") == b"E01\r"
        assert client.ask(b"AXI1:GO CCW\r") == b"E01\r"
        client.tell(b"AXI2:PULS 5:GO CW\r")  # another axis is free
        assert client.ask(b"MOTIONA?\r") == b"3\r"
        client.tell(b"STOP 0\r")
        assert client.ask(b"MOTIONA?\r") == b"0\r"


def test_a_stop_is_for_all_axes_and_says_what_was_cut_short() -> None:
    with running() as (emulator, client):
        client.tell(FAST + b"AXI2:L0 1000:F0 20000:R0 50:GO CWJ:AXI1:GO CCWJ\r")
        client.until(lambda: emulator.axes[0].position < 150)
        client.tell(b"AXI2:STOP 0\r")
        assert [int(client.ask(b"AXI%d:SB1?\r" % axis)) & 0x48 for axis in (1, 2)] == [0x08, 0x08]
        client.tell(FAST + b"AXI1:PULS 5:GO CW\r")
        assert not client.rests() & 0x08


def test_a_slow_stop_takes_the_way_of_the_ramp() -> None:
    with running() as (emulator, client):
        client.tell(b"AXI1:L0 1:F0 10000:R0 200:GO CWJ\r")
        client.until(lambda: emulator.axes[0].velocity >= 10_000)
        client.tell(b"STOP 1\r")
        client.until(lambda: emulator.axes[0].velocity < 10_000)
        began = emulator.axes[0].position
        client.rests()
        assert 500 < emulator.axes[0].position - began <= 1000 + 1


def test_switches_stop_a_drive_and_let_it_go_back_only() -> None:
    with running(travel=(-500, 500)) as (_, client):
        client.tell(FAST + b"AXI1:PULS 1000:GO CW\r")
        assert client.rests() & 0x0A == 0x0A
        assert client.ask(b"SB2?\r") == b"1\r"
        assert client.number(b"POS?\r") == 300
        assert client.ask(b"GO CW\r") == b"E02\r"
        client.tell(b"PULS 900:GO CCW\r")
        assert not client.rests() & 0x0A
        client.tell(b"GO CCW\r")
        client.rests()
        assert client.ask(b"SB2?\r") == b"2\r"


def test_a_drive_runs_past_a_soft_limit_by_its_ramp() -> None:
    fast, ramp_ms = 10_000, 60
    with running() as (_, client):
        client.tell(b"AXI1:L0 1:F0 %d:R0 %d:CWSLP 2000:CWSLE 1:CCWSLP -10:CCWSLE 1\r" % (fast, ramp_ms))
        assert client.ask(b"SB2?\r") == b"48\r"
        client.tell(b"AXI1:PULS 9000:GO CW\r")
        assert client.rests() & 0x0C == 0x0C
        assert client.number(b"POS?\r") == pytest.approx(2000 + fast * ramp_ms / 2000, abs=2)
        assert client.ask(b"SB2?\r") == b"52\r"
        assert client.ask(b"AXI1:GO CW\r") == b"E02\r"
        client.tell(b"AXI1:GOABS 1990\r")
        assert not client.rests() & 0x0C
        client.tell(b"AXI1:GO CCWJ\r")  # a jog ends there too
        assert client.rests() & 0x0C == 0x0C
        assert client.ask(b"SB2?\r") == b"56\r"


def test_origin_type_0_looks_for_nothing() -> None:
    with running(origin_type=0) as (_, client):
        client.tell(FAST + b"AXI1:GO ORG\r")
        assert client.rests() == 0x20
        assert client.ask(b"MEMSW0?\r") == b"0\r" and client.is_silent()


@pytest.mark.parametrize(("kind", "where"), [(1, 0), (4, 0), (9, 0), (5, -999), (12, 999)])
def test_an_origin_leaves_a_few_pulses(kind: int, where: int) -> None:
    with running(travel=(-1000, 1000)) as (emulator, client):
        client.tell(FAST + b"AXI1:MEMSW0 %d:GO ORG\r" % kind)
        assert client.rests() & 0x18 == 0x10
        assert emulator.axes[0].position == pytest.approx(where)
        assert client.ask(b"ORG?\r") == b"1\r"
        assert 0 < client.number(b"POS?\r") <= 8
        client.tell(b"AXI1:POS 0\r")
        assert client.ask(b"POS?\r") == b"0\r"


def test_an_origin_need_not_reset_the_counter() -> None:
    with running() as (_, client):
        client.tell(FAST + b"AXI1:POS 1000:MEMSW7 1:GO ORG\r")
        assert client.rests() & 0x10
        assert client.number(b"POS?\r") == 800


def test_an_origin_that_is_not_reached_is_not_found() -> None:
    with running([5000]) as (emulator, client):
        client.tell(FAST + b"AXI1:GO ORG\rSTOP 0\r")
        assert client.rests() & 0x18 == 0x08
        emulator.axes[0].lower_switch = 1000
        client.tell(b"AXI1:GO ORG\r")
        assert client.rests() & 0x1A == 0x0A


def test_the_flag_of_an_origin_may_stand_only_there() -> None:
    for keeps in (True, False):
        with running() as (emulator, client):
            emulator.controls[0].keeps_origin = keeps
            client.tell(FAST + b"AXI1:GO ORG\r")
            assert client.rests() & 0x10
            client.tell(b"AXI1:PULS 100:GO CW\r")
            assert bool(client.rests() & 0x10) is keeps


def test_positions_are_in_the_unit_and_divided_as_is_set() -> None:
    with running() as (emulator, client):
        client.tell(FAST + b"AXI1:UNIT 1:STANDARD 2:DRDIV 6\r")
        assert client.ask(b"RESOLUT?\r") == b"0.2\r"
        client.tell(b"AXI1:GOABS 12.4\r")
        client.rests()
        assert client.ask(b"POS?\r") == b"12.4\r"
        assert emulator.axes[0].position == pytest.approx(200 + 6.2)  # full steps of 2 um
        client.tell(b"AXI1:UNIT 0\r")
        assert client.ask(b"POS?\r") == b"62\r"
        client.tell(b"AXI1:DRDIV 0\r")
        assert client.ask(b"POS?\r") == b"62\r"
    with running(has_micro_steps=False) as (_, client):
        assert client.ask(b"AXI1:SB3?\r") == b"1\r"
        assert client.ask(b"AXI1:DRDIV 6\r") == b"E22\r"


def test_power_takes_what_was_not_written() -> None:
    with running() as (emulator, client):
        client.tell(FAST + b"AXI1:MEMSW0 3:CWSLE 1:WRITE\r")
        client.tell(b"AXI1:F0 5:SELSP 2:GOABS 500\r")
        client.until(lambda: emulator.axes[0].moving)
        emulator.power_cycle()
        assert client.ask(b"AXI1:SB1?\r") == b"32\r"
        assert client.ask(b"POS?\r") == b"0\r"
        told = [client.ask(query) for query in (b"F0?\r", b"MEMSW0?\r", b"CWSLE?\r", b"SELSP?\r")]
        assert told == [b"20000\r", b"3\r", b"1\r", b"0\r"]


def test_writing_takes_130_ms_in_which_lines_wait() -> None:
    with running() as (_, client):
        began = time.monotonic()
        client.tell(b"WRITE\r")
        assert client.ask(b"AXI1:POS?\r") == b"0\r"
        assert 0.13 <= time.monotonic() - began < 0.6


def test_a_reset_is_deaf_for_its_time_and_forgets() -> None:
    assert DS102Emulator(wire=TcpPort).reset_s == 5
    with running(reset_s=0.3) as (_, client):
        client.tell(b"AXI1:POS 77:F0 5:*RST\r")
        time.sleep(0.05)
        client.tell(b"POS?\r")
        assert client.line(0.4) == b""
        assert client.ask(b"POS?\r") == b"0\r"
        assert client.ask(b"F0?\r") == b"1000\r"


def test_dw_holds_up_all_that_follows() -> None:
    with running() as (_, client):
        client.tell(b"AXI1:L0 1000:F0 1000:PULS 200:GO CW:DW:POS?\r")
        began = time.monotonic()
        client.tell(b"AXI2:POS?\r")
        assert client.line() == b"200\r"
        assert 0.15 < time.monotonic() - began < 1
        assert client.line() == b"0\r"


def test_faults_of_the_device() -> None:
    with running() as (emulator, client):
        client.tell(FAST + b"AXI1:GO CWJ\r")
        client.until(lambda: emulator.axes[0].moving)
        emulator.press_emergency_stop()
        assert client.ask(b"EMS?\r") == b"1\r"
        assert not client.rests() & 0x40
        assert client.ask(b"AXI1:GO CW\r") == b"E03\r"
        emulator.emergency = False
        emulator.axes[0].slowness = 100
        client.tell(b"AXI1:PULS 200:GO CW\r")
        time.sleep(0.1)
        assert client.ask(b"MOTION?\r") == b"1\r"
        emulator.unplug(0)
        assert client.ask(b"SB2?\r") == b"3\r"
        assert client.ask(b"MOTION?\r") == b"0\r"
        assert client.ask(b"GO CW\r") == b"E00\r"


def test_a_reply_takes_what_was_measured_and_less_if_that_is_set() -> None:
    assert DS102Emulator(wire=TcpPort).wire.processing_s == 0.05
    with running(processing_s=0.05, baud=38400) as (_, client):
        began = time.monotonic()
        client.ask(b"AXI1:POS?\r")
        assert 0.053 <= time.monotonic() - began < 0.3
    with pytest.raises(ValueError, match="2, 4 or 6 connectors and as many axes at most, got 3, 2"):
        DS102Emulator(connectors=3)


def test_faults_of_the_wire_are_there() -> None:
    with running() as (emulator, client):
        emulator.faults.garbled_reply = 1
        assert client.ask(b"CONTA?\r") != b"2\r"
        emulator.faults.wrong_terminator = 1
        client.tell(b"CONTA?\r")
        assert client.line(0.3) == b"2;"
        emulator.faults.deaf = True
        client.tell(b"CONTA?\r")
        assert client.is_silent()


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_a_client_at_a_serial_port_is_answered_alike() -> None:
    import serial

    with (
        DS102Emulator(wire=PseudoTerminal, processing_s=0) as emulator,
        serial.Serial(emulator.url, 38400, timeout=2) as port,
    ):
        port.write(b"AXI1:POS 5:POS?\r")
        assert port.read_until(b"\r") == b"5\r"
        assert isinstance(emulator.wire, PseudoTerminal) and emulator.wire.settings == (38400, False)
        assert emulator.heard == ["AXI1:POS 5:POS?"]
