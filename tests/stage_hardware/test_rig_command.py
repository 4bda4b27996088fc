"""``neurorobo emulate`` as a user calls it."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from stage_hardware.emulators.faults import Faults, RdtFaults, WireFaults
from stage_hardware.errors import ReplyTimeoutError
from stage_hardware.rig.emulate_command import emulate
from stage_hardware.rig.rig_config import load_rig

from neurorobo.errors import NeuroroboError
from neurorobo.safety.guard import Trip
from tests.stage_hardware.rigs import EXAMPLES, STAGES, WALL, registry, rig, until, written

SECONDS = 60.0
"""How long a process may take on a busy machine before a test gives it up."""


@contextmanager
def running(folder: Path, *arguments: str) -> Iterator[tuple["subprocess.Popen[str]", list[str]]]:
    """Yield the command in a process of its own and the lines that it prints, and see that it ends."""
    lines: list[str] = []
    command = [sys.executable, "-m", "neurorobo.cli.main", "emulate", *arguments]
    pipe = subprocess.PIPE
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen(command, cwd=folder, env=environment, text=True, stdout=pipe, stderr=pipe)
    assert process.stdout is not None
    reading = threading.Thread(target=lines.extend, args=(process.stdout,), daemon=True)
    reading.start()
    try:
        yield process, lines
    finally:
        process.kill()
        process.wait()
        reading.join()
        process.stdout.close()
        assert process.stderr is not None
        process.stderr.close()


def wait_for(lines: Sequence[str], text: str, process: "subprocess.Popen[str]") -> None:
    def printed() -> bool:
        assert process.poll() is None, process.stderr and process.stderr.read()
        return any(text in line for line in list(lines))

    until(printed, SECONDS)


def called(*arguments: str) -> Result:
    return CliRunner().invoke(emulate, list(arguments), catch_exceptions=False)


@pytest.mark.skipif(sys.platform == "win32", reason="a process on Windows has no SIGINT of its own")
def test_a_rig_is_driven_from_another_process_until_ctrl_c(tmp_path: Path) -> None:
    with running(tmp_path, str(EXAMPLES / "pi_venus.yaml")) as (process, lines):
        wait_for(lines, "Ctrl-C ends it", process)
        out = tmp_path / "runs" / "emulated" / "pi_venus.yaml"
        assert any("runs/emulated/pi_venus.yaml" in line for line in lines)
        config = load_rig(out, registry())
        original = load_rig(EXAMPLES / "pi_venus.yaml", registry())
        for name, controller in config.controllers.items():
            assert controller.address in "".join(lines)
            port = original.controllers[name].address
            assert controller.model_copy(update={"port": port}) == original.controllers[name]
        with config.build() as built:
            built.home(["z"])
            built.wait_until_at_rest(20)
            built.move_to({"z": -4900.0})
            assert built.wait_until_at_rest(20)["z"].position == pytest.approx(-4900.0)
            assert built.sensor.latest().valid
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGINT)  # by somebody who is impatient
        assert process.wait(SECONDS) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ""
        assert not out.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_what_is_printed_to_be_typed_next_works(tmp_path: Path) -> None:
    with running(tmp_path, str(EXAMPLES / "shot_ds102.yaml")) as (process, lines):
        wait_for(lines, "Ctrl-C ends it", process)
        (printed,) = (line for line in lines if line.startswith("neurorobo rig check "))
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        typed = [sys.executable, "-m", "neurorobo.cli.main", *printed.split()[1:]]
        told = subprocess.run(typed, cwd=tmp_path, env=environment, text=True, capture_output=True, timeout=SECONDS)
        assert (told.returncode, told.stderr) == (0, "")
        assert "next: neurorobo rig home runs/emulated/shot_ds102.yaml --limit" in told.stdout


def test_a_latch_from_before_is_told(tmp_path: Path) -> None:
    path, out = written(tmp_path, rig("pi_gcs", emulate=WALL)), tmp_path / "emulated.yaml"
    latch = load_rig(path, registry()).latch(out)
    latch.set(Trip("force", "9 N, of 3 N allowed", "look at it", "latch"))
    told = called(str(path), "--for", "10 ms", "--out", str(out)).output
    assert "it is latched: force: 9 N" in told and f"then `neurorobo rig reset {out}`" in told


@pytest.mark.parametrize("faults", [WireFaults, RdtFaults])
def test_the_page_tells_every_fault(faults: type[Faults]) -> None:
    page = (EXAMPLES.parents[1] / "docs" / "how_to" / "run_on_hardware.md").read_text(encoding="utf-8")
    assert [name for name in vars(faults()) if f"`{name}=" not in page] == []


def test_it_ends_by_itself_after_a_while(tmp_path: Path) -> None:
    out = tmp_path / "emulated.yaml"
    path = written(tmp_path, rig("pi_gcs", emulate=WALL))
    before = set(threading.enumerate())
    result = called(str(path), "--for", "50 ms", "--out", str(out))
    assert result.exit_code == 0
    assert "it ends after 0.05 s, or at Ctrl-C" in result.output
    assert result.output.endswith(f"ended; {out} is removed\n")
    assert not out.exists()
    assert set(threading.enumerate()) <= before


def test_a_fault_is_there_from_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, path = tmp_path / "emulated.yaml", written(tmp_path, rig("pi_gcs"))
    faults: list[str] = []

    def serve(*_: object) -> None:
        built = load_rig(out, registry()).build()
        with pytest.raises(ReplyTimeoutError) as error:
            built.connect()
        faults.append(error.value.device)

    monkeypatch.setattr("stage_hardware.rig.emulate_command._serve", serve)
    assert called(str(path), "--out", str(out), "--fault", "controller_0.no_reply=1").exit_code == 0
    assert faults == ["controller_0"]


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["--for", "10"], "--for 10: '10' needs a unit"),
        (["--fault", "elevator"], "--fault elevator: must be DEVICE.FAULT=VALUE, such as force_sensor.drop=10"),
        (["--fault", "elevator.deaf=true"], "there is no device `elevator`; there are: controller_0, force_sensor"),
        (["--fault", "controller_0.deef=true"], "`controller_0` has no fault `deef`; did you mean `deaf`?"),
        (["--fault", "controller_0.=1"], "no fault ``; there are: no_reply, late_reply, "),
        (["--fault", "controller_0.deaf=1"], "the value must be true or false"),
        (["--fault", "force_sensor.drop=some"], "the value must be a whole number"),
    ],
)
def test_options_that_make_no_sense_are_told(tmp_path: Path, arguments: list[str], fault: str) -> None:
    path, out = written(tmp_path, rig("pi_gcs", emulate=WALL)), tmp_path / "emulated.yaml"
    with pytest.raises(NeuroroboError) as refused:
        called(str(path), "--out", str(out), *arguments)
    assert fault in str(refused.value)
    assert not out.exists()


def test_a_file_of_the_users_is_not_written_over_and_what_a_crash_has_left_is(tmp_path: Path) -> None:
    path = written(tmp_path, rig("pi_gcs", emulate=WALL))
    with pytest.raises(NeuroroboError, match=r"exists already and was not written by `neurorobo emulate`"):
        called(str(path), "--for", "10 ms", "--out", str(path))
    assert path.exists()
    left = tmp_path / "left.yaml"
    left.write_text("# An emulated rig, written by `neurorobo emulate`; its addresses hold while that runs.\nold: 1\n")
    assert called(str(path), "--for", "10 ms", "--out", str(left)).exit_code == 0


def test_a_rig_that_no_other_process_can_reach_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, rig("pi_gcs", controllers={"it": STAGES["mock_stage"]}))
    with pytest.raises(NeuroroboError, match=r"controllers.it: stages.mock_stage is in the process that uses it"):
        called(str(path))
