"""Fig. 5: how well five networks expect the contact of the coming periods, with and without either recurrence."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.config.experiment import load_experiment
from neurorobo.learning.evaluate import Data, Rates
from neurorobo.learning.phase import SupervisePhase, Unroll
from neurorobo.learning.supervise import Progress, supervise
from neurorobo.regions.values import from_numbers, to_numbers
from precision_interaction import table_one
from precision_interaction.data.insertion_speeds import InsertionSpeeds, InsertionSpeedsConfig
from precision_interaction.regions.hippocampus import Hippocampus
from precision_interaction.regions.hippocampus_config import HippocampusConfig
from precision_interaction.reproduce.row import Result, Row, Setting
from precision_interaction.teachers.contact_expectation import ContactLaw, one_period
from precision_interaction.teachers.contact_expectation_config import ContactLawConfig

if TYPE_CHECKING:
    pass

CLOCK = Clock({"control": 10**9, "radial": 10**9}, spike_step_ns=10**6, window=50)
FEEDBACK = {"mean_feedback": "mean", "variance_feedback": "variance"}

TRAINED_PERIODS, PERIODS = 3, 5
SPEEDS_UM_S = torch.linspace(0.0, table_one.MAX_SPEED_UM_S, 401)
SHOWN = slice(None, None, 8)  # of these speeds, in the picture
SEEDS = range(5)
LOOK_EVERY = 100  # steps of training


@dataclass(frozen=True)
class Network:
    """One of the five: its recurrences, what is not trained, and the paper's errors for one to three periods."""

    recurrence: Literal["trained", "fixed", "none"]
    outer: bool
    paper: tuple[float, float, float]
    freeze: tuple[str, ...] = ()


DOUBLE = "RSNU, feedback"
NETWORKS = {
    "feedforward, feedback": Network("none", True, (14.3, 54, 81)),
    "liquid state machine": Network("fixed", False, (4.0, 20.7, 39.5), freeze=("input",)),
    "RSNU": Network("trained", False, (2.2, 60.3, 65.9)),
    "liquid state machine, feedback": Network("fixed", True, (5.2, 11.2, 23.3), freeze=("input",)),
    DOUBLE: Network("trained", True, (3.8, 4.9, 7.3)),
}

FALLING, EXAMPLE, WIDE, LONG = "falling rate", "example", "example, wide", "ours"
FEW = f"{LONG}, 11 speeds"


def _phase(windows: int, steps: int, learning_rate: float, schedule: str, batch: int) -> SupervisePhase:
    """Return a phase that looks ``windows`` periods ahead (Eq. 9)."""
    return SupervisePhase.model_validate(
        {
            "region": "hippocampus",
            "teacher": "precision.law",
            "data": "precision.insertion_speeds",
            "loss": {"mean": "1 mN", "variance": "1 mN^2"},
            "unroll": {"windows": windows, "feedback": FEEDBACK, "discount": table_one.GAMMA_H},
            "steps": steps,
            "batch": batch,
            "learning_rate": learning_rate,
            "schedule": schedule,
            "precision": "bf16",
        }
    )


LONG_COURSE = [
    _phase(1, 100, 0.05, "constant", 32),
    _phase(2, 100, 0.05, "constant", 32),
    _phase(3, 2400, 0.05, "cosine", 32),
]
COURSES = {
    # Sec. VI-A: a horizon of n starts from what one of n - 1 has learnt, at a lower rate; the rest is not printed.
    FALLING: [_phase(n, 500, rate, "constant", 32) for n, rate in ((1, 0.05), (2, 0.02), (3, 0.008))],
    LONG: LONG_COURSE,
    FEW: LONG_COURSE,
}
SURROGATE_WIDTH = {FALLING: 1.0, EXAMPLE: 0.25, WIDE: 1.0, LONG: 0.25, FEW: 0.25}


@dataclass(frozen=True)
class Case:
    """A network, the course that trains it, and the seed of its first weights and of its data."""

    network: str
    course: str
    seed: int

    @property
    def name(self) -> str:
        """The name of the cell."""
        return f"{self.network}; {self.course}; seed {self.seed}"


class FewSpeeds:
    """Training data of 11 speeds, so that those between them are new."""

    def draw(self, batch: int, generator: torch.Generator) -> dict[str, Tensor]:
        """Return speed (um/s), (batch, 1), each speed as often as any other, or once more."""
        speeds_um_s = torch.linspace(0.0, table_one.MAX_SPEED_UM_S, 11)
        return {"speed": speeds_um_s[torch.arange(batch) % 11].unsqueeze(1)}


class Fig5(Row):
    """Root mean square errors of the expectation, for one to five periods ahead."""

    name: ClassVar[str] = "fig5"
    bystanders: ClassVar[frozenset[str]] = frozenset({"neurorobo.experiment.rollout"})

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return a cell for each network, course and training seed."""
        return [case.name for case in cases(setting)]

    def words(self, setting: Setting) -> Sequence[str]:
        """Return the phases of the example's training, which is one of the courses."""
        return [phase.model_dump_json() for phase in _course(EXAMPLE, setting)]

    def measure(self, cell: str, setting: Setting) -> Result:
        """Train one network and compare it with the law; only the times differ from run to run."""
        (case,) = (case for case in cases(setting) if case.name == cell)
        network, phases = NETWORKS[case.network], _course(case.course, setting)
        region = build(network, case.seed, SURROGATE_WIDTH[case.course])
        data: Data = FewSpeeds() if case.course == FEW else InsertionSpeeds(InsertionSpeedsConfig(), CLOCK)
        curve = Curve(region, 1 if setting.quick else LOOK_EVERY)
        train(region, phases, data, case.seed, network.freeze, curve)
        expected, rates = look_ahead(region, SPEEDS_UM_S, PERIODS)
        law = law_ahead(SPEEDS_UM_S, PERIODS)
        found = {
            "rms": rms(expected - law).tolist(),
            "rms_in_range": rms(expected - law, sayable(region, law)).tolist(),
            "rates": rates,
            "steps": curve.steps,
            "curve": curve.points,
        }
        if case.seed == SEEDS[0]:
            found["expected"] = np.round(expected[:TRAINED_PERIODS, SHOWN].tolist(), 2).tolist()
        return found


def cases(setting: Setting) -> list[Case]:
    """Return what is trained: all networks by two courses, and the one with both recurrences by three more."""
    seeds = SEEDS[:1] if setting.quick else SEEDS
    pairs = [(network, course) for course in (FALLING, LONG) for network in NETWORKS]
    pairs += [(DOUBLE, course) for course in (EXAMPLE, WIDE, FEW)]
    return [Case(network, course, seed) for seed in seeds for network, course in pairs]


def _course(name: str, setting: Setting) -> list[SupervisePhase]:
    """Return the phases of a course."""
    if name in (EXAMPLE, WIDE):
        experiment = load_experiment(setting.examples / "peg_in_hole.yaml")
        phases = [
            phase for phase in experiment.train if isinstance(phase, SupervisePhase) and phase.region == "hippocampus"
        ]
    else:
        phases = COURSES[name]
    return [phase.model_copy(update={"steps": 2}) for phase in phases] if setting.quick else phases


def build(network: Network, seed: int, surrogate_width: float = 1.0) -> Hippocampus:
    """Return a network with fresh weights."""
    config = HippocampusConfig(recurrence=network.recurrence, outer=network.outer, surrogate_width=surrogate_width)
    return Hippocampus(config, CLOCK, torch.Generator().manual_seed(seed))


class Curve:
    """Follows a training: ``points`` are steps, processor seconds, and the errors for one to three periods."""

    def __init__(self, region: Hippocampus, every: int) -> None:
        """Look every ``every`` steps."""
        self.points: list[list[float]] = []
        self.steps = 0
        self._region = region
        self._every = every
        self._looking_s = 0.0
        self._started_s = time.process_time()

    def __call__(self, progress: Progress) -> None:
        """Note where the training is; the time that this takes does not count."""
        self.steps += 1
        if self.steps % self._every:
            return
        began_s = time.process_time()
        expected, _ = look_ahead(self._region, SPEEDS_UM_S, TRAINED_PERIODS)
        errors = rms(expected - law_ahead(SPEEDS_UM_S, TRAINED_PERIODS)).mean(1)
        trained_s = began_s - self._started_s - self._looking_s
        self.points.append([self.steps, round(trained_s, 2), *np.round(errors.tolist(), 3).tolist()])
        self._looking_s += time.process_time() - began_s


def train(
    region: Hippocampus,
    phases: Sequence[SupervisePhase],
    data: Data,
    seed: int,
    freeze: tuple[str, ...],
    report: Callable[[Progress], None],
) -> None:
    """Train through all phases; without feedback every horizon is one period, as the network sees no further."""
    teacher = ContactLaw(ContactLawConfig(), CLOCK, torch.Generator())
    for number, phase in enumerate(phases):
        unroll = phase.unroll if region.config.outer else Unroll(windows=1)
        if unroll.windows == 1:
            unroll = Unroll(windows=1)
        generator = torch.Generator().manual_seed(1000 * seed + number)
        supervise(
            region,
            teacher,
            data,
            phase.model_copy(update={"unroll": unroll, "freeze": freeze}),
            generator,
            report=report,
        )


@torch.no_grad()
def look_ahead(region: Hippocampus, speed_um_s: Tensor, periods: int) -> tuple[Tensor, dict[str, float]]:
    """Return what a network expects of speeds (batch,), (periods, batch, 4), and the firing rate of each layer.

    The speed stays, and so does the state; the outputs of a period are the feedback of the next, if there is one.
    """
    batch, steps = len(speed_um_s), CLOCK.window
    state, rates = region.init_state(batch), Rates()
    inputs = {}
    for name, port in region.input_ports.items():
        value = speed_um_s.unsqueeze(1) if name == "speed" else torch.zeros(batch, port.width)
        inputs[name] = from_numbers(value, port.code, steps, ())
    expected = []
    for _ in range(periods):
        outputs, state = region.step(inputs, state, rates)
        inputs |= {target: outputs[source] for target, source in FEEDBACK.items() if target in inputs}
        numbers = [to_numbers(outputs[name], port.code) for name, port in region.output_ports.items()]
        expected.append(torch.cat(numbers, dim=1))
    return torch.stack(expected), rates.by_layer()


def law_ahead(speed_um_s: Tensor, periods: int) -> Tensor:
    """Return the proportional law of 1, 2, ... periods for speeds (batch,), (periods, batch, 4) (Eq. 35)."""
    one = torch.cat(one_period(speed_um_s.unsqueeze(1), period_s=CLOCK.seconds("radial")), dim=1)
    return torch.arange(1, periods + 1).view(-1, 1, 1) * one


def rms(errors: Tensor, counts: Tensor | None = None) -> Tensor:
    """Return the root mean square over speeds, (periods, 4), of errors (periods, batch, 4) and of those that count."""
    weight = torch.ones_like(errors) if counts is None else counts.to(errors)
    return ((errors.square() * weight).sum(1) / weight.sum(1)).sqrt()


def sayable(region: Hippocampus, law: Tensor) -> Tensor:
    """Return where the codes of the outputs can say the law, (periods, batch, 4)."""
    codes = [port.code for port in region.output_ports.values() for _ in range(port.width)]
    return law <= torch.tensor([code.hi for code in codes if code is not None])
