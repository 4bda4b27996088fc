"""How the speed of learning is shown."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from precision_interaction.reproduce.learning import REGIONS, Learning
from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted
from precision_interaction.reproduce.row import Result, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPER_GPU_HOURS = {"hippocampus": "10", "cerebellum": "8", "prefrontal_cortex": "384, with PPO"}
MOST_MINUTES = {"hippocampus": 5, "cerebellum": 15, "prefrontal_cortex": 20}
UNITS = {"mean": "mN", "variance": "mN²", "move": "µm", "residual": "mN", "speed": "µm/s", "beta": "1"}

WORDS = (
    "The phases of `examples/peg_in_hole.yaml`, from fresh weights and its seeds, each region on one core, while the "
    "other core may measure something else.",
)


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    """Show how long each region learns, how far it gets, and its errors on the way."""
    wanted = Wanted()
    lines, same = [], []
    for name in REGIONS:
        shipped = results[name]["same_as_shipped"]
        same.append(f"{shipped['same']:,} of {shipped['of']:,} in the {name.replace('_', ' ')}")
        if not setting.quick:
            wanted.that(f"{name}: not all weights are the shipped ones", shipped["same"] == shipped["of"])
        phases = results[name]["phases"]
        minutes = sum(phase["seconds"] for phase in phases) / 60
        processor = phases[-1]["curve"][-1]["seconds"] / 60
        wanted.at_most(f"minutes of the {name}", minutes, MOST_MINUTES[name])
        steps = " + ".join(str(phase["steps"]) for phase in phases)
        reached = ", ".join(f"{output} {_rms(error)} {UNITS[output]}" for output, error in phases[-1]["rms"].items())
        paper = PAPER_GPU_HOURS[name]
        lines.append(
            [f"`{name}`", paper, str(MOST_MINUTES[name]), f"{minutes:.1f}", f"{processor:.1f}", steps, reached]
        )
    table = Table(
        (
            "region",
            "paper, GPU hours",
            "wanted, minutes",
            "ours, minutes",
            "processor minutes",
            "steps",
            "rms error at the end",
        ),
        lines,
        "Training from scratch: minutes of wall time, which is what is wanted, and of processor time. Errors are those "
        "from the teacher on fresh draws of the last phase's data; of several windows, the last one's.",
    )
    words = (
        *WORDS,
        f"Rounded to the grids of the shipped weights, these entries are the same as there: {', '.join(same)}.",
    )
    picture = Picture(
        "learning",
        "Errors while the regions learn, as shares of those at the start of their first phase, by processor time. "
        "Each point is the rms over a sixtieth of a phase, of the errors that each step finds on its own batch before "
        "it learns from it: fresh draws; in the last phase of the prefrontal cortex also states that it has met by "
        "itself, which may come again, and weights with noise. Dotted: a phase begins.",
        _drawing(results),
        (9.0, 3.2),
    )
    return Presentation(words, [table], [picture], wanted.misses)


def _rms(error: list[list[float]]) -> str:
    return f"{float(np.sqrt(np.mean(np.square(error[-1])))):.3g}"


def _drawing(results: Mapping[str, Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        panels = figure.subplots(1, len(REGIONS))
        for panel, name in zip(panels, REGIONS, strict=True):
            first: dict[str, float] = {}
            colours: dict[str, str] = {}
            phases = results[name]["phases"]
            for phase in phases:
                minutes = np.array([point["seconds"] for point in phase["curve"]]) / 60
                for output in [key for key in phase["curve"][0] if key != "seconds"]:
                    errors = np.array([point[output] for point in phase["curve"]])
                    first.setdefault(output, errors[0])
                    colour = colours.setdefault(output, f"C{len(colours)}")
                    label = None if output in {line.get_label() for line in panel.lines} else output
                    panel.plot(minutes, errors / first[output], color=colour, label=label)
            for phase in phases[:-1]:
                panel.axvline(phase["curve"][-1]["seconds"] / 60, color="#5b6770", linewidth=0.8, linestyle=":")
            panel.set(yscale="log", xlabel="minutes", title=name.replace("_", " "))
            panel.legend()
        panels[0].set_ylabel("error, share of the first")

    return draw


PAGE = Page(Learning(), title="Learning from scratch", paper="Sec. VI-A", minutes=13, present=present)
