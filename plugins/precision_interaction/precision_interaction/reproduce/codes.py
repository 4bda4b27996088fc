"""Sec. IV-A: the codes that the paper tried, as they are and as the input of the hippocampus."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

import torch

from neurorobo.clock import Clock
from neurorobo.codes import Code, GaussianReceptiveFields, Poisson, PopulationUniform, TimeToFirstSpike
from neurorobo.learning.evaluate import evaluate
from neurorobo.learning.phase import SupervisePhase
from neurorobo.learning.supervise import supervise
from neurorobo.regions import Port
from precision_interaction import table_one
from precision_interaction.data.insertion_speeds import InsertionSpeeds, InsertionSpeedsConfig
from precision_interaction.regions.hippocampus import Hippocampus
from precision_interaction.regions.hippocampus_config import HippocampusConfig
from precision_interaction.reproduce.row import Result, Row, Setting
from precision_interaction.teachers.contact_expectation import ContactLaw
from precision_interaction.teachers.contact_expectation_config import ContactLawConfig

if TYPE_CHECKING:
    pass

CODES: dict[str, type[Code]] = {
    "population uniform": PopulationUniform,
    "Poisson": Poisson,
    "time to first spike": TimeToFirstSpike,
    "Gaussian receptive fields": GaussianReceptiveFields,
}
HIGHEST_UM_S = table_one.MAX_SPEED_UM_S

NEURONS = 50
SIZES = (6, 10, 20, 50, 100, 200)
WINDOW = 50
TRAINED_SIZES = (10, NEURONS)
SEEDS = range(3)
VALUES, REPETITIONS = 256, 32
PHASE = SupervisePhase(
    region="hippocampus",
    teacher="precision.law",
    data="precision.insertion_speeds",
    loss={"mean": "1 mN", "variance": "1 mN^2"},
    steps=500,
    batch=32,
    learning_rate=0.05,
)
QUICK_STEPS = 3
TEST_SPEEDS, TEST_REPETITIONS = 64, 16


class CodedHippocampusConfig(HippocampusConfig):
    """The hippocampus whose speed comes in another code; all else is the same."""

    speed_code: str

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """The hippocampus's own ports, but for the code of the speed."""
        ports = super().inputs(clock)
        limits = self.speed_range
        return {
            **ports,
            "speed": replace(ports["speed"], code=CODES[self.speed_code](self.speed_neurons, limits.lo, limits.hi)),
        }


class Codes(Row):
    """What each code resolves and repeats, and what the hippocampus makes of it."""

    name: ClassVar[str] = "codes"

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return the codes."""
        return list(CODES)

    def measure(self, cell: str, setting: Setting) -> Result:
        """Send speeds there and back in populations of several sizes, then train a hippocampus on the code."""
        kind = CODES[cell]
        trips = [_there_and_back(kind(size, 0.0, HIGHEST_UM_S)) for size in SIZES]
        steps, seeds = (QUICK_STEPS, SEEDS[:1]) if setting.quick else (PHASE.steps, SEEDS)
        trained = {str(size): [_hippocampus(cell, size, steps, seed) for seed in seeds] for size in TRAINED_SIZES}
        return {"sizes": trips, "trained": trained}


def _there_and_back(code: Code) -> dict[str, float]:
    """Return what comes back of speeds over the range, each sent many times."""
    generator = torch.Generator().manual_seed(0)
    speed = torch.linspace(0.0, HIGHEST_UM_S, VALUES, dtype=torch.float64).unsqueeze(1)
    repetitions = REPETITIONS if code.stochastic else 2
    spikes = [code.encode(speed, WINDOW, generator) for _ in range(repetitions)]
    decoded = torch.stack([code.decode(one) for one in spikes])
    error = decoded - speed
    return {
        "neurons": code.neurons,
        "resolution_um_s": code.resolution(WINDOW),
        "rms_um_s": float(error.square().mean().sqrt()),
        "largest_um_s": float(error.abs().max()),
        "deviation_um_s": float(decoded.var(0).mean().sqrt()),
        "rate": float(torch.stack(spikes).mean()),
    }


def _hippocampus(name: str, neurons: int, steps: int, seed: int) -> dict[str, float]:
    """Train a hippocampus on a code; return its rms error, its deviation between repetitions, and its firing rate."""
    config = CodedHippocampusConfig(speed_code=name, speed_neurons=neurons)
    clock = Clock({"control": 10**9, "radial": 10**9}, 10**6, WINDOW)
    region = Hippocampus(config, clock, torch.Generator().manual_seed(seed))
    teacher = ContactLaw(ContactLawConfig(), clock, torch.Generator())
    data = InsertionSpeeds(InsertionSpeedsConfig(), clock)
    phase = PHASE.model_copy(update={"steps": steps})
    supervise(region, teacher, data, phase, torch.Generator().manual_seed(seed))
    found = evaluate(region, teacher, data, torch.Generator().manual_seed(3), outputs=PHASE.loss)
    rms = torch.cat([error.flatten() for error in found.rms.values()]).square().mean().sqrt()
    return {
        "rms": float(rms),
        "deviation": _deviation(region),
        "rate": sum(found.rates.values()) / len(found.rates),
    }


@torch.no_grad()
def _deviation(region: Hippocampus) -> float:
    """Return how far answers to the same speed are from one another."""
    generator, ports = torch.Generator().manual_seed(4), region.input_ports
    speed = torch.linspace(0.0, HIGHEST_UM_S, TEST_SPEEDS).unsqueeze(1)
    answers = []
    for _ in range(TEST_REPETITIONS):
        inputs = {
            name: port.code.encode(
                speed if name == "speed" else torch.zeros(TEST_SPEEDS, port.width), WINDOW, generator
            )
            for name, port in ports.items()
            if port.code is not None
        }
        outputs, _ = region.step(inputs, region.init_state(TEST_SPEEDS))
        answers.append(
            torch.cat([port.code.decode(outputs[name]) for name, port in region.output_ports.items() if port.code], 1)
        )
    return float(torch.stack(answers).var(0).mean().sqrt())
