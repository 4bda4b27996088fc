"""A stream of force readings that loses records: whether each loss is counted, and what reading it costs.

Run ``python benchmarks/hardware/rdt_stream.py`` (ten minutes; ``--seconds`` for less). The emulated Net F/T box, in a
process of its own, sends 1000 records a second and loses 1 % of them at random; in the end it tells which. The reading
process keeps the number of each reading that it is handed, and adds up its own processor time, all of it: receiving,
sequence, units, and a reading with all components for a watcher. It prints what is measured and wanted, and exits with
1 if a figure is missed. The machine may be busy otherwise: processor time is not wall time.
"""

import argparse
import json
import multiprocessing
import sys
import time
from array import array
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np
from stage_hardware.drivers.ati_net_ft import AtiNetFt, RdtCounts
from stage_hardware.emulators.net_ft_box import NetFtBox
from stage_hardware.force_sensor import ForceReading, wrench_components

RATE_Hz = 1000.0
LOSS = 0.01
MOST_PROCESSOR = 0.15
"""The largest share of one processor that reading may take."""

LOAD = (1000.0, -2000.0, 3000.0, 10.0, -20.0, 30.0)
SETTLE_S = 0.5


@dataclass(frozen=True)
class Stream:
    """What a stream came to: records sent up to the last that came, those lost on the way, readings, and the cost."""

    sent: int
    dropped: frozenset[int]
    read: tuple[int, ...]
    counts: RdtCounts
    is_load: bool
    processor_s: float
    wall_s: float
    box_processor_s: float

    def misses(self) -> list[str]:
        """Return what is not as wanted."""
        made_up = self.dropped & set(self.read)
        gone = self.sent - len(self.read) - len(self.dropped)
        wanted = {
            f"{len(made_up)} lost records have a reading": not made_up,
            f"{gone} records were lost that the box has not dropped": gone == 0,
            f"{self.counts.lost} losses are counted, not {len(self.dropped)}": self.counts.lost == len(self.dropped),
            "readings do not come in order, each once": all(np.diff(self.read) > 0),
            "a reading is not the load": self.is_load,
            f"reading takes {self.share:.1%} of a processor": self.share < MOST_PROCESSOR,
        }
        return [miss for miss, is_well in wanted.items() if not is_well]

    @property
    def share(self) -> float:
        """The share of one processor that reading took."""
        return self.processor_s / self.wall_s


def emulate(pipe: Connection, seed: int) -> None:
    """Serve a box; lose nothing more when told so, and tell what was lost when told again."""
    box = NetFtBox(lambda time_s: LOAD, rate_Hz=RATE_Hz, loss=LOSS, generator=np.random.default_rng(seed))
    with box:
        began_s = time.process_time()
        pipe.send((box.host, box.rdt_port, box.http_port))
        pipe.recv()
        box.loss = 0.0  # or a loss at the very end would have no record after it that shows it
        pipe.recv()
        processor_s = time.process_time() - began_s
    pipe.send((box.lost, processor_s))


def measured(seconds: float, seed: int) -> Stream:
    """Return what a stream of so many seconds comes to."""
    spawn = multiprocessing.get_context("spawn")
    pipe, theirs = spawn.Pipe()
    box = spawn.Process(target=emulate, args=(theirs, seed), daemon=True)
    box.start()
    host, rdt_port, http_port = pipe.recv()
    components = wrench_components((18e3,) * 3, (250.0,) * 3, resolution_mN=4.0, resolution_mNm=0.05)
    sensor = AtiNetFt("force sensor", host, components=components, rdt_port=rdt_port, http_port=http_port)
    read, wrong = array("Q"), array("Q")

    def watch(reading: ForceReading) -> None:
        read.append(reading.sequence)
        if abs(reading.values["Fx"] - LOAD[0]) > 1e-3 or abs(reading.values["Tz"] - LOAD[5]) > 1e-3:
            wrong.append(reading.sequence)

    sensor.watch(watch)
    with sensor:
        processor_s, wall_s = time.process_time(), time.monotonic()
        time.sleep(seconds)
        processor_s, wall_s = time.process_time() - processor_s, time.monotonic() - wall_s
        pipe.send(None)
        time.sleep(SETTLE_S)
    pipe.send(None)
    dropped, box_processor_s = pipe.recv()
    box.join()
    return Stream(
        read[-1], frozenset(dropped), tuple(read), sensor.counts, not wrong, processor_s, wall_s, box_processor_s
    )


def main() -> int:
    """Measure and print; return 1 if a wanted figure is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0, help="how long the stream is read")
    parser.add_argument("--seed", type=int, default=0, help="of what is lost")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    arguments = parser.parse_args()
    stream = measured(arguments.seconds, arguments.seed)
    misses, box = stream.misses(), stream.box_processor_s / stream.wall_s
    figures = {
        "seconds": round(stream.wall_s, 1),
        "sent": stream.sent,
        "dropped": len(stream.dropped),
        "counted_as_lost": stream.counts.lost,
        "read": len(stream.read),
        "of_one_processor": round(stream.share, 4),
        "us_per_record": round(1e6 * stream.processor_s / stream.wall_s / RATE_Hz, 1),
        "box_of_one_processor": round(box, 4),
        "misses": misses,
    }
    if arguments.json:
        print(json.dumps(figures))
    else:
        print(f"{stream.wall_s:.1f} s: {stream.sent} records sent, {len(stream.dropped)} of them lost on the way")
        print(f"{len(stream.read)} readings, {stream.counts.lost} counted as lost")
        print(f"reading took {stream.share:.1%} of one processor, wanted under {MOST_PROCESSOR:.0%}; the box {box:.1%}")
        for miss in misses:
            print(f"MISSED: {miss}")
    return int(bool(misses))


if __name__ == "__main__":
    sys.exit(main())
