"""The steps of a control period as they are written, before anything is compiled."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class StepSpec:
    """One use of a region: ``inputs`` maps input ports to references such as ``previous plan.speed``.

    ``path`` leads to the step in the document; a fault of the input ``speed`` lies at ``(*path, "speed")``.
    """

    name: str
    use: str
    state: Literal["commit", "fork", "fresh"] = "commit"
    every: str = "control"
    inputs: Mapping[str, str] = field(default_factory=dict, hash=False)
    path: tuple[str | int, ...] = ()


@dataclass(frozen=True)
class RepeatSpec:
    """Steps that run ``count`` times in a row; ``path`` leads to the block in the document."""

    count: int
    steps: tuple[StepSpec, ...]
    path: tuple[str | int, ...] = ()
