"""Drawing pictures, all in one style."""

from pathlib import Path

from precision_interaction.reproduce.pages.page import Picture

STYLE = Path(__file__).with_name("report.mplstyle")


def save(picture: Picture, folder: Path) -> tuple[Path, Path]:
    """Draw a picture and write it as PNG and SVG; return both files."""
    from matplotlib import style
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    with style.context(STYLE):
        figure = Figure(figsize=picture.inches)
        picture.draw(figure)
        files = folder / f"{picture.name}.png", folder / f"{picture.name}.svg"
        figure.savefig(files[0])
        figure.savefig(files[1], metadata={"Date": None})
    return files
