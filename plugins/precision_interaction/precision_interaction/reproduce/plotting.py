"""How all pictures look."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from precision_interaction.reproduce.row import Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#1f6fb4", "#e0762b", "#3a9a4a", "#c03a4b", "#7b5fb0", "#8a6d3b", "#5b6770", "#b58a00")
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e6e8",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "figure.constrained_layout.use": True,
    "savefig.dpi": 150,
    "svg.hashsalt": "neurorobo",  # the same picture has the same bytes
    "svg.fonttype": "none",
}


def save(picture: Picture, folder: Path) -> tuple[Path, Path]:
    """Draw a picture and write it as PNG and SVG; return both files."""
    import matplotlib
    from cycler import cycler

    matplotlib.use("agg")
    folder.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({**STYLE, "axes.prop_cycle": cycler(color=COLOURS)}):
        figure = _figure(picture.inches)
        picture.draw(figure)
        files = folder / f"{picture.name}.png", folder / f"{picture.name}.svg"
        figure.savefig(files[0])
        figure.savefig(files[1], metadata={"Date": None})
    return files


def _figure(inches: tuple[float, float]) -> "Figure":
    from matplotlib.figure import Figure

    return Figure(figsize=inches)
