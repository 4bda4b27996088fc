"""``neurorobo rig check``: connect to each device by itself, and look, while nothing moves."""

import math
import time
from itertools import pairwise
from statistics import fmean, stdev

from neurorobo.errors import NeuroroboError
from stage_hardware.errors import HardwareError
from stage_hardware.force_sensor import ForceReading
from stage_hardware.rig.commissioning.dialogue import Dialogue
from stage_hardware.rig.commissioning.record import Check, Commissioning
from stage_hardware.rig.rig_config import FORCE_SENSOR, RigConfig
from stage_hardware.stage import StageState

ASKED = 10
LISTENS_S = 2.0
RATE_MAY_DIFFER_BY = 0.05


def check(commissioning: Commissioning, dialogue: Dialogue) -> None:
    """Look at all devices, tell what is wrong with each, and note what the next steps need if nothing is.

    Raises a NeuroroboError with all faults, after all devices have had their turn.
    """
    config, faults = commissioning.config, list[str]()
    answers_after_ms: dict[str, float] = {}
    for name in config.controllers:
        try:
            answers_after_ms[name] = _controller(config, name, dialogue)
        except HardwareError as error:
            faults.append(str(error))
            dialogue.say(f"{name}: FAULT")
    try:
        sensed = _sensor(config, dialogue)
    except HardwareError as error:
        faults.append(str(error))
        dialogue.say(f"{FORCE_SENSOR}: FAULT")
    if faults:
        raise NeuroroboError("\n".join(faults))
    commissioning.record.check = Check(answers_after_ms=answers_after_ms, **sensed)
    commissioning.save()


def _controller(config: RigConfig, name: str, dialogue: Dialogue) -> float:
    """Tell how a controller and its axes are, and return its slowest answer (ms)."""
    stage, device = config.controllers[name].build(name), config.controllers[name]
    asked_ms = []
    try:
        stage.connect()
        for _ in range(ASKED):
            began_s = time.perf_counter()
            state = stage.state()
            asked_ms.append(1e3 * (time.perf_counter() - began_s))
            _refuse(name, state)
    finally:
        stage.close()
    address = f" at {device.address}" if device.address else ""
    median_ms, slowest_ms = sorted(asked_ms)[ASKED // 2], max(asked_ms)
    dialogue.say(f"{name}: {device.type}{address} answers after {median_ms:.0f} ms, at the latest {slowest_ms:.0f} ms")
    for key, axis in state.axes.items():
        switches = {"lower": axis.at_lower_limit, "upper": axis.at_upper_limit}
        at = "".join(f", at its {which} switch" for which, there in switches.items() if there)
        known = "referenced" if axis.referenced else "not referenced"
        dialogue.say(f"  {key}: {axis.position:g} {stage.axes[key].unit} by its own count, {known}{at}")
    return slowest_ms


def _refuse(name: str, state: StageState) -> None:
    if state.fault is not None:
        raise HardwareError(name, state.fault, "see to it, then check again")
    if moving := [key for key, axis in state.axes.items() if axis.moving]:
        fault = f"{', '.join(moving)} moves, and was not told to by this program"
        raise HardwareError(name, fault, "find out what moves it, stop that, then check again")


def _sensor(config: RigConfig, dialogue: Dialogue) -> dict[str, object]:
    """Tell what the sensor reports, and return what is to be noted of it."""
    sensor, readings = config.force_sensor.build(FORCE_SENSOR), list[ForceReading]()
    try:
        sensor.start()
        sensor.watch(readings.append)
        time.sleep(LISTENS_S)
        last = sensor.latest()
    finally:
        sensor.stop()
    if last.fault is not None:
        raise HardwareError(sensor.name, last.fault, "see to the sensor, then check again")
    if len(readings) < 3:
        raise HardwareError(sensor.name, f"{len(readings)} readings in {LISTENS_S:g} s", "see to its rate and network")
    if not all(math.isfinite(value) for reading in readings for value in reading.unbiased.values()):
        fault = "reports what is no number"
        raise HardwareError(sensor.name, fault, "see to its calibration and wiring, then check again")
    passed_ns = readings[-1].time_ns - readings[0].time_ns
    rate_Hz = (readings[-1].sequence - readings[0].sequence) / (passed_ns * 1e-9)
    lost = last.lost - readings[0].lost
    gap_ms = max(b.time_ns - a.time_ns for a, b in pairwise(readings)) / 1e6
    values = {name: [reading.unbiased[name] for reading in readings] for name in sensor.components}
    offset = {name: fmean(column) for name, column in values.items()}
    noise = {name: stdev(column) for name, column in values.items()}
    address = f" at {config.force_sensor.address}" if config.force_sensor.address else ""
    dialogue.say(
        f"{sensor.name}: {config.force_sensor.type}{address} sends {rate_Hz:.0f} readings a second, {lost} of "
        f"{len(readings) + lost} lost, at most {gap_ms:.0f} ms apart"
    )
    for name, component in sensor.components.items():
        dialogue.say(f"  {name}: {offset[name]:.4g} {component.unit}, noise {noise[name]:.2g} {component.unit}")
    if not math.isclose(rate_Hz, sensor.rate_Hz, rel_tol=RATE_MAY_DIFFER_BY):
        fault = f"sends {rate_Hz:.0f} readings a second, and {sensor.rate_Hz:g} are in the rig file"
        raise HardwareError(sensor.name, fault, "set the one as the other")
    for name, component in sensor.components.items():
        if abs(offset[name]) > component.largest / 2:
            fault = f"{name} stands at {offset[name]:.4g} of {component.largest:g} {component.unit} already"
            raise HardwareError(sensor.name, fault, "take the load off, or see whether the sensor is damaged")
    return {"sensor_rate_Hz": rate_Hz, "sensor_gap_ms": gap_ms, "offset": offset, "noise": noise}
