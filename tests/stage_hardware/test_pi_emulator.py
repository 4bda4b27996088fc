"""What the emulated PI controller answers, byte by byte, as the manuals have it."""

import pytest
from stage_hardware.emulators.pi_gcs import EmulatedStage, PiEmulator


class Now:
    """A clock that is set by hand."""

    s = 100.0

    def __call__(self) -> float:
        return self.s


class Bench:
    """A controller of two axes that is asked without a wire."""

    def __init__(self) -> None:
        self.now = Now()
        stages = {"1": EmulatedStage(position=2), "2": EmulatedStage(position=-2)}
        self.controller = PiEmulator(stages, clock=self.now)

    def ask(self, data: bytes) -> bytes:
        return b"".join(self.controller.answer(data))

    def error_after(self, data: bytes) -> int:
        assert self.ask(data) == b""
        return int(self.ask(b"ERR?\n"))

    def homed(self) -> "Bench":
        assert self.error_after(b"SVO 1 1 2 1\nFRF\n") == 0
        self.now.s += 60
        assert self.ask(b"FRF?\n") == b"1=1 \n2=1\n"
        return self


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_all_lines_of_an_answer_but_the_last_end_with_a_blank(bench: Bench) -> None:
    assert bench.ask(b"SAI?\n") == b"1 \n2\n"
    assert bench.ask(b"TMN?\n") == b"1=-12.5000000 \n2=-12.5000000\n"
    assert bench.ask(b"TMX? 2\n") == b"2=12.5000000\n"
    assert bench.ask(b"CSV?\n") == b"2.0\n"
    help_lines = bench.ask(b"HLP?\n").split(b"\n")
    assert help_lines[-1] == b"" and all(line.endswith(b" ") for line in help_lines[:-2])


def test_an_error_is_kept_until_it_is_asked_for(bench: Bench) -> None:
    assert bench.ask(b"NONSENSE 1\n") == b""
    assert bench.ask(b"POS? 1\n") == b"1=0.0000000\n"
    assert bench.ask(b"ERR?\n") == b"2\n"
    assert bench.ask(b"ERR?\n") == b"0\n"


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (b"MOV 1 5 2 13", 7),
        (b"MOV 1 5 3 1", 15),
        (b"MOV 1 5 2", 24),
        (b"MOV 1 5 2 x", 25),
        (b"VEL 1 11", 8),
        (b"SVO 1 2", 17),
        (b"POS 1 0", 17),
        (b"POS? 3", 15),
        (b"SPA? 1 0x99", 54),
    ],
)
def test_a_line_with_an_invalid_part_is_ignored_whole(bench: Bench, command: bytes, code: int) -> None:
    bench.homed()
    assert bench.error_after(command + b"\n") == code
    assert bench.ask(b"\x05") == b"0\n"
    assert bench.ask(b"VEL? 1\n") == b"1=5.0000000\n"


def test_moves_need_servo_and_reference(bench: Bench) -> None:
    assert bench.error_after(b"MOV 1 1\n") == 5
    bench.ask(b"SVO 1 1\n")
    assert bench.error_after(b"MOV 1 1\n") == 5
    bench.homed()
    assert bench.error_after(b"MOV 1 1\n") == 0
    bench.now.s += 60
    assert bench.error_after(b"MVR 1 0.25\n") == 0
    bench.now.s += 60
    assert bench.ask(b"POS? 1\n") == b"1=1.2500000\n" == bench.ask(b"MOV? 1\n")
    bench.ask(b"RON 1 0\n")
    assert bench.error_after(b"FRF 1\n") == 50
    assert bench.ask(b"FRF? 1\n") == b"1=0\n"
    assert bench.error_after(b"POS 1 4\n") == 0
    assert bench.ask(b"FRF? 1\nPOS? 1\n") == b"1=1\n1=4.0000000\n"


def test_single_characters_are_heard_in_the_middle_of_a_line(bench: Bench) -> None:
    bench.homed()
    bench.ask(b"MOV 1 10 2 10\n")
    bench.now.s += 1
    assert bench.ask(b"POS? \x051") == b"3\n"
    assert bench.ask(b"\x18") == b""
    there = bench.ask(b"\n")
    assert there.startswith(b"1=4.")
    bench.now.s += 10
    assert bench.ask(b"POS? 1\n") == there
    assert bench.ask(b"ERR?\n") == b"10\n"


def test_status_registers_say_what_an_axis_does(bench: Bench) -> None:
    assert bench.ask(b"\x04") == b"0x00020000\n"  # servos off, the first one above its reference switch
    bench.ask(b"SVO 1 1\nFRF 1\n")
    assert bench.ask(b"\x04") == b"0x70020000\n"  # referencing, moving, servo on
    assert bench.ask(b"\x07") == b"\xb0\n"
    bench.now.s += 60
    assert bench.ask(b"\x07") == b"\xb1\n"
    assert bench.ask(b"SRG? 1 1\n") == b"1 1=0x9002\n"  # on target
    bench.ask(b"SVO 2 1\nFNL 2\n")
    bench.now.s += 60
    assert bench.ask(b"SRG? 2 1\n") == b"2 1=0x9001\n"  # at its lower switch
    bench.ask(b"MOV 1 99\n")
    assert bench.ask(b"\x04") == b"0x91029101\n"  # with an error


def test_a_halt_ramps_down_and_a_stop_does_not(bench: Bench) -> None:
    for command, way in ((b"HLT 1\n", 0.25), (b"STP\n", 0.0), (b"\x18", 0.0)):
        bench.controller.power_cycle()
        bench.homed().ask(b"MOV 1 10\n")
        bench.now.s += 1
        there = bench.controller.axes["1"].position
        assert bench.error_after(command) == 10
        bench.now.s += 60
        assert bench.controller.axes["1"].position == pytest.approx(there + way)  # 5 mm/s, 50 mm/s2
        assert bench.ask(b"ONT? 1\n") == b"1=1\n"


def test_a_power_cycle_loses_what_is_in_memory(bench: Bench) -> None:
    bench.homed().ask(b"VEL 1 2\nMOV 1 3\n")
    bench.now.s += 60
    bench.ask(b"MOV 1 99\nPOS? 1")
    bench.controller.power_cycle()
    assert bench.ask(b"ERR?\n") == b"0\n"
    assert bench.ask(b"FRF? 1\nSVO? 1\nPOS? 1\nVEL? 1\n") == b"1=0\n1=0\n1=0.0000000\n1=5.0000000\n"
    assert bench.controller.axes["1"].mechanism.position == pytest.approx(3)
