"""What becomes of a rig whose controlling process is killed (SIGKILL) at a random moment.

Run ``python benchmarks/hardware/killed_process.py`` (four minutes). The emulated rigs live in this process; another one
runs ``neurorobo run ... --arm`` on them and is killed at moments from a seeded generator, half of them while it homes
or goes to the start, half while it inserts. Nothing stops the controllers then. What holds is that a command is
absolute and bounded: at most one is under way, or on the wire, for each axis, and the axis comes to rest at its target.
Reported is how far each axis went after the death of the process, and the longest way that one command has; the search
for an origin is one command too, and the longest. Nothing here is a device. It keeps all in ``killed_process.json``
beside this file, and writes a sentence of ``docs/explanation/safety.md``.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rig_under_test import GAP_UM, PERIODS, SPEEDS, emulated, experiment, rig_config
from stage_hardware.emulators.mechanism import Mechanism

sys.path.append(str(Path(__file__).resolve().parents[1]))

from machine import machine
from page import between

FILE = Path(__file__).with_suffix(".json")
PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "safety.md"
START, END = "<!-- killed_process.json -->", "<!-- end of killed_process.json -->"
MOMENTS = 20
RESTS_WITHIN_S = 10.0
MOST_REPEATED = 3
ON_THE_WIRE_S = 0.3
"""Within which what the process has still written has come to the controller."""


class EndedEarlyError(RuntimeError):
    """A process ended before it could be killed, with what it printed."""


@dataclass(frozen=True)
class Death:
    """How far axes went after a process was killed: ``travelled_um`` by axis, ``commands`` that they obeyed since."""

    rig: str
    phase: str
    after_s: float
    travelled_um: dict[str, float]
    commands: dict[str, int]
    longest_um: float
    rests: bool

    def misses(self) -> list[str]:
        """Return what is not as wanted."""
        found = [f"{axis} obeyed {count} commands" for axis, count in self.commands.items() if count > 1]
        if not self.rests:
            found.append("something moves still")
        found += [f"{axis} went {way:.0f} um" for axis, way in self.travelled_um.items() if way > self.longest_um + 0.5]
        return found


def longest_um(rig: str, phase: str) -> float:
    """Return the longest way of one command: to an origin, to the start, or of a period."""
    if phase == "inserting":
        period_s, speed_um_s = float(PERIODS[rig].split()[0]) * 1e-3, float(SPEEDS[rig].split()[0])
        return max(25.0, period_s * speed_um_s)
    return 800.0  # a search for an origin: as far as the axis is away from it; moves to the start have 500 um at most


def killed(rig_name: str, phase: str, generator: np.random.Generator) -> Death:
    """Kill a process at a random moment of a phase, and return what the axes did."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        with emulated(rig_config(rig_name, folder)) as rig:
            path = experiment(rig_name, folder, rig)
            axes = {name: axis for stage in rig.controllers.values() for name, axis in stage.axes.items()}
            mechanisms = {name: axis.mechanism for name, axis in axes.items()}
            command = [
                sys.executable,
                "-m",
                "neurorobo.cli.main",
                "run",
                str(path),
                "--arm",
                "--out",
                str(folder / "run"),
            ]
            log_path = folder / "log"
            with log_path.open("w") as log:
                process = subprocess.Popen(command, stdout=log, stderr=log)
                try:
                    if not _comes_to(phase, rig.positions, mechanisms, process):
                        raise EndedEarlyError(log_path.read_text())
                    after_s = generator.uniform(0.0, 1.0)
                    time.sleep(after_s)
                finally:
                    process.kill()
                    process.wait()
            died_s = time.monotonic()
            before = {name: mechanism.position for name, mechanism in mechanisms.items()}
            heading = {name: mechanism.destination for name, mechanism in mechanisms.items()}
            moving = {name: heading[name] != before[name] for name in mechanisms}
            commands = {name: int(moving[name]) for name in mechanisms}
            while time.monotonic() < died_s + RESTS_WITHIN_S:
                time.sleep(0.002)
                for name, mechanism in mechanisms.items():
                    if abs((there := mechanism.destination) - heading[name]) > 1e-6:
                        heading[name], commands[name] = there, commands[name] + 1
                if time.monotonic() > died_s + ON_THE_WIRE_S and not any(one.moving for one in mechanisms.values()):
                    break
            rests = not any(mechanism.moving for mechanism in mechanisms.values())
            travelled_um = {
                name: round(abs(mechanism.position - before[name]) * axes[name].um_per_count, 2)
                for name, mechanism in mechanisms.items()
            }
    return Death(rig_name, phase, round(after_s, 3), travelled_um, commands, longest_um(rig_name, phase), rests)


def _comes_to(phase: str, positions: Any, mechanisms: dict[str, Mechanism], process: subprocess.Popen[bytes]) -> bool:
    """Wait until the process does what it is to be killed at; return False if it ends before."""
    while True:
        moves = any(mechanism.moving for mechanism in mechanisms.values())
        if moves and (phase == "starting" or (positions()["z"] > GAP_UM and mechanisms["z"].velocity > 0)):
            return True
        if process.poll() is not None:
            return False
        time.sleep(0.002)


def deaths(moments: int, seed: int) -> list[Death]:
    """Return what became of so many killed processes; one that a pause of the machine has ended before is repeated."""
    generator = np.random.default_rng(seed)
    rigs, phases = tuple(PERIODS), ("starting", "inserting")
    found: list[Death] = []
    ended_early = 0
    while len(found) < moments:
        index = len(found)
        try:
            found.append(killed(rigs[index % 2], phases[index // 2 % 2], generator))
        except EndedEarlyError as error:
            ended_early += 1
            if ended_early > MOST_REPEATED or "its last reading is" not in str(error):
                raise
            print(f"once more, as it ended before it could be killed:\n{error}", file=sys.stderr)
    return found


def sentence(content: dict[str, Any]) -> str:
    """Return what was measured in words."""
    deaths, farthest_um = content["deaths"], content["farthest_um"]
    longest_um = max(death["longest_um"] for death in deaths if death["phase"] == "inserting")
    most = max(count for death in deaths for count in death["commands"].values())
    return (
        f"Of {len(deaths)} killed processes, {sum(not death['misses'] for death in deaths)} left no more than one "
        f"command for each axis (at most {most}), which ended by itself. While inserting, no axis went on by more than "
        f"{farthest_um['inserting']:.0f} um, of {longest_um:.0f} um that one command may ask for; on the way to origin "
        f"or start, {farthest_um['starting']:.0f} um."
    )


def into_page(text: str, content: dict[str, Any]) -> str:
    """Return a page with what it says of killed processes replaced."""
    return between(text, START, END, sentence(content))


def main() -> int:
    """Kill some processes, and tell how far the axes went."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moments", type=int, default=MOMENTS, help="how many processes are killed")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--out", type=Path, default=FILE, help="where to write all")
    arguments = parser.parse_args()
    found = deaths(arguments.moments, arguments.seed)
    for death in found:
        ways = ", ".join(f"{axis} {way:6.1f} um" for axis, way in death.travelled_um.items())
        told = "; ".join(death.misses()) or "ok"
        print(f"{death.rig:12}{death.phase:11}{ways}  (one command: {death.longest_um:.0f} um at most)  {told}")
    missed = sum(bool(death.misses()) for death in found)
    largest = {
        phase: max((max(d.travelled_um.values()) for d in found if d.phase == phase), default=0.0)
        for phase in ("starting", "inserting")
    }
    print(f"{len(found)} processes killed, {missed} missed; the farthest way after death, in um: {largest}")
    content = {
        "machine": machine(),
        "farthest_um": largest,
        "deaths": [{**vars(d), "misses": d.misses()} for d in found],
    }
    arguments.out.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    if arguments.out == FILE:
        PAGE.write_text(into_page(PAGE.read_text(encoding="utf-8"), content), encoding="utf-8")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
