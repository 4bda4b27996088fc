"""Charts as SVG, with logarithmic axes; grey on nothing, so that they can be read on light and on dark pages."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

COLOURS = ("#0a7cc4", "#e08a00", "#0a9c74", "#d0588f", "#8d6fd1", "#c2551e", "#4fa6d8", "#9a8f00")
GREY = "#7d7d7d"


@dataclass(frozen=True)
class Axis:
    """A logarithmic axis: the range of its numbers, and where they go."""

    least: float
    largest: float
    start: float
    end: float

    @classmethod
    def around(cls, numbers: Iterable[float], start: float, end: float) -> "Axis":
        """Return the axis from one power of ten to another that holds all numbers."""
        known = [number for number in numbers if number > 0]
        least, largest = math.floor(math.log10(min(known))), math.ceil(math.log10(max(known)))
        return cls(10.0**least, 10.0 ** max(largest, least + 1), start, end)

    def at(self, number: float) -> float:
        """Return the place of a number."""
        share = math.log(number / self.least) / math.log(self.largest / self.least)
        return self.start + share * (self.end - self.start)

    def decades(self) -> list[float]:
        """Return the powers of ten on the axis."""
        first, last = round(math.log10(self.least)), round(math.log10(self.largest))
        return [10.0**exponent for exponent in range(first, last + 1)]


def svg(width: float, height: float, parts: Sequence[str]) -> str:
    """Return a picture of parts."""
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
        f'font-family="sans-serif" font-size="12" fill="{GREY}">'
    )
    return "\n".join([head, *parts, "</svg>\n"])


def text(x: float, y: float, words: str, anchor: str = "start", colour: str = GREY) -> str:
    """Return words; the anchor is start, middle or end."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{escape(words)}</text>'


def line(points: Sequence[tuple[float, float]], colour: str = GREY, width: float = 1.0, dashes: str = "") -> str:
    """Return a line through points."""
    places = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
    return f'<polyline points="{places}" fill="none" stroke="{colour}" stroke-width="{width:g}"{dashed}/>'


def dot(x: float, y: float, colour: str, title: str = "", *, filled: bool = True) -> str:
    """Return a dot, with words for those who point at it."""
    inside = colour if filled else "none"
    shape = f'cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{inside}" stroke="{colour}"'
    return f"<circle {shape}><title>{escape(title)}</title></circle>"


def legend(x: float, y: float, names: Sequence[str], step: float = 120.0) -> list[str]:
    """Return names side by side, each behind a dot of its colour."""
    parts = []
    for number, name in enumerate(names):
        parts += [dot(x + step * number, y - 4, COLOURS[number]), text(x + step * number + 8, y, name)]
    return parts


def grid(x: Axis, y: Axis | None, top: float, bottom: float) -> list[str]:
    """Return the powers of ten of both axes: upright lines between top and bottom, and lines across."""
    parts = []
    for number in x.decades():
        parts += [line([(x.at(number), top), (x.at(number), bottom)], width=0.4)]
        parts += [text(x.at(number), bottom + 16, f"{number:g}", "middle")]
    if y is not None:
        for number in y.decades():
            parts += [line([(x.start, y.at(number)), (x.end, y.at(number))], width=0.4)]
            parts += [text(x.start - 6, y.at(number) + 4, f"{number:g}", "end")]
    return parts
