"""The scene of an insertion, read back from its file."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from precision_interaction.rig.insertion_rig import InsertionRig
from precision_interaction.rig.insertion_rig_config import InsertionRigConfig
from precision_interaction.rig.insertion_task import InsertionTask
from precision_interaction.rig.insertion_task_config import InsertionTaskConfig
from precision_interaction.rig.scene import EXAGGERATION, VIEWER_ANGLE, InsertionScene
from rerun.chunk import RrdReader

from neurorobo.clock import Clock
from neurorobo.experiment.recorder import Setting
from neurorobo.graph.plan import Plan
from neurorobo.views.recording import Episode, Scene, Signal

PLAN = Plan(Clock({"control": 1_000_000_000}, 1_000_000, 50), (), {}, {}, 1)
TICKS = np.arange(4)
FORCE_MN = np.array([[0.0, 0.0], [30.0, 40.0], [-10.0, 0.0], [0.0, -50.0]])
STAGE_UM = np.array([[0.0, 0.0], [1.0, 2.0], [5.0, 10.0], [12.0, 24.0]])
TRAVEL_UM = np.array([[0.0], [50.0], [1000.0], [2050.0]])


@pytest.fixture(scope="module")
def scene() -> InsertionScene:
    task = InsertionTask(InsertionTaskConfig(), InsertionRig(InsertionRigConfig()))
    return InsertionScene(Setting(Path(), "insertion", PLAN, [0], task))


@pytest.fixture(scope="module")
def drawn(scene: InsertionScene, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, list[Any]]]:
    """The components of each entity, row by row."""
    path = tmp_path_factory.mktemp("scene") / "scene.rrd"
    quantities = {"force": (FORCE_MN, "mN"), "stage": (STAGE_UM, "um"), "travel": (TRAVEL_UM, "um")}
    signals = {f"body/{name}": Signal(TICKS, values, unit) for name, (values, unit) in quantities.items()}
    stream = rr.RecordingStream("scene")
    stream.save(path)
    scene.log(stream, Episode(0, PLAN, signals, {}))
    stream.flush()
    stream.disconnect()
    entities: dict[str, dict[str, list[Any]]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        entities.setdefault(chunk.entity_path, {}).update(chunk.to_record_batch().to_pydict())
    return entities


def positions(drawn: dict[str, dict[str, list[Any]]], entity: str) -> np.ndarray:
    return np.array(drawn[entity]["Mesh3D:vertex_positions"][0])


def tips_mm(drawn: dict[str, dict[str, list[Any]]]) -> np.ndarray:
    return np.array(drawn["/scene/peg"]["Transform3D:translation"])[:, 0]


def test_the_scene_is_what_a_recording_asks_for(scene: InsertionScene) -> None:
    accepted: Scene = scene
    assert "20 times" in accepted.legend and "2 mm deep" in accepted.legend
    assert accepted.view().origin == "/scene"


def test_the_peg_travels_down_and_moves_sideways_exaggerated(drawn: dict[str, dict[str, list[Any]]]) -> None:
    tips = tips_mm(drawn)
    np.testing.assert_allclose(tips[:, 2], [0.05, 0.0, -0.95, -2.0], atol=1e-6)  # 50 um above the hole at the start
    np.testing.assert_allclose(tips[:, :2], EXAGGERATION * STAGE_UM / 1000, rtol=1e-6)
    assert drawn["/scene/peg"]["tick"] == TICKS.tolist()


def test_the_end_of_the_insertion_is_marked(drawn: dict[str, dict[str, list[Any]]]) -> None:
    (ring,) = drawn["/scene/hole/end"]["LineStrips3D:strips"][0]
    np.testing.assert_allclose(np.array(ring)[:, 2], tips_mm(drawn)[-1, 2], atol=1e-6)


def test_the_arrow_is_the_force_and_50_mN_are_as_long_as_the_radius(drawn: dict[str, dict[str, list[Any]]]) -> None:
    force = drawn["/scene/peg/force"]
    vectors = np.array(force["Arrows3D:vectors"])[:, 0]
    np.testing.assert_allclose(vectors, np.column_stack([FORCE_MN * 2.0 / 50.0, np.zeros(4)]), rtol=1e-6)
    assert np.linalg.norm(vectors[3]) == pytest.approx(
        np.linalg.norm(positions(drawn, "/scene/peg")[:, :2], axis=1).max()
    )
    assert [label for (label,) in force["Arrows3D:labels"]] == ["0 mN", "50 mN", "10 mN", "50 mN"]


def test_the_way_is_an_unbroken_line_that_follows_the_tip(drawn: dict[str, dict[str, list[Any]]]) -> None:
    pieces = np.array(drawn["/scene/way"]["LineStrips3D:strips"])[:, 0]
    np.testing.assert_allclose(pieces[1:, 0], pieces[:-1, 1])
    offsets = pieces[:, 1] - tips_mm(drawn)
    np.testing.assert_allclose(offsets, np.broadcast_to(offsets[0], offsets.shape), atol=1e-6)


@pytest.mark.parametrize(("entity", "inner", "outer", "bottom"), [("peg", 1.95, 2.0, 0.0), ("hole", 2.0, 2.05, -3.0)])
def test_peg_and_hole_are_hollow_and_of_the_published_size(
    drawn: dict[str, dict[str, list[Any]]], entity: str, inner: float, outer: float, bottom: float
) -> None:
    vertices = positions(drawn, f"/scene/{entity}")
    radii = np.linalg.norm(vertices[:, :2], axis=1)
    assert set(np.round(radii, 6)) == {inner, outer}
    assert vertices[:, 2].min() == pytest.approx(bottom)
    assert vertices[:, 2].max() == pytest.approx(4.0 if entity == "peg" else 0.0)


@pytest.mark.parametrize("entity", ["peg", "hole"])
def test_every_face_is_lit_from_outside_its_wall(drawn: dict[str, dict[str, list[Any]]], entity: str) -> None:
    mesh = drawn[f"/scene/{entity}"]
    vertices, triangles = positions(drawn, f"/scene/{entity}"), np.array(mesh["Mesh3D:triangle_indices"][0])
    normals = np.array(mesh["Mesh3D:vertex_normals"][0])
    corners = vertices[triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    assert (np.abs((facing * normals[triangles[:, 0]]).sum(axis=1)) > 0.99).all()
    # A small step along a normal leaves the wall.
    radii = np.linalg.norm(vertices[:, :2], axis=1)
    away = vertices + 0.01 * normals
    radii_away = np.linalg.norm(away[:, :2], axis=1)
    left = (radii_away > radii.max() + 0.005) | (radii_away < radii.min() - 0.005)
    left |= (away[:, 2] > vertices[:, 2].max() + 0.005) | (away[:, 2] < vertices[:, 2].min() - 0.005)
    assert left.all()


def test_one_looks_into_the_hole_where_it_is_cut_open(drawn: dict[str, dict[str, list[Any]]]) -> None:
    vertices = positions(drawn, "/scene/hole")
    towards_viewer = vertices[:, :2] @ [np.cos(VIEWER_ANGLE), np.sin(VIEWER_ANGLE)]
    assert (towards_viewer / np.linalg.norm(vertices[:, :2], axis=1) < np.cos(0.19 * np.pi)).all()
    assert towards_viewer.min() < -2.0
