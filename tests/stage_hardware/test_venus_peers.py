"""The emulated Corvus, driven by programs that others wrote for the real one."""

import math
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest
from stage_hardware.emulators.venus import EmulatedStage, VenusEmulator
from stage_hardware.emulators.wire import PseudoTerminal

pystages = pytest.importorskip("pystages", reason="pystages is in the extra peers")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")

SHORT = EmulatedStage(length=2.0, position=0.5, speed=20.0, acceleration=400.0)


@pytest.fixture
def driven() -> Iterator[tuple[VenusEmulator, Any]]:
    with VenusEmulator([SHORT] * 3, wire=PseudoTerminal, baud=57600) as emulator:
        corvus = pystages.Corvus(emulator.url)
        yield emulator, corvus
        corvus.serial.close()


def arrived(corvus: Any, takes_s: float) -> float:
    began = time.monotonic()
    while corvus.is_moving:
        assert time.monotonic() - began < takes_s + 5
    return time.monotonic() - began


def test_pystages_sets_it_up_and_reads_it(driven: tuple[VenusEmulator, Any]) -> None:
    emulator, corvus = driven
    assert corvus.position == pystages.Vector(0, 0, 0)
    assert emulator.settings.units == [1, 1, 1, 1]
    corvus.velocity, corvus.acceleration = 5000.0, 100000.0
    assert (corvus.velocity, corvus.acceleration) == (5000.0, 100000.0)
    assert emulator.settings.speed == 5.0


def test_pystages_moves_it(driven: tuple[VenusEmulator, Any]) -> None:
    _, corvus = driven
    corvus.velocity, corvus.acceleration = 1000.0, 100000.0
    corvus.position = pystages.Vector(300, 400, 0)
    takes = 0.5 + 0.01
    assert takes - 0.1 < arrived(corvus, takes) < takes + 1
    assert corvus.position == pystages.Vector(300, 400, 0)
    corvus.move_relative(-100, 0, 25)
    assert corvus.position == pystages.Vector(200, 400, 25)
    corvus.set_origin()
    assert corvus.position == pystages.Vector(0, 0, 0)


def test_pystages_calibrates_it(driven: tuple[VenusEmulator, Any]) -> None:
    emulator, corvus = driven
    corvus.calibrate()
    assert all(axis.limits == (0, pytest.approx(2.0)) for axis in emulator.axes.values())
    assert list(corvus.position) == pytest.approx([2000.0] * 3)
    corvus.home(wait=True)
    assert corvus.position == pystages.Vector(0, 0, 0)
    corvus.position = pystages.Vector(0, 0, 2001)
    assert not corvus.is_moving
    assert corvus.send_receive("ge") == "1004"


def test_pystages_calibrates_two_axes(driven: tuple[VenusEmulator, Any]) -> None:
    emulator, corvus = driven
    corvus.calibrate_xy()
    assert [axis.found for axis in emulator.axes.values()] == [3, 3, 0]
    assert math.isclose(emulator.axes[3].mechanism.position, 0.5)
