from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from precision_interaction import table_one
from precision_interaction.rig.contact import Line, RandomContact, RecordedContact, Table
from precision_interaction.rig.insertion_rig import build_contact, read_recording
from precision_interaction.rig.insertion_rig_config import InsertionRigConfig
from pydantic import ValidationError

from neurorobo.errors import NeuroroboError

PUBLISHED_UM = np.array([10.0, 50.0])
PUBLISHED_MEAN_MN = np.array([[12.7, 20.3], [29.6, 51.7]])
PUBLISHED_VARIANCE_MN2 = np.array([[23.2, 7.0], [56.3, 26.4]])
POINTS = [
    {"distance": "10 um", "mean": ["1 mN", "2 mN", "0 mN"], "variance": ["4 mN^2", "1 mN^2", "0 mN^2"]},
    {"distance": "30 um", "mean": ["5 mN", "2 mN", "0 mN"], "variance": ["8 mN^2", "1 mN^2", "0 mN^2"]},
]


def contact(**options: object) -> RandomContact:
    built = build_contact(InsertionRigConfig.model_validate({"contact": options}))
    assert isinstance(built, RandomContact)
    return built


def test_the_measured_law_passes_through_the_published_points() -> None:
    law = contact(law="measured").law
    np.testing.assert_allclose(law.mean_mN(PUBLISHED_UM)[:, :2], PUBLISHED_MEAN_MN)
    np.testing.assert_allclose(law.variance_mN2(PUBLISHED_UM)[:, :2], PUBLISHED_VARIANCE_MN2)


def test_the_proportional_law_is_their_least_squares_line_through_the_origin() -> None:
    for published, slopes in (
        (PUBLISHED_MEAN_MN, table_one.PROPORTIONAL_MEAN_MN_UM),
        (PUBLISHED_VARIANCE_MN2, table_one.PROPORTIONAL_VARIANCE_MN2_UM),
    ):
        best = np.linalg.lstsq(PUBLISHED_UM[:, None], published, rcond=None)[0][0]
        np.testing.assert_allclose(slopes, best, atol=5e-4)


@pytest.mark.parametrize("law", [{"law": "proportional"}, {"law": "measured"}, {"law": "table", "points": POINTS}])
def test_standing_still_adds_no_force(law: dict[str, object]) -> None:
    still = np.zeros(1)
    increment = contact(**law).increment_mN(still, still, np.array([100.0]), np.full((1, 3), 5.0))
    np.testing.assert_array_equal(increment, 0.0)


@given(
    cuts=st.lists(st.floats(0.0, 100.0), max_size=6),
    law=st.sampled_from([{"law": "proportional"}, {"law": "measured"}, {"law": "table", "points": POINTS}]),
)
def test_the_stretches_of_one_move_add_up_to_the_move(cuts: list[float], law: dict[str, object]) -> None:
    """Means add, and so do variances: however often the radial loop runs, an axial move adds the same distribution."""
    whole = contact(**law)
    ends = np.array([0.0, *sorted(cuts), 100.0])
    before, after, nowhere = ends[:-1], ends[1:], np.zeros(len(ends) - 1)
    mean = whole.increment_mN(before, after, nowhere, np.zeros((len(nowhere), 3)))
    deviation = whole.increment_mN(before, after, nowhere, np.ones((len(nowhere), 3))) - mean
    np.testing.assert_allclose(mean.sum(axis=0), whole.law.mean_mN(ends[-1:])[0])
    np.testing.assert_allclose((deviation**2).sum(axis=0), whole.law.variance_mN2(ends[-1:])[0], atol=1e-9)


def test_samples_have_the_laws_mean_and_full_covariance() -> None:
    count = 40_000
    drawn = contact(law="measured", correlation={"xy": 0.6}).increment_mN(
        np.zeros(count), np.full(count, 50.0), np.zeros(count), np.random.default_rng(5).standard_normal((count, 3))
    )[:, :2]
    deviation = np.sqrt(PUBLISHED_VARIANCE_MN2[1])
    assert np.all(np.abs(drawn.mean(axis=0) - PUBLISHED_MEAN_MN[1]) < 4 * deviation / np.sqrt(count))
    covariance = np.outer(deviation, deviation) * [[1.0, 0.6], [0.6, 1.0]]
    np.testing.assert_allclose(np.cov(drawn.T), covariance, rtol=0.05)


def test_the_depth_gain_scales_an_increment_by_how_deep_it_begins() -> None:
    depth = np.array([0.0, 1025.0, 2050.0])
    noise = np.ones((3, 3))
    before, after = np.zeros(3), np.full(3, 20.0)
    flat = contact(law="measured").increment_mN(before, after, depth, noise)
    growing = contact(law="measured", depth_gain=0.5).increment_mN(before, after, depth, noise)
    np.testing.assert_allclose(growing[:, :2] / flat[:, :2], [[1.0, 1.0], [1.25, 1.25], [1.5, 1.5]])


def test_a_table_is_linear_between_its_points_and_beyond_the_last() -> None:
    law = Table((10.0, 30.0), ((1.0, 2.0, 0.0), (5.0, 2.0, 0.0)), ((4.0, 1.0, 0.0), (8.0, 1.0, 0.0)))
    means = law.mean_mN(np.array([0.0, 5.0, 10.0, 20.0, 30.0, 40.0]))
    np.testing.assert_allclose(means[:, 0], [0.0, 0.5, 1.0, 3.0, 5.0, 7.0])
    np.testing.assert_allclose(law.variance_mN2(np.array([20.0]))[0], [6.0, 1.0, 0.0])


def test_a_line_without_intercept_is_proportional() -> None:
    law = Line((0.5, 1.0, 0.0), (1.0, 2.0, 0.0))
    np.testing.assert_allclose(law.mean_mN(np.array([10.0, 20.0])), [[5.0, 10.0, 0.0], [10.0, 20.0, 0.0]])


def test_a_recording_is_replayed_over_depth_whatever_the_noise() -> None:
    recorded = RecordedContact((0.0, 100.0, 200.0), ((0.0, 0.0, 0.0), (10.0, 20.0, 0.0), (0.0, 40.0, 0.0)))
    noise = np.random.default_rng(0).standard_normal((3, 3))
    steps = recorded.increment_mN(np.zeros(3), np.array([50.0, 100.0, 80.0]), np.array([0.0, 50.0, 150.0]), noise)
    np.testing.assert_allclose(steps[:, :2], [[5.0, 10.0], [0.0, 20.0], [-5.0, 10.0]])


def test_a_recording_is_read_from_csv(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("depth_um,force_x_mN,force_y_mN\n0,0,0\n10,1.5,-2\n")
    recorded = build_contact(InsertionRigConfig.model_validate({"contact": {"law": "recorded", "file": str(path)}}))
    assert recorded == RecordedContact((0.0, 10.0), ((0.0, 0.0, 0.0), (1.5, -2.0, 0.0)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "cannot be read"),
        ("", "no column depth_um, force_x_mN, force_y_mN"),
        ("depth_um,force_x_mN\n0,0\n", "no column force_y_mN"),
        ("depth_um,force_x_mN,force_y_mN\n", "no rows"),
        ("depth_um,force_x_mN,force_y_mN\n0,0,0\n1,x,0\n", ":3: not a finite number"),
        ("depth_um,force_x_mN,force_y_mN\n0,0,0\n1,nan,0\n", ":3: not a finite number"),
        ("depth_um,force_x_mN,force_y_mN\n0,0,0\n1,2\n", ":3: not a finite number"),
        ("depth_um,force_x_mN,force_y_mN\n5,0,0\n5,0,0\n", ":3: depth_um does not rise"),
    ],
)
def test_a_faulty_recording_is_refused_with_file_and_line(tmp_path: Path, text: str | None, message: str) -> None:
    path = tmp_path / "log.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(NeuroroboError) as caught:
        read_recording(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"law": "measured", "correlation": {"xy": 0.9, "xz": 0.9, "yz": -0.9}}, "closer to 0"),
        ({"law": "table", "points": POINTS[::-1]}, "10 um comes after 30 um"),
        ({"law": "table", "points": [POINTS[1], {**POINTS[0], "distance": "40 um"}]}, "the variance falls at 40 um"),
        ({"law": "proportional", "mean_slope": ["1 mN", "1 mN", "1 mN"]}, "wanted a stiffness"),
        ({"law": "guessed"}, "guessed"),
    ],
)
def test_a_contact_that_cannot_be_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        InsertionRigConfig.model_validate({"contact": options})
