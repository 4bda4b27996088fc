"""The scene of an insertion: peg and hole in three dimensions."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from neurorobo.experiment.recorder import Setting
from neurorobo.views.recording import TIMELINES, Episode
from precision_interaction.rig.insertion_body import InsertionBody

if TYPE_CHECKING:
    from rerun import Mesh3D, RecordingStream
    from rerun.blueprint import View

# Peg and hole are hollow: 4 mm and 4.1 mm across, with walls of 50 um (Sec. VI-B). The hole's depth is not stated.
PEG_RADIUS_MM = 2.0
PEG_LENGTH_MM = 4.0
HOLE_RADIUS_MM = 2.05
HOLE_LENGTH_MM = 3.0
WALL_MM = 0.05

EXAGGERATION = 20.0
"""Radial motion is some tens of micrometres; it is drawn so many times as large."""

ARROW_MM_MN = PEG_RADIUS_MM / 50.0
"""The length of the force arrow: 50 mN reach from the peg's axis to its wall."""

VIEWER_ANGLE = -np.pi / 4
OPENING_ANGLE = 0.4 * np.pi
"""The hole is cut open by this angle where it faces the viewer."""

PEG_COLOR = (125, 170, 225)
HOLE_COLOR = (205, 165, 105)
FORCE_COLOR = (235, 70, 60)
END_COLOR = (90, 200, 110)
WAY_COLOR = (240, 220, 90)
AXES_COLOR = (170, 170, 170)


class InsertionScene:
    """Draws the peg as it travels into the hole and is moved sideways, and the radial force on it.

    Seen from the hole; lengths are in mm, z points out of the hole and is 0 at its mouth.
    """

    def __init__(self, setting: Setting) -> None:
        assert setting.task is not None and isinstance(setting.task.body, InsertionBody)
        config = setting.task.body.config
        self._gap_um = config.gap
        self._end_mm = (config.length - config.gap) / 1000.0
        self.legend = (
            "**Scene**: a thin-walled peg (blue) enters a hole (brown, cut open), both about 4 mm across, until its "
            f"tip reaches the green ring, {self._end_mm:g} mm deep. Red arrow: the radial force on the peg; as long as "
            "the peg's radius it is 50 mN. Yellow line: the way of a point of the tip. Radial motion is drawn "
            f"**{EXAGGERATION:.0f} times** as large as it is, so the parts seem to overlap."
        )

    def log(self, stream: "RecordingStream", episode: Episode) -> None:
        """Log what stands still, and the peg's place, way and force at every reading of the sensors."""
        import rerun as rr

        peg = _tube(PEG_RADIUS_MM, 0.0, PEG_LENGTH_MM, PEG_COLOR)
        hole = _tube(HOLE_RADIUS_MM, -HOLE_LENGTH_MM, 0.0, HOLE_COLOR, OPENING_ANGLE)
        around_mm = HOLE_RADIUS_MM * _directions(np.linspace(0.0, 2.0 * np.pi, 73))
        ring = np.column_stack([around_mm, np.full(len(around_mm), -self._end_mm)])
        axes = rr.Arrows3D(
            origins=[[0.0, 0.0, -HOLE_LENGTH_MM]] * 2,
            vectors=[[1.5, 0.0, 0.0], [0.0, 1.5, 0.0]],
            labels=["x", "y"],
            colors=AXES_COLOR,
            radii=0.03,
        )
        stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        stream.log("scene/hole", hole, static=True)
        stream.log("scene/hole/end", rr.LineStrips3D([ring], colors=END_COLOR, radii=0.04), static=True)
        stream.log("scene/hole/axes", axes, static=True)
        stream.log("scene/peg", peg, static=True)
        force_style = rr.Arrows3D.from_fields(colors=FORCE_COLOR, radii=0.06, show_labels=True)
        stream.log("scene/peg/force", force_style, static=True)
        stream.log("scene/way", rr.LineStrips3D.from_fields(colors=WAY_COLOR, radii=0.03), static=True)

        travel, stage, force = (episode.signals[f"body/{name}"] for name in ("travel", "stage", "force"))
        tip_mm = np.column_stack([EXAGGERATION * stage.values, self._gap_um - travel.values]) / 1000.0
        arrow_mm = np.column_stack([ARROW_MM_MN * force.values, np.zeros(len(force.ticks))])
        labels = [f"{norm:.0f} mN" for norm in np.linalg.norm(force.values, axis=1)]
        point_mm = tip_mm + np.append(PEG_RADIUS_MM * _directions(VIEWER_ANGLE), 0.0)
        before_mm = np.concatenate([point_mm[:1], point_mm[:-1]])
        indexes = episode.indexes(travel.ticks)
        stream.send_columns("scene/peg", indexes, rr.Transform3D.columns(translation=tip_mm))
        origins = np.tile([0.0, 0.0, PEG_LENGTH_MM], (len(force.ticks), 1))
        arrows = rr.Arrows3D.columns(origins=origins, vectors=arrow_mm, labels=labels)
        stream.send_columns("scene/peg/force", indexes, arrows)
        way = rr.LineStrips3D.columns(strips=np.stack([before_mm, point_mm], axis=1))
        stream.send_columns("scene/way", indexes, way)

    def view(self) -> "View":
        """Show the scene from the open side of the hole, with the way up to the moment."""
        import rerun as rr
        import rerun.blueprint as rrb

        begin, now = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
        so_far = rrb.VisibleTimeRanges([rrb.VisibleTimeRange(name, start=begin, end=now) for name in TIMELINES])
        place = (*(8.5 * _directions(VIEWER_ANGLE)), 4.6)
        return rrb.Spatial3DView(
            name=f"Insertion (radial motion drawn {EXAGGERATION:.0f} times as large)",
            origin="/scene",
            eye_controls=rrb.EyeControls3D(position=place, look_target=(0.0, 0.0, 0.5), eye_up=(0.0, 0.0, 1.0)),
            line_grid=False,
            overrides={"scene/way": [so_far, rr.LineStrips3D.from_fields()]},
        )


def _directions(angles: Any) -> NDArray[np.float64]:
    """Return unit vectors (..., 2) of the radial plane."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def _tube(
    radius_mm: float, bottom_mm: float, top_mm: float, color: tuple[int, int, int], opening: float = 0.0
) -> "Mesh3D":
    """Return a tube along z, its wall inside the radius, cut open by the angle `opening` towards the viewer."""
    import rerun as rr

    inner_mm = radius_mm - WALL_MM
    corners = np.array([[inner_mm, bottom_mm], [radius_mm, bottom_mm], [radius_mm, top_mm], [inner_mm, top_mm]])
    sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)  # of the wall's section: (side, end, r or z)
    along = sides[:, 1] - sides[:, 0]
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    angles = np.linspace(VIEWER_ANGLE + opening / 2, VIEWER_ANGLE + 2 * np.pi - opening / 2, 97)

    def swept(section: NDArray[np.float64]) -> NDArray[np.float64]:
        around = section[:, :, None, :1] * _directions(angles)
        return np.concatenate([around, np.broadcast_to(section[:, :, None, 1:], (*around.shape[:3], 1))], axis=3)

    positions = swept(sides)
    index = np.arange(positions[..., 0].size).reshape(positions.shape[:3])
    a, b, c, d = index[:, 0, :-1], index[:, 1, :-1], index[:, 0, 1:], index[:, 1, 1:]
    return rr.Mesh3D(
        vertex_positions=positions.reshape(-1, 3),
        vertex_normals=swept(np.repeat(outward[:, None], 2, axis=1)).reshape(-1, 3),
        triangle_indices=np.stack([a, b, c, c, b, d], axis=-1).reshape(-1, 3),
        albedo_factor=color,
    )
