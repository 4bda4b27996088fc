"""Sec. IV-A: the codes that the paper tried, as they are and as the input of the hippocampus."""

from collections.abc import Callable, Mapping, Sequence
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
from precision_interaction.reproduce.row import Picture, Presentation, Result, Row, Setting, Table, Wanted
from precision_interaction.teachers.contact_expectation import ContactLaw
from precision_interaction.teachers.contact_expectation_config import ContactLawConfig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CODES: dict[str, type[Code]] = {
    "population uniform": PopulationUniform,
    "Poisson": Poisson,
    "time to first spike": TimeToFirstSpike,
    "Gaussian receptive fields": GaussianReceptiveFields,
}
HIGHEST_UM_S = table_one.MAX_SPEED_UM_S
OURS = "population uniform"
PAPERS = ("Poisson", "time to first spike")
"""The codes that the paper has tried besides."""
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
    title: ClassVar[str] = "Input codes compared"
    paper: ClassVar[str] = "Sec. IV-A"
    minutes: ClassVar[float] = 2

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

    def present(self, results: Mapping[str, Result], setting: Setting) -> Presentation:
        """Show codes and trained networks side by side."""
        wanted = Wanted()
        rms, deviation = (
            {name: _mean(found["trained"][str(NEURONS)], figure) for name, found in results.items()}
            for figure in ("rms", "deviation")
        )
        for name in PAPERS:
            for what, figures in (("accurate", rms), ("repeatable", deviation)):
                ours, others = figures[OURS], figures[name]
                wanted.that(f"{OURS} is less {what} than {name} ({ours:.3g} and {others:.3g})", ours <= others)
        for name, found in results.items():
            if name != "Poisson":  # which states the value of a spike, and not how far it is off
                for trip in found["sizes"]:
                    what = f"{name}, {trip['neurons']} neurons: largest error over half the stated resolution"
                    wanted.at_most(what, trip["largest_um_s"] / (trip["resolution_um_s"] / 2), 1.0 + 1e-6)
        place = SIZES.index(NEURONS)
        lines = []
        for name, found in results.items():
            trip, trained = found["sizes"][place], found["trained"]
            figures_of_trip = ("resolution_um_s", "rms_um_s", "deviation_um_s", "rate")
            lines.append(
                [
                    name,
                    *(f"{trip[figure]:.3f}" for figure in figures_of_trip),
                    *(_spread(trained[str(size)], "rms") for size in TRAINED_SIZES),
                    _spread(trained[str(NEURONS)], "deviation"),
                    f"{_mean(trained[str(NEURONS)], 'rate'):.3f}",
                ]
            )
        heads = (
            "code",
            "resolution, um/s",
            "rms error, um/s",
            "between repetitions, um/s",
            "rate",
            *(f"hippocampus of {size}: rms error" for size in TRAINED_SIZES),
            f"hippocampus of {NEURONS}: between repetitions",
            f"hippocampus of {NEURONS}: rate",
        )
        steps = PHASE.steps if not setting.quick else QUICK_STEPS
        caption = (
            f"A speed of 0..{HIGHEST_UM_S:g} um/s in {NEURONS} neurons and {WINDOW} steps. Left: sent and read back. "
            f"Right: the same hippocampus, trained alike for {steps} steps of {PHASE.batch} on this code, one period "
            "ahead, with so many neurons for the speed: the rms error of mean (mN) and variance (mN^2) together, and "
            "the deviation of its answers between repetitions of one speed; means of several seeds, with the least and "
            "the largest. The paper prints no figures."
        )
        sizes = Table(
            ["code", *(f"{size}" for size in SIZES)],
            [
                [name, *(f"{trip['resolution_um_s']:.3f} / {trip['rms_um_s']:.3f}" for trip in found["sizes"])]
                for name, found in results.items()
            ],
            "Stated resolution / rms error in um/s, by the number of neurons.",
        )
        words = (
            "The paper chose the uniform code for its *repeatable accuracy* over Poisson spikes and the time to first "
            "spike. Gaussian receptive fields, as later controllers of robots use them, are compared here as well: "
            "their resolution is a bound, which the error does not reach; that of Poisson spikes is the value of a "
            "spike, which their noise drowns.",
        )
        picture = Picture(
            "codes",
            "Left: rms error of a speed that is sent and read back, by the number of neurons. Right: the rms "
            f"error of a hippocampus trained on each code: dark, of {NEURONS} neurons; light, of {TRAINED_SIZES[0]}. "
            "Dots: the seeds.",
            _draw(results),
            (8.0, 3.4),
        )
        return Presentation(words, [Table(heads, lines, caption), sizes], [picture], wanted.misses)


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


def _mean(trained: Sequence[Mapping[str, float]], figure: str) -> float:
    return sum(one[figure] for one in trained) / len(trained)


def _spread(trained: Sequence[Mapping[str, float]], figure: str) -> str:
    values = [one[figure] for one in trained]
    return f"{_mean(trained, figure):.2f} ({min(values):.2f} .. {max(values):.2f})"


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


def _draw(results: Mapping[str, Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        left, right = figure.subplots(1, 2)
        for number, (name, found) in enumerate(results.items()):
            trips = found["sizes"]
            left.loglog(
                [trip["neurons"] for trip in trips], [trip["rms_um_s"] for trip in trips], "o-", ms=3, label=name
            )
            for size, height, strength in zip(TRAINED_SIZES, (-0.2, 0.2), (0.5, 1.0), strict=True):
                trained = found["trained"][str(size)]
                errors = [one["rms"] for one in trained]
                right.barh(number + height, _mean(trained, "rms"), 0.36, color=f"C{number}", alpha=strength)
                right.plot(errors, [number + height] * len(errors), ".", color="black", ms=4)
        left.set_xlabel("neurons")
        left.set_ylabel("rms error, µm/s")
        left.legend(fontsize=7)
        right.set_yticks(range(len(results)), list(results))
        right.invert_yaxis()
        right.set_xlabel("error of the hippocampus, mN and mN²")

    return draw
