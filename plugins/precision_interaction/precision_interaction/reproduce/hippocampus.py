"""Fig. 5: how well five networks expect the contact of the coming periods, with and without either recurrence."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
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
from precision_interaction.reproduce.row import Picture, Presentation, Result, Row, Setting, Table, Wanted
from precision_interaction.reproduce.statistics import cell as with_interval
from precision_interaction.teachers.contact_expectation import ContactLaw, one_period
from precision_interaction.teachers.contact_expectation_config import ContactLawConfig

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CLOCK = Clock({"control": 10**9, "radial": 10**9}, spike_step_ns=10**6, window=50)
FEEDBACK = {"mean_feedback": "mean", "variance_feedback": "variance"}
PARAMETERS = ("mean x, mN", "mean y, mN", "variance x, mN²", "variance y, mN²")
TRAINED_PERIODS, PERIODS = 3, 5
SPEEDS_UM_S = torch.linspace(0.0, table_one.MAX_SPEED_UM_S, 401)
SHOWN = slice(None, None, 8)  # of these speeds, in the picture
SEEDS = range(5)
LOOK_EVERY = 100  # steps of training
WANTED, AIM = (2.5, 2.8, 3.1), (1.2, 1.6, 2.0)


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

FALLING, EXAMPLE, NARROW, LONG = "falling rate", "example", "example, narrow", "ours"
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
SURROGATE_WIDTH = {FALLING: 1.0, EXAMPLE: 1.0, NARROW: 0.25, LONG: 0.25, FEW: 0.25}

RANGE = "360 mN and 360 mN²"
FIG5_CAPTION = (
    "Fig. 5 with our networks: what each expects (dots, first training seed) and the law (lines) for n = 1 (red), 2 "
    f"(blue) and 3 (green) periods, course `{LONG}`. Right: errors over all seeds with their standard deviation; grey "
    "lines are the paper's."
)
AHEAD_CAPTION = (
    "Error against the number of periods, where the codes can say the law: mean and span over the seeds, course "
    f"`{LONG}`. Crosses: the paper. Right of the dashed line nothing was trained."
)
LEARNING_CAPTION = (
    f"The {DOUBLE}: errors while it trains, on one core, every seed of four courses. Dashed: wanted; dotted: the aim."
)


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
    title: ClassVar[str] = "Five networks expect the contact"
    paper: ClassVar[str] = "Fig. 5"
    minutes: ClassVar[float] = 40

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return a cell for each network, course and training seed."""
        return [case.name for case in _cases(setting)]

    def files(self, setting: Setting) -> Sequence[Path]:
        """Return the example whose training is one of the courses."""
        return [setting.examples / "peg_in_hole.yaml"]

    def measure(self, cell: str, setting: Setting) -> Result:
        """Train one network and compare it with the law; only the times differ from run to run."""
        (case,) = (case for case in _cases(setting) if case.name == cell)
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

    def present(self, results: Mapping[str, Result], setting: Setting) -> Presentation:
        """Show the errors of the networks, of the courses, and what is beyond the training."""
        seeds = sorted({case.seed for case in _cases(setting)})

        def of(network: str, course: str) -> list[Result]:
            return [results[Case(network, course, seed).name] for seed in seeds]

        wanted = Wanted()
        double = np.array([_means(found)[:TRAINED_PERIODS] for found in of(DOUBLE, LONG)])
        for n, (found, worst, most, aim) in enumerate(zip(double.mean(0), double.max(0), WANTED, AIM, strict=True), 1):
            wanted.at_most(f"{DOUBLE}, {LONG}: error for n = {n}", found, most)
            wanted.at_most(f"{DOUBLE}, {LONG}: error of the worst seed for n = {n}", worst, most)
            wanted.at_most(f"{DOUBLE}, {LONG}: error for n = {n}, aim", found, aim)
        for n in range(TRAINED_PERIODS):
            paper = sorted(NETWORKS, key=lambda name: NETWORKS[name].paper[n])
            for course in (LONG, FALLING):
                ours = sorted(NETWORKS, key=lambda name: _mean(of(name, course), n))
                what = f"{course}: the order for n = {n + 1} is {' < '.join(ours)}, in the paper {' < '.join(paper)}"
                wanted.that(what, ours == paper)
        tables = [
            _networks_table(of),
            _courses_table(of),
            _beyond_table(of),
            _seeds_table(of, seeds),
        ]
        pictures = [
            Picture("fig5", FIG5_CAPTION, _fits({name: of(name, LONG) for name in NETWORKS}), (9.0, 9.0)),
            Picture("fig5_ahead", AHEAD_CAPTION, _ahead({name: of(name, LONG) for name in NETWORKS}), (7.0, 3.6)),
            Picture(
                "fig5_learning",
                LEARNING_CAPTION,
                _learning({course: of(DOUBLE, course) for course in (FALLING, EXAMPLE, NARROW, LONG)}),
                (7.5, 3.2),
            ),
        ]
        return Presentation(_words(of), tables, pictures, wanted.misses)


def _cases(setting: Setting) -> list[Case]:
    """Return what is trained: all networks by two courses, and the one with both recurrences by three more."""
    seeds = SEEDS[:1] if setting.quick else SEEDS
    pairs = [(network, course) for course in (FALLING, LONG) for network in NETWORKS]
    pairs += [(DOUBLE, course) for course in (EXAMPLE, NARROW, FEW)]
    return [Case(network, course, seed) for seed in seeds for network, course in pairs]


def _course(name: str, setting: Setting) -> list[SupervisePhase]:
    """Return the phases of a course."""
    if name in (EXAMPLE, NARROW):
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


Of = Callable[[str, str], Sequence[Result]]
"""The results of all seeds, of a network and a course."""


def _means(found: Result, key: str = "rms") -> list[float]:
    """Return the error, averaged over the four parameters, for each number of periods."""
    return [float(np.mean(errors)) for errors in found[key]]


def _mean(found: Sequence[Result], n: int) -> float:
    return float(np.mean([_means(one)[n] for one in found]))


def _line(found: Sequence[Result], key: str = "rms", periods: slice = slice(TRAINED_PERIODS)) -> list[str]:
    """Return the error for each number of periods, over seeds."""
    return [with_interval(column) for column in np.transpose([_means(one, key)[periods] for one in found])]


def _words(of: Of) -> list[str]:
    """Return what was done, and why the order is what it is; figures come from the results."""

    def errors(network: str, course: str = LONG) -> str:
        return " / ".join(f"{_mean(of(network, course), n):.1f}" for n in range(TRAINED_PERIODS))

    outer = [name for name, network in NETWORKS.items() if network.outer]
    falling, ours = (", ".join(f"{errors(name, course)} (`{name}`)" for name in outer) for course in (FALLING, LONG))
    missing = rms(law_ahead(SPEEDS_UM_S, 1)).mean().item()
    return [
        "Each network reads the speed, the same in every window, and its state goes on from one window to the next; "
        "with feedback the spikes of its outputs are inputs of the next window. What is wanted of window n is n times "
        "the law (Eq. 35). All have the same neurons, codes, data and number of steps. In the liquid state machines "
        "only the readout is trained; without feedback a network is trained for n = 1 and asked for the later windows "
        "as it is. Seeds are those of the first weights and of the data.",
        "Why this order. Without feedback nothing tells a network which window it is in but the potentials of its "
        "hidden neurons, of which a fifth is left after a step and nothing after a window. So it says the same every "
        f"time, and what it lacks for n = 2 and 3 is the contact of one and two periods, {missing:.0f} and "
        f"{2 * missing:.0f} over all speeds, whether its synapses are trained (`RSNU`: {errors('RSNU')}) or not "
        f"(`liquid state machine`: {errors('liquid state machine')}); the order of these two for n = 2 and 3 means "
        "little. The paper's two differ there; it does not say how it asked them for later windows.",
        "With feedback a network adds one period to what it hears, and each window starts from the error of the one "
        f"before. The course `{FALLING}` gets to {falling}; the course `{LONG}` to {ours}. So what the paper lays on "
        "the inner recurrence is for the most part a matter of training: the law is linear, inputs and outputs are "
        "rates, and a trained hidden layer that hears both needs no memory within a window. We found no reason in the "
        "task for the 14.3 that the paper's feedforward network has at n = 1, and did not make ours worse for it.",
    ]


def _networks_table(of: Of) -> Table:
    heads = ["network", "paper", *(f"ours, n = {n}" for n in (1, 2, 3)), *(f"{FALLING}, n = {n}" for n in (1, 2, 3))]
    lines = [
        [name, " / ".join(f"{error:g}" for error in network.paper), *_line(of(name, LONG)), *_line(of(name, FALLING))]
        for name, network in NETWORKS.items()
    ]
    return Table(
        heads,
        lines,
        "Root mean square error over speeds of 0 to 100 µm/s, averaged over the four parameters (means in mN, "
        f"variances in mN²): means over training seeds with 95 % intervals from a bootstrap. *Ours* is the "
        f"course `{LONG}`; `{FALLING}` is the paper's, as far as it is printed.",
    )


def _courses_table(of: Of) -> Table:
    heads = ["course", "surrogate width", "steps", "minutes", "n = 1", "n = 2", "n = 3", "wanted after", "aim after"]
    lines = []
    for course in (FALLING, EXAMPLE, NARROW, LONG):
        found = of(DOUBLE, course)
        minutes = [one["curve"][-1][1] / 60 for one in found]
        reached = [_reached([one["curve"] for one in found], limits) for limits in (WANTED, AIM)]
        width, steps = f"{SURROGATE_WIDTH[course]:g}", str(found[0]["steps"])
        lines.append([course, width, steps, f"{np.mean(minutes):.1f}", *_line(found), *reached])
    figures = [" / ".join(map(str, limits)) for limits in (WANTED, AIM)]
    return Table(
        heads,
        lines,
        f"The {DOUBLE}, by course. Minutes and seconds are processor time of training, on one core. "
        f"*Wanted* is {figures[0]} for n = 1, 2, 3, the *aim* {figures[1]}: when all three were first met, looking "
        f"every {LOOK_EVERY} steps; medians over the seeds that met them.",
    )


def _reached(curves: Sequence[Sequence[Sequence[float]]], limits: Sequence[float]) -> str:
    """Return after how many steps and seconds a training first kept all limits, and how many did."""
    first = [next((p for p in curve if all(np.array(p[2:]) <= limits)), None) for curve in curves]
    met = [point for point in first if point is not None]
    if not met:
        return f"not (0 of {len(curves)} seeds)"
    steps, seconds = np.median([point[:2] for point in met], axis=0)
    return f"{steps:.0f} steps, {seconds:.0f} s ({len(met)} of {len(curves)} seeds)"


def _beyond_table(of: Of) -> Table:
    beyond = slice(TRAINED_PERIODS, PERIODS)
    heads = ["network", *(f"n = {n}" for n in range(1, PERIODS + 1)), "n = 4, in range", "n = 5, in range"]
    pairs = [*((name, LONG) for name in NETWORKS), (DOUBLE, FEW)]
    lines = [
        [
            name if course == LONG else f"{name}, 11 speeds",
            *_line(of(name, course), periods=slice(PERIODS)),
            *_line(of(name, course), "rms_in_range", beyond),
        ]
        for name, course in pairs
    ]
    return Table(
        heads,
        lines,
        f"Beyond the training: n = 4 and 5 are past every trained horizon, and part of their law is past the {RANGE} "
        "that the codes of the outputs can say; *in range* leaves that part out. A network has never been fed "
        "back more than the law of two periods, and says too little when it is. The last line was trained at 0, 10, "
        "..., 100 µm/s only and is tested at all speeds between.",
    )


def _seeds_table(of: Of, seeds: Sequence[int]) -> Table:
    pairs = [(name, course) for course in (LONG, FALLING) for name in NETWORKS]
    pairs += [(DOUBLE, course) for course in (EXAMPLE, NARROW, FEW)]
    lines = [
        [
            name,
            course,
            *(" / ".join(f"{error:.1f}" for error in _means(one)[:TRAINED_PERIODS]) for one in of(name, course)),
        ]
        for name, course in pairs
    ]
    return Table(["network", "course", *(f"seed {seed}" for seed in seeds)], lines, "Every seed, n = 1 / 2 / 3.")


def _fits(results: Mapping[str, Sequence[Result]]) -> Callable[["Figure"], None]:
    """Return what draws the fits of the first seed, and the errors of all, as Fig. 5 does."""

    def draw(figure: "Figure") -> None:
        speeds_um_s = SPEEDS_UM_S[SHOWN].numpy()
        law = law_ahead(SPEEDS_UM_S[SHOWN], TRAINED_PERIODS).numpy()
        panels = figure.subplots(len(results), len(PARAMETERS) + 1)
        colours = ("#c03a4b", "#1f6fb4", "#3a9a4a")  # the paper's: red, blue and green
        for row, (name, found) in zip(panels, results.items(), strict=True):
            expected = np.array(found[0]["expected"])
            for column, panel in enumerate(row[:-1]):
                for n, colour in enumerate(colours):
                    panel.plot(speeds_um_s, law[n, :, column], color=colour, linewidth=0.8)
                    panel.plot(speeds_um_s, expected[n, :, column], ".", color=colour, markersize=2.5)
                panel.set_ylim(-10, 1.08 * law[-1, -1, column])
            errors = np.array([_means(one)[:TRAINED_PERIODS] for one in found])
            row[-1].bar((1, 2, 3), errors.mean(0), yerr=errors.std(0), color=colours, width=0.7, capsize=2)
            for n, error in enumerate(NETWORKS[name].paper, 1):
                row[-1].plot([n - 0.45, n + 0.45], [error, error], color="#5b6770", linewidth=1.0)
            row[-1].set_xticks((1, 2, 3))
            row[-1].set_axisbelow(True)
            row[0].set_ylabel(name.replace(", ", ",\n").replace("liquid state", "liquid state\n"))
        for panel, title in zip(panels[0], (*PARAMETERS, "RMSE, n = 1, 2, 3"), strict=True):
            panel.set_title(title, fontsize=9)
        for panel in panels[-1, :-1]:
            panel.set_xlabel("speed, µm/s")

    return draw


def _ahead(results: Mapping[str, Sequence[Result]]) -> Callable[["Figure"], None]:
    """Return what draws the error of each network against the number of periods."""

    def draw(figure: "Figure") -> None:
        panel = figure.subplots()
        for name, found in results.items():
            errors = np.array([_means(one, "rms_in_range") for one in found])
            periods = np.arange(1, errors.shape[1] + 1)
            (line,) = panel.plot(periods, errors.mean(0), "o-", markersize=4, label=name)
            panel.fill_between(periods, errors.min(0), errors.max(0), color=line.get_color(), alpha=0.2, linewidth=0)
            panel.plot(periods[:TRAINED_PERIODS], NETWORKS[name].paper, "x:", color=line.get_color(), linewidth=0.8)
        panel.axvline(TRAINED_PERIODS + 0.5, color="#5b6770", linewidth=0.8, linestyle="--")
        panel.set_yscale("log")
        _plain(panel)
        panel.set_xticks(periods)
        panel.set_xlabel("periods ahead, n")
        panel.set_ylabel("RMSE")
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))

    return draw


def _learning(results: Mapping[str, Sequence[Result]]) -> Callable[["Figure"], None]:
    """Return what draws the errors against the time of training, all seeds of each course."""

    def draw(figure: "Figure") -> None:
        panels = figure.subplots(1, TRAINED_PERIODS, sharey=True)
        for n, panel in enumerate(panels):
            for number, (course, found) in enumerate(results.items()):
                for one in found:
                    _, seconds, *errors = np.transpose(one["curve"])
                    label = course if one is found[0] else None
                    panel.plot(seconds, errors[n], color=f"C{number}", linewidth=0.7, label=label)
            panel.axhline(WANTED[n], color="#5b6770", linewidth=0.8, linestyle="--")
            panel.axhline(AIM[n], color="#5b6770", linewidth=0.8, linestyle=":")
            panel.set_yscale("log")
            panel.set_title(f"n = {n + 1}", fontsize=9)
            panel.set_xlabel("training, s")
        panels[0].set_ylabel("RMSE")
        panels[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        _plain(panels[0])

    return draw


def _plain(panel: "Axes") -> None:
    """Number a logarithmic axis as 1, 2, 5, 10, ..."""
    panel.set_yticks([1, 2, 5, 10, 20, 50, 100, 200], minor=False)
    panel.set_yticklabels(["1", "2", "5", "10", "20", "50", "100", "200"])
    panel.set_yticks([], minor=True)
