"""The command ``neurorobo emulate``."""

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from neurorobo.errors import NeuroroboError, did_you_mean

if TYPE_CHECKING:
    from stage_hardware.rig.device_config import DeviceConfig
    from stage_hardware.rig.emulated_rig import EmulatedRig
    from stage_hardware.rig.rig_config import RigConfig

MARK = "# An emulated rig, written by `neurorobo emulate`; its addresses hold while that runs.\n"
LOOKS_EVERY_S = 0.1


@click.command()
@click.argument("rig", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--out",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Where to write the rig file of the emulators.  [default: runs/emulated/<name of the rig>.yaml]",
)
@click.option("--for", "how_long", metavar="TIME", help="End after this time, such as 10s; by default at Ctrl-C.")
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="DEVICE.FAULT=VALUE",
    help="Let a device fail from the start: elevator.no_reply=1 (the next reply), radial.deaf=true. May be repeated.",
)
def emulate(rig: Path, out: Path | None, how_long: str | None, faults: Sequence[str]) -> None:
    """Bring up the devices of RIG, a rig file, as emulators: on pseudo-terminals, or TCP ports where there are none.

    Their force sensor feels where their axes are, by the physics under `emulate:`. A rig file with the addresses of the
    emulators is written, for any program that takes one; it is removed when they end. No device is touched.
    """
    from neurorobo.files import write_whole
    from neurorobo.units import UnitError, parse_duration_ns
    from stage_hardware.rig.emulated_rig import EmulatedRig
    from stage_hardware.rig.rig_config import load_rig
    from stage_hardware.rig.undisturbed import undisturbed
    from stage_hardware.rig.written import refuse_to_replace

    try:
        ends_after_s = None if how_long is None else parse_duration_ns(how_long) / 1e9
    except UnitError as error:
        raise NeuroroboError(f"--for {how_long}: {error}") from error
    config = load_rig(rig)
    _refuse_unreachable(rig, config)
    out = out or Path("runs", "emulated", f"{config.name}.yaml")
    refuse_to_replace(out, MARK, "neurorobo emulate")
    with _asked_to_end() as asked, EmulatedRig(config) as emulated:
        for fault in faults:
            _switch(emulated, fault)
        content = (MARK + emulated.config.dump()).encode()
        write_whole(out, content)
        try:
            _tell(emulated.config, out, ends_after_s)
            with undisturbed():
                _serve(emulated, asked, ends_after_s)
        finally:
            _remove(out, content)
    click.echo(f"ended; {out} is removed")


def _refuse_unreachable(rig: Path, config: "RigConfig") -> None:
    devices: dict[str, DeviceConfig] = {f"controllers.{name}": stage for name, stage in config.controllers.items()}
    for name, device in {**devices, "force_sensor": config.force_sensor}.items():
        if not device.address:
            raise NeuroroboError(
                f"{rig}: {name}: {device.type} is in the process that uses it, and no other can reach it; such a rig "
                "needs no emulation: use it as it is"
            )


def _remove(out: Path, content: bytes) -> None:
    """Remove what was written, as others will soon have its addresses; not what another emulation has put there."""
    try:
        if out.read_bytes() == content:
            out.unlink()
    except OSError:
        pass  # somebody else has removed it


def _tell(config: "RigConfig", out: Path, ends_after_s: float | None) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("device", "type", "address", "axes", box=None, pad_edge=False, title_justify="left")
    for name, stage in config.controllers.items():
        table.add_row(name, stage.type, stage.address, ", ".join(stage.axes))
    table.add_row("force_sensor", config.force_sensor.type, config.force_sensor.address, "")
    click.echo(f"{config.name}, emulated: no device is touched")
    Console(soft_wrap=True).print(table)
    felt = "nothing: there is no `emulate: physics:`" if config.emulate is None else config.emulate.physics.type
    click.echo(f"the sensor feels {felt}")
    click.echo(f"rig file: {out}")
    if (refusal := config.latch(out).refusal()) is not None:
        click.echo(refusal)
    click.echo("next, in another terminal, such as:")
    click.echo(f"neurorobo rig check {out}")
    click.echo(f"neurorobo run EXPERIMENT --set body.rig={out} --arm")
    click.echo("Ctrl-C ends it" if ends_after_s is None else f"it ends after {ends_after_s:g} s, or at Ctrl-C")


@contextmanager
def _asked_to_end() -> Iterator[threading.Event]:
    """Yield what is set by Ctrl-C and by a signal to terminate, however often: neither is to end the ending."""
    asked = threading.Event()
    before = {number: signal.signal(number, lambda *_: asked.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _serve(emulated: "EmulatedRig", asked: threading.Event, ends_after_s: float | None) -> None:
    """Wait while the threads of the emulators do the work."""
    ends_s = time.monotonic() + (math.inf if ends_after_s is None else ends_after_s)
    while (left_s := ends_s - time.monotonic()) > 0 and not asked.wait(min(LOOKS_EVERY_S, left_s)):
        if emulated.fault is not None:
            raise NeuroroboError(f"the emulated rig has ended: {emulated.fault}")


def _switch(emulated: "EmulatedRig", text: str) -> None:
    """Set a fault switch that is named as ``device.fault=value``."""
    from stage_hardware.rig.rig_config import FORCE_SENSOR

    where, equals, value = text.partition("=")
    device, dot, name = where.partition(".")
    if not (equals and dot):
        raise NeuroroboError(f"--fault {text}: must be DEVICE.FAULT=VALUE, such as force_sensor.drop=10")
    devices: dict[str, Any] = {key: one.emulator.faults for key, one in emulated.controllers.items()}
    devices[FORCE_SENSOR] = emulated.box.faults
    if device not in devices:
        raise NeuroroboError(f"--fault {text}: there is no device `{device}`{did_you_mean(device, devices)}")
    switches = vars(devices[device])
    if name not in switches:
        near = did_you_mean(name, switches) if name else f"; there are: {', '.join(switches)}"
        raise NeuroroboError(f"--fault {text}: `{device}` has no fault `{name}`{near}")
    read: dict[type, tuple[Callable[[str], Any], str]] = {
        bool: ({"true": True, "false": False}.__getitem__, "true or false"),
        int: (int, "a whole number"),
        float: (float, "a number"),
    }
    convert, wanted = read[type(switches[name])]
    try:
        setattr(devices[device], name, convert(value))
    except (KeyError, ValueError):
        raise NeuroroboError(f"--fault {text}: the value must be {wanted}") from None
