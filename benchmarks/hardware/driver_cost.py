"""What a driver adds to the time that its bytes need on the wire.

Run ``python benchmarks/hardware/driver_cost.py`` on an otherwise idle machine (four minutes; ``--seconds`` for less).
`neurorobo emulate` brings up the controllers of both example rigs on pseudo-terminals, at the pace of their baud rates,
in a process of its own. Each controller is asked for its state by its driver and, in turn with that, by a bare loop of
system calls that writes the same bytes to the same port and waits for as many to come back. What the driver takes
longer in the median is its cost, wanted to be at most 5 % of the wire time: ten bits for each byte, both ways. Most of
it is that a processor which has waited finds none of what it needs in its caches, and differs from run to run. It
writes ``driver_cost.json`` beside itself and the table of ``docs/how_to/run_on_hardware.md``, prints what is measured,
and exits with 1 if a figure is missed.
"""

import argparse
import json
import os
import select
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml
from insertions import CASES, PAGE, emulated
from machine import machine
from page import between
from stage_hardware.links.serial_link import SerialLink
from stage_hardware.rig.rig_config import load_rig

MOST = 0.05
SECONDS = 60.0
"""For each controller: four hundred questions to the slowest, thousands to the fastest."""

BITS_OF_A_BYTE = 10
RESULTS = Path(__file__).with_name("driver_cost.json")
START, END = "<!-- driver_cost.json -->", "<!-- end of driver_cost.json -->"


@dataclass(frozen=True)
class Cost:
    """Medians of a state ``asked`` for by a driver and by a bare loop, and the time of its bytes on the wire (ms)."""

    controller: str
    asked: int
    wire_ms: float
    bare_ms: float
    driver_ms: float

    @property
    def share(self) -> float:
        """What the driver adds, as a share of the wire time."""
        return (self.driver_ms - self.bare_ms) / self.wire_ms


class Transcript:
    """A port in whose place it stands, and what went over it: the bytes of each question, how many answered it."""

    def __init__(self, port: Any) -> None:
        """Note what goes over a port."""
        self._port, self.exchanges = port, list[tuple[bytes, int]]()

    def __getattr__(self, name: str) -> Any:
        """Leave everything else to the port."""
        return getattr(self._port, name)

    def write(self, data: bytes) -> None:
        """Begin an exchange."""
        self._port.write(data)
        self.exchanges.append((data, 0))

    def read(self, size: int) -> bytes:
        """Count what answers the last question."""
        data: bytes = self._port.read(size)
        if data:
            question, answered = self.exchanges[-1]
            self.exchanges[-1] = question, answered + len(data)
        return data


@contextmanager
def opened_links() -> Iterator[list[SerialLink]]:
    """Yield the links that are opened, as drivers keep them to themselves."""
    links: list[SerialLink] = []
    open_link = SerialLink.open

    def noted(link: SerialLink) -> None:
        open_link(link)
        links.append(link)

    SerialLink.open = noted  # type: ignore[method-assign, assignment]
    try:
        yield links
    finally:
        SerialLink.open = open_link  # type: ignore[method-assign]


def on_a_port(rig: Path, folder: Path) -> Path:
    """Write a rig whose controllers are all on serial ports, and return its file."""
    document = yaml.safe_load(rig.read_text())
    for number, controller in enumerate(document["controllers"].values()):
        controller["port"] = f"/dev/ttyUSB{number}"
    written = folder / f"{rig.stem}.yaml"
    written.write_text(yaml.safe_dump(document, sort_keys=False))
    return written


def measured(rig: Path, seconds: float) -> Iterator[Cost]:
    """Yield what the driver of each controller costs."""
    with tempfile.TemporaryDirectory() as name, emulated(on_a_port(rig, Path(name)), Path(name)) as addresses:
        config = load_rig(addresses)
        for controller, device in config.controllers.items():
            stage = device.build(controller)
            with opened_links() as links:
                stage.connect()
            try:
                yield _measured(stage, links[-1], seconds, f"{rig.stem}, {controller}: {device.type}")
            finally:
                stage.close()


def _measured(stage: Any, link: SerialLink, seconds: float, name: str) -> Cost:
    port: Any = link._port
    stage.state()
    link._port, link._is_file = (transcript := Transcript(port)), False  # type: ignore[assignment]
    stage.state()
    link._port, link._is_file = port, True
    by_driver_s, bare_s = list[float](), list[float]()
    ends_s = time.perf_counter() + seconds
    while not bare_s or time.perf_counter() < ends_s:
        began_s = time.perf_counter()
        stage.state()
        by_driver_s.append(time.perf_counter() - began_s)
        began_s = time.perf_counter()
        for question, answered in transcript.exchanges:
            os.write(port.fd, question)
            while answered:
                if not select.select([port.fd], [], [], 1.0)[0]:
                    raise RuntimeError(f"{name}: {question!r} is not answered as before")
                answered -= len(os.read(port.fd, answered))
        bare_s.append(time.perf_counter() - began_s)
    bytes_on_wire = sum(len(question) + answered for question, answered in transcript.exchanges)
    return Cost(
        name,
        asked=len(bare_s),
        wire_ms=1e3 * bytes_on_wire * BITS_OF_A_BYTE / port.baudrate,
        bare_ms=1e3 * statistics.median(bare_s),
        driver_ms=1e3 * statistics.median(by_driver_s),
    )


def into_page(text: str, content: dict[str, Any]) -> str:
    """Return a page with its table replaced."""
    rows = ["| controller | asked | on the wire, ms | by a bare loop | by the driver | cost |", "| --- " * 6 + "|"]
    for cost in (Cost(**one) for one in content["controllers"]):
        times = f"{cost.wire_ms:.2f} | {cost.bare_ms:.2f} | {cost.driver_ms:.2f}"
        rows.append(f"| {cost.controller} | {cost.asked} times | {times} | {cost.share:.1%} |")
    return between(text, START, END, "\n".join(rows))


def main() -> int:
    """Measure, write and print; return 1 if a wanted figure is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="for each controller; fewer write nothing")
    arguments = parser.parse_args()
    costs = [cost for case in CASES.values() for cost in measured(case.rig, arguments.seconds)]
    for cost in costs:
        print(
            f"{cost.controller}: {cost.wire_ms:.2f} ms on the wire, {cost.bare_ms:.2f} ms by a bare loop, "
            f"{cost.driver_ms:.2f} ms by the driver, {cost.share:+.1%} of the wire time"
        )
    missed = [cost for cost in costs if cost.share > MOST]
    for cost in missed:
        print(f"MISSED: {cost.controller} takes {cost.share:.1%} more, wanted at most {MOST:.0%}")
    if arguments.seconds >= SECONDS:
        content = {"machine": machine(), "controllers": [asdict(cost) for cost in costs]}
        RESULTS.write_text(json.dumps(content, indent=2) + "\n")
        PAGE.write_text(into_page(PAGE.read_text(), content))
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
