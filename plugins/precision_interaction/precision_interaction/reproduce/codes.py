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
NEURONS = 50
SIZES = (6, 10, 20, 50, 100, 200)
WINDOW = 50
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
    minutes: ClassVar[float] = 3

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return the codes."""
        return list(CODES)

    def measure(self, cell: str, setting: Setting) -> Result:
        """Send speeds there and back in populations of several sizes, then train a hippocampus on the code."""
        kind = CODES[cell]
        trips = [_there_and_back(kind(size, 0.0, HIGHEST_UM_S)) for size in SIZES]
        return {"sizes": trips, "hippocampus": _hippocampus(cell, QUICK_STEPS if setting.quick else PHASE.steps)}

    def present(self, results: Mapping[str, Result], setting: Setting) -> Presentation:
        """Show codes and trained networks side by side."""
        wanted = Wanted()
        ours = results["population uniform"]["hippocampus"]
        for name, found in results.items():
            others = found["hippocampus"]
            wanted.that(
                f"the uniform code is less repeatable than {name} ({ours['deviation']:.3g} and "
                f"{others['deviation']:.3g})",
                ours["deviation"] <= others["deviation"],
            )
            if name != "Poisson":
                for trip in found["sizes"]:
                    what = f"{name}, {trip['neurons']} neurons: largest error over half the stated resolution"
                    wanted.at_most(what, trip["largest_um_s"] / (trip["resolution_um_s"] / 2), 1.0 + 1e-6)
        place = SIZES.index(NEURONS)
        lines = [
            [
                name,
                f"{found['sizes'][place]['resolution_um_s']:.3f}",
                f"{found['sizes'][place]['rms_um_s']:.3f}",
                f"{found['sizes'][place]['deviation_um_s']:.3f}",
                f"{found['sizes'][place]['rate']:.3f}",
                f"{found['hippocampus']['rms']:.2f}",
                f"{found['hippocampus']['deviation']:.2f}",
                f"{found['hippocampus']['rate']:.3f}",
            ]
            for name, found in results.items()
        ]
        heads = (
            "code",
            "resolution, um/s",
            "rms error, um/s",
            "between repetitions, um/s",
            "rate",
            "hippocampus: rms error",
            "hippocampus: between repetitions",
            "hippocampus: rate",
        )
        steps = PHASE.steps if not setting.quick else QUICK_STEPS
        caption = (
            f"A speed of 0..{HIGHEST_UM_S:g} um/s in {NEURONS} neurons and {WINDOW} steps. Left: sent and read back. "
            f"Right: the same hippocampus, trained alike for {steps} steps of {PHASE.batch} on this code, one period "
            "ahead (the shipped one has had 1400): the rms error of mean (mN) and variance (mN^2) together, and the "
            "deviation of its answers between repetitions of one speed. The paper prints no figures."
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
            "Left: rms error of a speed that is sent and read back, by the number of neurons. Right: what the "
            "hippocampus makes of each code: dark, its rms error; light, its deviation between repetitions.",
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


def _hippocampus(name: str, steps: int) -> dict[str, float]:
    """Train a hippocampus on a code; return its rms error, its deviation between repetitions, and its firing rate."""
    config = CodedHippocampusConfig(speed_code=name, speed_neurons=NEURONS)
    clock = Clock({"control": 10**9, "radial": 10**9}, 10**6, WINDOW)
    region = Hippocampus(config, clock, torch.Generator().manual_seed(1))
    teacher = ContactLaw(ContactLawConfig(), clock, torch.Generator())
    data = InsertionSpeeds(InsertionSpeedsConfig(), clock)
    phase = PHASE.model_copy(update={"steps": steps})
    supervise(region, teacher, data, phase, torch.Generator().manual_seed(2))
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


def _draw(results: Mapping[str, Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        left, right = figure.subplots(1, 2)
        for number, (name, found) in enumerate(results.items()):
            trips = found["sizes"]
            left.loglog(
                [trip["neurons"] for trip in trips], [trip["rms_um_s"] for trip in trips], "o-", ms=3, label=name
            )
            right.barh(number, found["hippocampus"]["rms"], color=f"C{number}")
            right.barh(number, found["hippocampus"]["deviation"], 0.4, color="white", alpha=0.75)
        left.set_xlabel("neurons")
        left.set_ylabel("rms error, µm/s")
        left.legend(fontsize=7)
        right.set_yticks(range(len(results)), list(results))
        right.invert_yaxis()
        right.set_xlabel("error of the hippocampus, mN and mN²")

    return draw
