"""The trajectory of a run: every number of every tick, as one Parquet table."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from torch import Tensor

from neurorobo.bodies import Array
from neurorobo.experiment.recorder import Counts, Recorder, Sample, Setting
from neurorobo.tasks.task import Flags

FILE = "trajectory.parquet"


@dataclass(frozen=True)
class _Kept:
    """What is kept of a tick while the run goes on; it becomes numbers in columns when that is over."""

    tick: int
    time_s: float
    seeds: Sequence[int]
    running: Flags
    body: Mapping[str, Mapping[str, Array | Counts]]
    outputs: Mapping[str, Mapping[str, Tensor]]

    def columns(self) -> dict[str, Array]:
        """Return the columns' parts: a row for each running episode."""
        episodes = self.running.sum()
        parts = {
            "seed": np.asarray(self.seeds)[self.running],
            "tick": np.full(episodes, self.tick),
            "time_s": np.full(episodes, self.time_s),
        }
        outputs = {
            step: {name: value.numpy() for name, value in values.items()} for step, values in self.outputs.items()
        }
        for group, values in {**self.body, **outputs}.items():
            for name, value in values.items():
                components = value[self.running].T
                for i, component in enumerate(components):
                    suffix = f".{i}" if len(components) > 1 else ""
                    parts[f"{group}.{name}{suffix}"] = component.astype(np.float64)
        return parts


class TrajectoryRecorder(Recorder):
    """Writes ``trajectory.parquet``: one row per episode and tick.

    Columns are ``seed``, ``tick``, ``time_s``, then ``body.<sensor>``, ``command.<actuator>`` and ``<step>.<port>``,
    with ``.0``, ``.1`` … where a quantity has several components; a step that did not run at a tick leaves its
    columns empty there. ``command.<actuator>.interventions`` is 1 where the command had to be changed, else 0. The
    column metadata carry the units.
    """

    def __init__(self, setting: Setting) -> None:
        """Prepare the columns' units."""
        super().__init__(setting)
        self._kept: list[_Kept] = []
        self._units: dict[str, str] = {}
        for use in setting.plan.uses():
            self._units |= {f"{use.name}.{name}": port.unit for name, port in use.outputs.items()}
        if setting.task is not None:
            body = setting.task.body
            self._units |= {f"body.{name}": sensor.unit for name, sensor in body.sensors.items()}
            self._units |= {f"command.{name}": actuator.unit for name, actuator in body.actuators.items()}

    def sample(self, sample: Sample) -> None:
        """Keep the running episodes of one tick."""
        changed = {f"{name}.interventions": count[:, None] for name, count in sample.interventions.items()}
        body: dict[str, Mapping[str, Array | Counts]] = {
            "body": {name: np.array(value) for name, value in sample.observation.items()},
            "command": {name: np.array(value) for name, value in {**sample.given, **changed}.items()},
        }
        self._kept.append(_Kept(sample.tick, sample.time_s, sample.seeds, sample.running.copy(), body, sample.outputs))

    def finish(self) -> Path | None:
        """Write the table."""
        import pyarrow
        import pyarrow.parquet

        if not self._kept:
            return None
        rows = [kept.columns() for kept in self._kept]
        names = list(dict.fromkeys(name for row in rows for name in row))
        fields, arrays = [], []
        for name in names:
            parts = [row.get(name, np.full(len(row["seed"]), np.nan)) for row in rows]
            array = pyarrow.array(np.concatenate(parts), from_pandas=True)  # NaN becomes null
            unit = self._units.get(re.sub(r"\.\d+$", "", name))
            fields.append(pyarrow.field(name, array.type, metadata={"unit": unit} if unit else None))
            arrays.append(array)
        table = pyarrow.table(arrays, schema=pyarrow.schema(fields)).sort_by(
            [("seed", "ascending"), ("tick", "ascending")]
        )
        path = self.setting.folder / FILE
        pyarrow.parquet.write_table(table, path, compression="zstd")
        return path
