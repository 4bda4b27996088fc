"""The emulated Corvus and Pollux, byte by byte, against what is known of Venus-1 and Venus-2."""

import math
import sys
import time
from collections.abc import Iterator

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st
from stage_hardware.emulators.venus import EmulatedStage, VenusEmulator
from stage_hardware.emulators.wire import PseudoTerminal, TcpPort, Wire

WIRES: list[type[Wire]] = [TcpPort] if sys.platform == "win32" else [PseudoTerminal, TcpPort]

WORDS = sorted({*VenusEmulator(venus=1)._words, *VenusEmulator(venus=2)._words} - {"speed"})


class Now:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.s = 100.0

    def __call__(self) -> float:
        return self.s


class Bench:
    """A controller without a wire, and its clock."""

    def __init__(self, **options: object) -> None:
        self.now = Now()
        self.controller = VenusEmulator(clock=self.now, **options)  # type: ignore[arg-type]

    def __call__(self, data: bytes, after_s: float = 0.0) -> bytes:
        self.now.s += after_s
        return b"".join(self.controller.answer(data))

    def wait(self, seconds: float) -> bytes:
        """Let time go by, as the wire does, and return what comes of itself."""
        came = b""
        for _ in range(round(seconds / 0.02)):
            self.now.s += 0.02
            came += b"".join(self.controller.later())
        return came


@pytest.fixture
def corvus() -> Bench:
    """A Corvus with units of mm, as it is switched on."""
    return Bench()


@pytest.fixture
def calibrated(corvus: Bench) -> Bench:
    """The same after its axes have found both ends."""
    corvus(b"cal rm ")
    corvus.wait(30)
    assert corvus(b"1 getcaldone 2 getcaldone 3 getcaldone ") == b"3\r\n3\r\n3\r\n"
    corvus(b"0 0 0 m ")
    corvus.wait(30)
    return corvus


@pytest.fixture
def pollux() -> Bench:
    """Two axes of Venus-2."""
    return Bench(venus=2, stages=[EmulatedStage(), EmulatedStage()])


def test_the_switched_on_controller_stands_at_zero_and_knows_no_limits(corvus: Bench) -> None:
    assert corvus(b"p pos st status identify ge gme ") == (
        b"0.000000 0.000000 0.000000\r\n" * 2 + b"0\r\n0\r\nCorvus 1 462 1 380\r\n0\r\n0\r\n"
    )
    assert corvus(b"1 getcaldone 1 getswst getjoystick -1 getaxis 2 getaxis ") == b"0\r\n0 0\r\n0\r\n1 1 1\r\n1\r\n"
    lo, hi = map(float, corvus(b"1 getnlimit ").split())
    assert lo < -1000 and hi > 1000


@pytest.mark.parametrize("end", [b" ", b"\r\n", b"\r", b" \r\n"])
def test_words_end_in_blanks_or_lines_and_come_in_pieces(corvus: Bench, end: bytes) -> None:
    assert corvus(b"p") == b""
    assert corvus(b"os") == b""
    assert corvus(end) == b"0.000000 0.000000 0.000000\r\n"


def test_a_move_is_silent_takes_its_time_and_is_straight(calibrated: Bench) -> None:
    assert calibrated(b"10 setvel 100 sa 3 4 0 move ") == b""
    takes = 5 / 10 + 10 / 100  # 5 mm at 10 mm/s and 100 mm/s^2
    assert calibrated(b"st ", takes / 2) == b"1\r\n"
    x, y, z = map(float, calibrated(b"p ").split())
    assert (x, y, z) == pytest.approx((1.5, 2, 0), abs=1e-5)
    assert calibrated(b"st ", takes / 2 - 0.001) == b"1\r\n"
    assert calibrated(b"st p ", 0.002) == b"0\r\n3.000000 4.000000 0.000000\r\n"
    calibrated(b"-1 -1 1.5 r ")
    assert calibrated(b"st p 1 npos ", 5) == b"0\r\n2.000000 3.000000 1.500000\r\n2.000000\r\n"


def test_a_second_motion_waits_for_the_first_and_all_words_after_it_wait_too(calibrated: Bench) -> None:
    assert calibrated(b"5 0 0 m 0 0 0 r st ") == b""
    assert calibrated(b"p ") == b""
    came = calibrated.wait(2)
    assert came == b"0\r\n5.000000 0.000000 0.000000\r\n"
    calibrated(b"1 0 0 r 1 0 0 r ")
    calibrated.wait(5)
    assert calibrated(b"p ") == b"7.000000 0.000000 0.000000\r\n"


def test_an_abort_brakes_but_waits_its_turn_and_the_break_does_not(calibrated: Bench) -> None:
    calibrated(b"10 sv 100 sa 40 0 0 m ")
    assert calibrated(b"abort ", 2.0) == b""
    assert calibrated(b"st ") == b"1\r\n"
    x, *_ = map(float, calibrated(b"p ", 1.0).split())
    assert x == pytest.approx(2.0 * 10 - 0.5 + 0.5, abs=1e-5)  # the way of a ramp is 0.5 mm

    calibrated(b"0 0 0 m ")
    calibrated.wait(10)
    calibrated(b"40 0 0 m 0 0 0 r abort st ")
    assert calibrated(b"", 1.0) == b""
    assert calibrated.controller.axes[1].mechanism.velocity == 10
    assert calibrated(b"\x03") == b""
    calibrated.wait(1.0)
    assert not calibrated.controller.axes[1].mechanism.moving
    x, *_ = map(float, calibrated(b"p ").split())
    assert x == pytest.approx(10, abs=1e-5)
    assert calibrated.wait(1) == b""  # the words that waited are gone


def test_units_are_of_positions_speeds_and_limits(calibrated: Bench) -> None:
    assert calibrated(b"-1 getunit ") == b"2 2 2 2\r\n"
    assert calibrated(b"1 -1 setunit -1 getunit ") == b"1 1 1 1\r\n"
    calibrated(b"2000 500 0 m ")
    calibrated.wait(2)
    assert calibrated(b"p ") == b"2000.000000 500.000000 0.000000\r\n"
    assert calibrated(b"1 getnlimit ") == b"0.000000 50000.000000\r\n"
    assert calibrated(b"5000 sv gv 20000 sa ga ") == b"5000.000000\r\n20000.000000\r\n"
    assert calibrated(b"2 0 setunit -1 getunit gv ") == b"1 1 1 2\r\n5.000000\r\n"
    assert calibrated(b"0 2 setunit p ") == b"2000.000000 20000.000000 0.000000\r\n"


def test_the_ends_of_the_travel_are_the_limits_and_a_target_beyond_is_an_error(calibrated: Bench) -> None:
    assert calibrated(b"3 getnlimit getlimit ") == b"0.000000 50.000000\r\n" * 4
    calibrated(b"0 0 50.1 m ")
    assert calibrated(b"st ge ge ") == b"0\r\n1004\r\n0\r\n"
    calibrated(b"0 0 50 m ")
    assert calibrated(b"st ge ") == b"1\r\n0\r\n"
    calibrated.wait(10)
    calibrated(b"10 10 10 20 20 20 setlimit ")
    assert calibrated(b"2 getnlimit ") == b"10.000000 20.000000\r\n"
    calibrated(b"15 15 5 m ")
    assert calibrated(b"st ge ") == b"0\r\n1004\r\n"


def test_one_axis_can_look_for_its_ends_alone(corvus: Bench) -> None:
    corvus(b"2 ncal ")
    assert corvus(b"2 getcaldone st ", 0.1) == b"0\r\n1\r\n"
    corvus.wait(5)
    assert corvus(b"1 getcaldone 2 getcaldone ") == b"0\r\n1\r\n"
    corvus(b"2 nrm ")
    corvus.wait(10)
    assert corvus(b"2 getcaldone 2 getnlimit ") == b"3\r\n0.000000 50.000000\r\n"


def test_a_search_that_was_broken_off_has_found_nothing(corvus: Bench) -> None:
    corvus(b"cal ")
    corvus.wait(0.4)
    corvus(b"\x03")
    corvus.wait(2)
    assert corvus(b"1 getcaldone st ") == b"0\r\n0\r\n"


def test_a_search_can_hold_up_all_words() -> None:
    corvus = Bench(cal_blocks=True)
    assert corvus(b"cal st ") == b""
    assert corvus.wait(5) == b"0\r\n"
    corvus(b"rm p ")
    assert corvus(b"\x03", 0.5) == b""
    assert corvus.wait(1) == b""
    assert corvus(b"st ") == b"0\r\n"


def test_an_axis_that_is_off_does_not_move_nor_look_for_its_ends(calibrated: Bench) -> None:
    calibrated(b"3 3 setaxis 1 1 1 m ")
    calibrated.wait(2)
    assert calibrated(b"p 3 getaxis ") == b"1.000000 1.000000 0.000000\r\n3\r\n"
    calibrated(b"1 3 setaxis 2 setdim 2 2 m ")
    calibrated.wait(2)
    assert calibrated(b"p ") == b"2.000000 2.000000\r\n"


def test_a_new_origin_is_given_by_its_distance(calibrated: Bench) -> None:
    calibrated(b"5 5 5 m ")
    calibrated.wait(3)
    calibrated(b"2 0 -3 setpos ")
    assert calibrated(b"p ") == b"-2.000000 0.000000 3.000000\r\n"
    assert calibrated(b"1 getnlimit ") == b"-7.000000 43.000000\r\n"
    calibrated(b"0 0 0 setpos ")
    assert calibrated(b"p ") == b"0.000000 0.000000 0.000000\r\n"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (b"nonsense ", 2000),
        (b"1 2 move ", 1002),
        (b"sv ", 1002),
        (b"1.5 getcaldone ", 1001),
        (b"4 getcaldone ", 1007),
        (b"7 1 setunit ", 1007),
        (b"0 setvel ", 1007),
        (b"1e999 ", 1007),
        (b"1e300 0 0 setpos ", 1007),
        (b"0 1 setpitch ", 1007),
        (b"1 " * 100, 1009),
    ],
)
def test_errors_are_kept_until_they_are_read(corvus: Bench, words: bytes, code: int) -> None:
    assert corvus(words) == b""
    assert corvus(b"ge ge st ") == b"%d\r\n0\r\n0\r\n" % code


@given(
    venus=st.sampled_from([1, 2]),
    words=st.lists(
        st.one_of(
            st.sampled_from(WORDS),
            st.sampled_from(["-1", "0", "1", "2", "3", "4"]),
            st.floats().map(str),
            st.text(max_size=3),
        ),
        max_size=30,
    ),
)
def test_no_program_upsets_it(venus: int, words: list[str]) -> None:
    bench = Bench(venus=venus)
    for word in words:
        bench(word.encode() + b" ", 0.01)
    bench(b"\x030 mode 0 nmode ")
    bench.wait(2)
    bench(b"reset ")
    bench.controller.power_cycle()
    bench(b"0 mode 0 nmode ")
    assert bench(b"st " if venus == 1 else b"1 nst ") == b"0\r\n"


def test_what_is_not_used_stays_on_the_stack_until_it_is_cleared(corvus: Bench) -> None:
    assert corvus(b"1 2 3 getcaldone getcaldone ") == b"0\r\n0\r\n"
    assert corvus(b"clear getcaldone ge ") == b"1002\r\n"


def test_a_power_cycle_loses_what_was_not_saved(calibrated: Bench) -> None:
    calibrated(b"1 -1 setunit save 2 -1 setunit 5 sv 1 1 1 m ")
    calibrated.now.s += 0.1
    calibrated.controller.power_cycle()
    assert calibrated(b"p -1 getunit st 1 getcaldone ") == b"0.000000 0.000000 0.000000\r\n1 1 1 1\r\n0\r\n0\r\n"
    assert calibrated(b"gv ") == b"10000.000000\r\n"
    assert float(calibrated(b"1 getnlimit ").split()[1]) > 1e6


def test_in_terminal_mode_it_echoes() -> None:
    corvus = Bench(terminal_mode=True)
    assert corvus(b"st ") == b"st 0\r\n"
    assert corvus(b"0 mode ") == b"0 mode "
    assert corvus(b"st ") == b"0\r\n"


def test_faults(calibrated: Bench) -> None:
    controller = calibrated.controller
    controller.refuse_next = 1004
    calibrated(b"1 1 1 m ")
    assert calibrated(b"st ge ") == b"0\r\n1004\r\n"
    calibrated(b"1 1 1 m ")
    assert calibrated(b"st ge ") == b"1\r\n0\r\n"
    calibrated.wait(2)

    # a switch in the way of one axis stops the other too
    controller.axes[1].mechanism.upper_switch = 4.0
    calibrated(b"10 10 1 m ")
    calibrated.wait(5)
    x, y, _ = map(float, calibrated(b"p ").split())
    assert x == 4 and y == pytest.approx(4, abs=0.3)
    assert calibrated(b"1 getswst 2 getswst st ") == b"0 1\r\n0 0\r\n0\r\n"
    controller.axes[1].mechanism.upper_switch = 50.1

    controller.axes[1].mechanism.slowness = 10.0
    calibrated(b"9 4 1 m ")
    assert calibrated(b"st ", 2) == b"1\r\n"
    calibrated.wait(10)
    assert calibrated(b"st ") == b"0\r\n"
    controller.axes[1].mechanism.slowness = 1.0

    calibrated(b"19 4 1 m ")
    calibrated.now.s += 0.5
    controller.switch_motor_off(1)
    there = calibrated(b"p ")
    assert calibrated(b"st p ", 1) == b"0\r\n" + there
    assert calibrated(b"1 1 1 m gme gme ") == b"1\r\n0\r\n"


def test_the_joystick_moves_what_it_is_on_for(calibrated: Bench) -> None:
    calibrated.controller.push_joystick(1, 1)
    assert calibrated(b"st ", 0.1) == b"0\r\n"
    calibrated(b"1 j ")
    calibrated.controller.push_joystick(1, 1)
    assert calibrated(b"getjoystick st ", 0.1) == b"1\r\n1\r\n"


def test_velocity_mode_crashes_it(corvus: Bench) -> None:
    assert corvus(b"1 1 1 speed st ") == b""
    assert corvus.controller.faults.deaf
    corvus.controller.power_cycle()
    assert corvus(b"st ") == b"0\r\n"


def test_axes_of_venus_2_are_commanded_one_by_one(pollux: Bench) -> None:
    pollux(b"1 ncal 2 ncal ")
    assert pollux(b"1 nst 2 nst ", 0.1) == b"1\r\n1\r\n"
    pollux.wait(5)
    pollux(b"1 nrm 2 nrm ")
    pollux.wait(10)
    assert pollux(b"1 getnlimit 2 np ") == b"0.000000 50.000000\r\n50.000000\r\n"
    pollux(b"20 1 snv 100 1 sna 2 2 setnvel 50 2 setnaccel ")
    assert pollux(b"1 gnv 2 gnv 2 gna ") == b"20.000000\r\n2.000000\r\n50.000000\r\n"
    pollux(b"10 1 nm -10 2 nr ")
    assert pollux(b"1 nst 2 nst ", 40 / 20 + 20 / 100 + 0.001) == b"0\r\n1\r\n"
    assert pollux(b"1 np 2 nst 2 np ", 4) == b"10.000000\r\n0\r\n40.000000\r\n"
    pollux(b"51 1 nm ")
    assert pollux(b"2 gne 1 gne 1 gne ") == b"0\r\n1004\r\n0\r\n"
    pollux(b"20 30 1 setnlimit 15 1 nm ")
    assert pollux(b"1 getnlimit 1 gne ") == b"20.000000 30.000000\r\n1004\r\n"
    pollux(b"1 move ")
    assert pollux(b"1 gne 2 gne ") == b"2000\r\n2000\r\n"
    pollux(b"0 1 setnpos ")
    assert pollux(b"1 np 2 np ") == b"0.000000\r\n40.000000\r\n"


def test_each_axis_of_venus_2_stops_and_waits_for_itself(pollux: Bench) -> None:
    pollux(b"5 1 nr 5 2 nr 1 nabort ")
    pollux.wait(2)
    assert pollux(b"1 np 2 np ") == b"0.000000\r\n5.000000\r\n"
    assert pollux(b"5 1 nr -5 2 nr 1 nst 2 nst ") == b"1\r\n1\r\n"
    assert pollux(b"1 1 nr 2 nst ") == b""
    assert pollux.wait(3) == b"0\r\n"
    pollux.wait(2)
    assert pollux(b"1 np ") == b"6.000000\r\n"
    pollux(b"5 1 nr 5 2 nr ", 0.0)
    pollux(b"\x03", 0.2)
    pollux.wait(1)
    assert pollux(b"1 nst 2 nst ") == b"0\r\n0\r\n"
    assert float(pollux(b"1 np ")) < 9


def test_faults_are_in_the_status_of_venus_2(pollux: Bench) -> None:
    pollux.controller.axes[2].manual = True
    pollux.controller.switch_motor_off(1)
    assert pollux(b"1 nst 2 nst ") == b"132\r\n2\r\n"


@pytest.fixture(params=WIRES)
def opened(request: pytest.FixtureRequest) -> Iterator[tuple[VenusEmulator, serial.Serial]]:
    with VenusEmulator(wire=request.param, baud=57600) as controller:
        port = serial.serial_for_url(controller.url, baudrate=57600, timeout=2.0)
        yield controller, port
        port.close()


def test_on_the_wire_a_reply_that_waited_comes_of_itself(opened: tuple[VenusEmulator, serial.Serial]) -> None:
    controller, port = opened
    began = time.monotonic()
    port.write(b"0 mode 1 0 0 m 0 0 0 r st ")
    assert port.read_until() == b"0\r\n"
    assert 2 * math.sqrt(1 / 100) < time.monotonic() - began < 1.5
    port.write(b"100 0 0 r 1 0 0 r st ")
    time.sleep(0.2)
    port.write(b"\x03")
    port.write(b"st p ")
    assert port.read_until() in (b"0\r\n", b"1\r\n")
    assert float(port.read_until().split()[0]) < 10
    assert controller.heard[-1] == "p"
