"""The trajectory of a run: every number of every tick, as one Parquet table."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from neurorobo.bodies import Array
from neurorobo.experiment.recorder import Counts, Recorder, Sample, Setting

FILE = "trajectory.parquet"


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
        self._rows: list[dict[str, Array]] = []
        self._units: dict[str, str] = {}
        for use in setting.plan.uses():
            self._units |= {f"{use.name}.{name}": port.unit for name, port in use.outputs.items()}
        if setting.task is not None:
            body = setting.task.body
            self._units |= {f"body.{name}": sensor.unit for name, sensor in body.sensors.items()}
            self._units |= {f"command.{name}": actuator.unit for name, actuator in body.actuators.items()}

    def sample(self, sample: Sample) -> None:
        """Keep the running episodes of one tick."""
        running = sample.running
        row = {
            "seed": np.asarray(sample.seeds)[running],
            "tick": np.full(running.sum(), sample.tick),
            "time_s": np.full(running.sum(), sample.time_s),
        }
        changed = {f"{name}.interventions": count[:, None] for name, count in sample.interventions.items()}
        groups: dict[str, Mapping[str, Array | Counts]] = {
            "body": sample.observation,
            "command": {**sample.given, **changed},
        }
        groups |= {
            step: {name: value.numpy() for name, value in outputs.items()} for step, outputs in sample.outputs.items()
        }
        for group, values in groups.items():
            for name, value in values.items():
                columns = value[running].T
                for i, column in enumerate(columns):
                    suffix = f".{i}" if len(columns) > 1 else ""
                    row[f"{group}.{name}{suffix}"] = column.astype(np.float64)
        self._rows.append(row)

    def finish(self) -> Path | None:
        """Write the table."""
        import pyarrow
        import pyarrow.parquet

        if not self._rows:
            return None
        names = list(dict.fromkeys(name for row in self._rows for name in row))
        fields, arrays = [], []
        for name in names:
            parts = [row.get(name, np.full(len(row["seed"]), np.nan)) for row in self._rows]
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
