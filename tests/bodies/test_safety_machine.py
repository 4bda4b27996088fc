"""What a body may do, the latch that outlives a process, and the watch that stops what moves."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from neurorobo.errors import NeuroroboError
from neurorobo.safety.guard import Trip
from neurorobo.safety.machine import Latch, SafetyError, SafetyMachine, SafetyState
from neurorobo.safety.watch import SafetyWatch

STOP = Trip("force", "too much", "find out", "stop")
LATCH = Trip("force", "far too much", "look at it", "latch")


@pytest.fixture
def machine(tmp_path: Path) -> SafetyMachine:
    return SafetyMachine(Latch(tmp_path / "rig.latch.json"))


def running(machine: SafetyMachine) -> SafetyMachine:
    machine.arm()
    machine.run()
    return machine


def test_only_an_armed_body_runs_and_only_a_running_one_moves(machine: SafetyMachine) -> None:
    assert machine.state is SafetyState.DISARMED
    for act in (machine.run, machine.check):
        with pytest.raises(SafetyError, match="`--arm`"):
            act()
    machine.arm()
    for act in (machine.arm, machine.check):
        with pytest.raises(SafetyError):
            act()
    machine.run()
    machine.check()
    machine.rest()
    assert machine.state is SafetyState.ARMED
    machine.disarm()
    assert machine.state is SafetyState.DISARMED


def test_what_was_stopped_tells_why_until_it_is_disarmed_and_armed_again(machine: SafetyMachine) -> None:
    assert running(machine).stop(STOP)
    assert not machine.stop(Trip("axis", "later", "see"))
    for act in (machine.check, machine.run, machine.arm):
        with pytest.raises(SafetyError, match="force: too much; find out") as raised:
            act()
        assert raised.value.trip is STOP
    machine.rest()
    assert machine.state is SafetyState.STOPPED
    machine.disarm()
    running(machine).check()
    assert machine.latch.reason() is None


def test_a_later_trip_can_latch_what_was_stopped_and_the_first_reason_stays(machine: SafetyMachine) -> None:
    running(machine).stop(STOP)
    machine.stop(LATCH)
    machine.stop(Trip("axis", "later", "see", "latch"))
    assert (machine.state, machine.trip) == (SafetyState.LATCHED, STOP)
    reason = machine.latch.reason()
    assert reason is not None and reason.startswith("force: far too much, 2")
    machine.disarm()
    assert machine.state is SafetyState.LATCHED


def test_a_latch_outlives_the_process_until_somebody_removes_it(tmp_path: Path) -> None:
    path = tmp_path / "rig.latch.json"
    code = (
        "import sys, pathlib\n"
        "from neurorobo.safety.guard import Trip\n"
        "from neurorobo.safety.machine import Latch, SafetyMachine\n"
        "machine = SafetyMachine(Latch(pathlib.Path(sys.argv[1])))\n"
        "machine.arm(); machine.run()\n"
        "machine.stop(Trip('force', 'far too much', 'look', 'latch'))\n"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=True, timeout=60)
    machine = SafetyMachine(Latch(path))
    assert machine.state is SafetyState.LATCHED
    with pytest.raises(SafetyError, match=r"latched: force: far too much.*remove"):
        machine.arm()
    Latch(path).clear()
    SafetyMachine(Latch(path)).arm()


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b"\xff\xfe", b'{"place": 1'])
def test_a_latch_that_cannot_be_read_is_one(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "rig.latch.json"
    path.write_bytes(content)
    machine = SafetyMachine(Latch(path))
    with pytest.raises(SafetyError, match="cannot be read"):
        machine.arm()
    assert machine.state is SafetyState.LATCHED


def test_a_latch_that_cannot_be_written_holds_for_the_process_and_is_told(tmp_path: Path) -> None:
    (tmp_path / "rig.latch.json.part").mkdir()  # where it is written first
    machine = running(SafetyMachine(Latch(tmp_path / "rig.latch.json")))
    told: list[str] = []
    machine.stop(LATCH, lambda: told.append("stops"))
    assert told == ["stops"]
    assert machine.state is SafetyState.LATCHED
    assert machine.latch_fault is not None and "rig.latch.json" in machine.latch_fault


class Cart:
    """Something that moves: it stands ``coasts_s`` after a stop, which takes ``hears_s`` to be sent."""

    def __init__(self, hears_s: float = 0.0, coasts_s: float = 0.0, error: Exception | None = None) -> None:
        self.hears_s, self.coasts_s, self.error = hears_s, coasts_s, error
        self.stopped_ns: list[int] = []

    def stop(self) -> None:
        time.sleep(self.hears_s)
        if self.error is not None:
            raise self.error
        self.stopped_ns.append(time.monotonic_ns())

    def is_moving(self) -> bool:
        return time.monotonic_ns() < self.stopped_ns[0] + self.coasts_s * 1e9


@contextmanager
def watching(
    machine: SafetyMachine, *, checks: tuple[Callable[[int], Trip | None], ...] = (), **carts: Cart
) -> Iterator[SafetyWatch]:
    before = set(threading.enumerate())
    watch = SafetyWatch(machine, carts, checks, stands_s=0.3)
    watch.start()
    try:
        yield watch
    finally:
        watch.close()
    assert set(threading.enumerate()) == before


def test_all_movers_are_stopped_at_the_first_trip_and_seen_to_stand(machine: SafetyMachine) -> None:
    one, other = Cart(), Cart(coasts_s=0.05)
    with watching(running(machine), one=one, other=other) as watch:
        assert watch.reaction_ms is None
        watch.trip(STOP)
        watch.trip(Trip("axis", "later", "see"))
        assert watch.wait_until_all_stand()
        assert watch.tripped_ns is not None
        assert all(0 <= cart.stopped_ns[0] - watch.tripped_ns < 0.1e9 for cart in (one, other))
        assert watch.reaction_ms == max(watch.sent_ms.values()) < 100
        assert watch.stood_ms["other"] >= 50 > watch.stood_ms["one"]
        assert machine.state is SafetyState.STOPPED


def test_a_mover_that_hangs_delays_no_other(machine: SafetyMachine) -> None:
    quick, hangs = Cart(), Cart(hears_s=0.2)
    with watching(running(machine), hangs=hangs, quick=quick) as watch:
        watch.trip(STOP)
        assert watch.wait_until_all_stand()
        assert watch.sent_ms["quick"] < 100 < 200 <= watch.sent_ms["hangs"]


@pytest.mark.parametrize(
    ("cart", "fault"),
    [
        (Cart(coasts_s=60), "it does not stand still"),
        (Cart(error=NeuroroboError("the line is gone")), "the line is gone"),
        (Cart(error=KeyError("a mistake")), "KeyError"),
    ],
)
def test_a_mover_that_does_not_stand_is_latched_and_the_others_stand(
    machine: SafetyMachine, cart: Cart, fault: str
) -> None:
    with watching(running(machine), bad=cart, good=Cart()) as watch:
        watch.trip(STOP)
        assert watch.wait_until_all_stand()
        assert machine.state is SafetyState.LATCHED
        assert fault in str(machine.latch.reason())
        assert machine.trip is STOP
        assert list(watch.stood_ms) == ["good"]


def test_the_stop_does_not_wait_for_the_latch_to_be_written(
    machine: SafetyMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    cart = Cart()
    with watching(running(machine), cart=cart) as watch:
        written = threading.Event()

        def slow(trip: Trip) -> None:
            written.wait(5)
            raise NeuroroboError("the disk is full")

        monkeypatch.setattr(machine.latch, "set", slow)
        writer = threading.Thread(target=watch.trip, args=(LATCH,))
        writer.start()
        try:
            assert watch.wait_until_all_stand()
            assert cart.stopped_ns
        finally:
            written.set()
            writer.join()


def test_checks_trip_and_one_that_fails_trips_too(machine: SafetyMachine) -> None:
    asked: list[int] = []

    def check(now_ns: int) -> Trip | None:
        asked.append(now_ns)
        return STOP if len(asked) > 3 else None

    with watching(running(machine), checks=(check,), cart=Cart()) as watch:
        watch.sleep(5)
        assert watch.wait_until_all_stand()
        assert len(asked) == 4 and machine.trip is STOP
    machine.disarm()

    def fails(now_ns: int) -> Trip | None:
        raise ZeroDivisionError("a guard that guards nothing")

    with watching(running(machine), checks=(fails,), cart=Cart()) as watch:
        watch.sleep(5)
        assert watch.wait_until_all_stand()
        assert machine.trip is not None and "a check failed" in machine.trip.fault


def test_what_was_moved_after_a_trip_is_stopped_again(machine: SafetyMachine) -> None:
    cart = Cart()
    with watching(running(machine), cart=cart) as watch:
        watch.trip(STOP)
        watch.wait_until_all_stand()
        first = dict(watch.sent_ms)
        assert watch.stop_again()
        assert len(cart.stopped_ns) == 2
        assert watch.sent_ms == first
        cart.error = NeuroroboError("gone")
        assert not watch.stop_again()
        assert machine.state is SafetyState.LATCHED


def test_a_watch_that_ends_untripped_stops_nothing(machine: SafetyMachine) -> None:
    cart = Cart()
    with watching(running(machine), cart=cart):
        pass
    assert not cart.stopped_ns
