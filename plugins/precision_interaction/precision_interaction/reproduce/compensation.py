"""Cerebella for the test of Fig. 6: one is trained for each teacher, control period and number of deep nuclei."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.experiment.build import build
from neurorobo.learning.phase import OnPolicy, SupervisePhase
from neurorobo.learning.supervise import supervise
from neurorobo.regions.region import Region, State
from neurorobo.regions.values import convert
from precision_interaction import table_one
from precision_interaction.baselines.pid_tuning import (
    TEST_SPEED_UM_S,
    Controller,
    compensation_course,
    compensation_test,
    teacher_controller,
)
from precision_interaction.data.compensation_states import CompensationStatesConfig
from precision_interaction.regions.cerebellum_config import CerebellumConfig
from precision_interaction.teachers.compensators import Compensation, predictive, profile
from precision_interaction.teachers.compensators_config import PredictiveConfig, ProfileConfig
from precision_interaction.teachers.contact_expectation import one_period

TeacherName = Literal["profile", "predictive"]
COMPENSATE = {"profile": profile, "predictive": predictive}
PREPARING_SEED = 1000
"""Draws the trajectories that gains and ranges are chosen on; those of the test come from other seeds."""

MARGIN = 0.1


@dataclass(frozen=True)
class Network:
    """A cerebellum to be trained: by whom, for what control period, with how many deep nuclei, and from what seed."""

    teacher: TeacherName
    period_s: float
    nuclei: int = 8
    seed: int = 1

    @property
    def name(self) -> str:
        """The name of its cell."""
        return f"{self.teacher}, {self.period_s:g} s, {self.nuclei} nuclei, seed {self.seed}"

    @property
    def clock(self) -> Clock:
        """A clock with this radial period and the paper's window of 50 steps."""
        period_ns = round(self.period_s * 1e9)
        return Clock({"control": period_ns, "radial": period_ns}, spike_step_ns=1_000_000, window=50)


@dataclass(frozen=True)
class Effort:
    """How large networks are and how long they learn; the sizes are the paper's."""

    granule_cells: int = 4000
    purkinje_cells: int = 1600
    steps: int = 1600
    batch: int = 32


class Met(NamedTuple):
    """What a controller met and did in one period of the test, (trajectories, 2) each."""

    inputs: Mapping[str, Tensor]
    done: Compensation


def watched(controller: Controller, met: list[Met]) -> Controller:
    """Return the same controller, which notes all that it meets."""

    def control(force_mN: Tensor, state: State, mean_mN: Tensor, variance_mN2: Tensor) -> tuple[Compensation, State]:
        compensation, after = controller(force_mN, state, mean_mN, variance_mN2)
        inputs = {"force": force_mN, "velocity": state["velocity"], "mean": mean_mN, "variance": variance_mN2}
        flat = {name: value.expand_as(force_mN).reshape(-1, 2) for name, value in inputs.items()}
        met.append(Met(flat, Compensation(*(value.reshape(-1, 2) for value in compensation))))
        return compensation, after

    return control


def joined(met: Sequence[Met]) -> dict[str, Tensor]:
    """Return the inputs of all periods, (periods * trajectories, 2) by name."""
    return {name: torch.cat([each.inputs[name] for each in met]) for name in met[0].inputs}


def network_controller(region: Region) -> Controller:
    """A trained cerebellum as a controller; what its move leaves of the force is what the stiffness says."""

    def control(force_mN: Tensor, state: State, mean_mN: Tensor, variance_mN2: Tensor) -> tuple[Compensation, State]:
        inputs = {"force": force_mN, "velocity": state["velocity"], "mean": mean_mN, "variance": variance_mN2}
        said = say(region, {name: value.expand_as(force_mN).reshape(-1, 2) for name, value in inputs.items()})
        move_um, velocity_um_s = (said[name].reshape(force_mN.shape) for name in ("move", "velocity"))
        left_mN = force_mN - table_one.STIFFNESS_MN_UM * move_um
        return Compensation(move_um, left_mN, velocity_um_s), {**state, "velocity": velocity_um_s}

    return control


def held(controller: Controller, *, period_s: float) -> Controller:
    """Hold a controller to the stage's acceleration, axis by axis, as the PID controllers are."""
    change_um_s = table_one.MAX_ACCELERATION_UM_S2 / math.sqrt(2.0) * period_s

    def control(force_mN: Tensor, state: State, mean_mN: Tensor, variance_mN2: Tensor) -> tuple[Compensation, State]:
        wanted, after = controller(force_mN, state, mean_mN, variance_mN2)
        before_um_s = state["velocity"]
        velocity_um_s = torch.clamp(wanted.velocity_um_s, before_um_s - change_um_s, before_um_s + change_um_s)
        move_um = velocity_um_s * period_s
        left_mN = force_mN - table_one.STIFFNESS_MN_UM * move_um
        return Compensation(move_um, left_mN, velocity_um_s), {**after, "velocity": velocity_um_s}

    return control


@torch.no_grad()
def say(region: Region, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return what a region says to numbers (batch, width), as numbers in the units of its ports."""
    window = region.clock.window
    given = {name: convert(inputs[name], None, port.code, window, ()) for name, port in region.input_ports.items()}
    outputs, _ = region.step(given, region.init_state(len(inputs["force"])))
    return {name: convert(outputs[name], port.code, None, window, ()) for name, port in region.output_ports.items()}


def cerebellum_config(network: Network, effort: Effort) -> CerebellumConfig:
    """Return a cerebellum whose codes hold what its teacher meets and does in the test, with a margin of a tenth.

    The path of the `profile` teacher does not end with its mean velocity, so that the velocity gets neurons of its own.
    """
    met: list[Met] = []
    period_s = network.period_s
    teacher = teacher_controller(COMPENSATE[network.teacher], period_s=period_s)
    compensation_test(watched(teacher, met), torch.Generator().manual_seed(PREPARING_SEED), period_s=period_s)
    inputs = joined(met)
    done = Compensation(*(torch.cat(values) for values in zip(*(each.done for each in met), strict=True)))
    expected = one_period(torch.tensor([TEST_SPEED_UM_S]), period_s=period_s)
    most = 1.0 + 2.0 * MARGIN
    return CerebellumConfig.model_validate(
        {
            "granule_cells": effort.granule_cells,
            "purkinje_cells": effort.purkinje_cells,
            "nuclei": network.nuclei,
            "own_velocity": network.teacher == "profile",
            "force": _range("mN", inputs["force"]),
            "velocity": _range("um/s", torch.cat([inputs["velocity"], done.velocity_um_s])),
            "mean": f"0..{most * expected.mean_mN.max():.4g} mN",
            "variance": f"0..{most * expected.variance_mN2.max():.4g} mN^2",
            "move": _range("um", done.move_um),
            "residual": _range("mN", done.residual_mN),
        }
    )


def train(network: Network, effort: Effort) -> Region:
    """Return a cerebellum that has learned what its teacher does, from the network's seed.

    Half of each batch are states that it has met by itself in the test, on other trajectories than it is tested on,
    the rest are spread over the ranges of its codes.
    """
    config = cerebellum_config(network, effort)
    region: Region = build(config, network.clock, torch.Generator().manual_seed(network.seed))
    ranges = config.model_dump(mode="json", include={"force", "velocity"})
    data = CompensationStatesConfig.model_validate({"max_speed": f"{TEST_SPEED_UM_S:g} um/s", **ranges})
    # 0.05 um are 4 mN: the move counts twice, as the stage carries it out; a velocity is what moves the stage next.
    loss = {"move": "0.05 um", "residual": "8 mN"}
    if config.own_velocity:
        loss["velocity"] = f"{0.05 / network.period_s:g} um/s"
    phase = SupervisePhase(
        region="cerebellum",
        teacher=f"precision.{network.teacher}",
        data="precision.compensation_states",
        loss=loss,
        freeze=("granule",),
        on_policy=OnPolicy(share=0.5, episodes=16, every=100, keep=4),
        steps=effort.steps,
        batch=effort.batch,
        learning_rate=0.019,
        precision="bf16",
    )
    supervise(
        region,
        teacher_region(network),
        build(data, network.clock),
        phase,
        torch.Generator().manual_seed(network.seed),
        rollout=OwnTrajectories(region, network.period_s),
    )
    return region


def teacher_region(network: Network) -> Region:
    """Return the teacher of a network as a region."""
    config = ProfileConfig() if network.teacher == "profile" else PredictiveConfig()
    region: Region = build(config, network.clock, torch.Generator())
    return region


@dataclass(frozen=True)
class OwnTrajectories:
    """What a cerebellum meets by itself in the test, with its present weights: a rollout to learn from."""

    region: Region
    period_s: float

    def __call__(self, seeds: Sequence[int]) -> Mapping[str, Tensor]:
        """Run one trajectory per seed; return all inputs, (periods * trajectories, 2), as far as the codes reach."""
        met: list[Met] = []
        controller = watched(network_controller(self.region), met)
        generator = torch.Generator().manual_seed(seeds[0])
        compensation_course(controller, generator, trajectories=len(seeds), period_s=self.period_s)
        codes = {name: port.code for name, port in self.region.input_ports.items()}
        return {
            name: values if (code := codes[name]) is None else values.clamp(code.lo, code.hi)
            for name, values in joined(met).items()
        }

    def fingerprint(self) -> str:
        """Return what the trajectories depend on besides the region and the seeds."""
        return f"the cerebellum's test at {self.period_s:g} s"


def errors_mN(region: Region, teacher: Region, inputs: Mapping[str, Tensor]) -> dict[str, float]:
    """Return the rms differences from the teacher per axis: of the move, as force taken off, and of the residual."""
    said = say(region, inputs)
    with torch.no_grad():
        taught, _ = teacher.step(inputs, {})

    def rms(name: str, factor: float = 1.0) -> float:
        return factor * float((said[name] - taught[name]).square().mean().sqrt())

    return {"move": rms("move", table_one.STIFFNESS_MN_UM), "residual": rms("residual")}


def _range(unit: str, values: Tensor) -> str:
    lo, hi = float(values.min()), float(values.max())
    margin = MARGIN * (hi - lo)
    return f"{lo - margin:.4g}..{hi + margin:.4g} {unit}"
