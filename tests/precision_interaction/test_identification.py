"""Identifying a contact: it finds the law that a rig has, and says what is wrong with a log."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from precision_interaction.identification.analysis import Analysis, LineFit, analyse, histogram, quantile
from precision_interaction.identification.doubts import doubts
from precision_interaction.identification.experiment import insert_and_withdraw
from precision_interaction.identification.fragment import contact_of
from precision_interaction.identification.log import ContactLog, read_log, write_log
from precision_interaction.rig.insertion_rig_config import InsertionRigConfig

from neurorobo.cli.main import main
from neurorobo.errors import NeuroroboError

EXAMPLE = Path(__file__).parents[2] / "examples" / "peg_in_hole.yaml"
HEADER = "step_um,increment_x_mN,increment_y_mN\n"


def rig(contact: dict[str, Any], **options: Any) -> InsertionRigConfig:
    return InsertionRigConfig.model_validate({"contact": contact, "force_resolution": "0 mN", **options})


def identified(contact: dict[str, Any], seed: int = 0, **options: Any) -> Analysis:
    return analyse(insert_and_withdraw(rig(contact, **options), repetitions=300, seed=seed))


def assert_recovers(line: LineFit, slope: Any, intercept: Any) -> None:
    """Within five standard errors, and not because the errors are large."""
    assert np.all(np.abs(line.slope - np.array(slope[:2])) <= 5 * line.slope_error)
    assert np.all(np.abs(line.intercept - np.array(intercept[:2])) <= 5 * line.intercept_error + 1e-12)
    assert np.all(line.slope_error < 0.12 * np.abs(slope[:2]) + 0.01)


@settings(max_examples=15, deadline=None)
@given(
    slopes=st.lists(st.floats(0.1, 2), min_size=4, max_size=4),
    intercepts=st.lists(st.floats(2, 20), min_size=4, max_size=4),
    seed=st.integers(0, 2**31),
)
def test_it_finds_the_law_that_the_rig_has(slopes: list[float], intercepts: list[float], seed: int) -> None:
    contact = {
        "law": "measured",
        "mean_slope": [f"{slopes[0]} mN/um", f"{slopes[1]} mN/um", "0 mN/um"],
        "variance_slope": [f"{slopes[2]} mN^2/um", f"{slopes[3]} mN^2/um", "0 mN^2/um"],
        "mean_intercept": [f"{intercepts[0]} mN", f"{-intercepts[1]} mN", "0 mN"],
        "variance_intercept": [f"{intercepts[2]} mN^2", f"{intercepts[3]} mN^2", "0 mN^2"],
    }
    fit = identified(contact, seed).best()
    assert fit.law == "measured"
    for line, slope, intercept in (
        (fit.mean, slopes[:2], (intercepts[0], -intercepts[1])),
        (fit.variance, slopes[2:], intercepts[2:]),
    ):
        assert np.all(np.abs(line.slope - slope) <= 5 * line.slope_error)
        assert np.all(np.abs(line.intercept - intercept) <= 5 * line.intercept_error)


def test_a_proportional_rig_is_told_from_one_with_an_intercept() -> None:
    config = rig({"law": "proportional"})
    fit = identified({"law": "proportional"}).best()
    assert fit.law == "proportional"
    assert_recovers(fit.mean, config.contact.mean_slope, (0, 0))  # type: ignore[union-attr]
    assert_recovers(fit.variance, config.contact.variance_slope, (0, 0))  # type: ignore[union-attr]


def test_intervals_hold_as_often_as_they_say() -> None:
    """Of 40 logs, the intervals of 8 parameters together hold in 95 %: at most 7 miss but once in a thousand times."""
    contact: Any = rig({"law": "measured"}).contact
    missed = 0
    for seed in range(40):
        fit = identified({"law": "measured"}, seed).measured
        assert fit is not None
        pairs = (
            (fit.mean.slope, fit.mean.slope_error, contact.mean_slope),
            (fit.mean.intercept, fit.mean.intercept_error, contact.mean_intercept),
            (fit.variance.slope, fit.variance.slope_error, contact.variance_slope),
            (fit.variance.intercept, fit.variance.intercept_error, contact.variance_intercept),
        )
        missed += any(np.any(np.abs(found - truth[:2]) > quantile(8) * error) for found, error, truth in pairs)
    assert missed <= 7


def test_correlated_axes_are_found() -> None:
    found = identified({"law": "measured", "correlation": {"xy": 0.6}})
    assert found.correlated
    assert found.correlation_xy == pytest.approx(0.6, abs=0.05)
    assert not identified({"law": "measured"}).correlated


def test_the_gaussian_of_a_gaussian_fits_and_that_of_two_heaps_does_not() -> None:
    generator = np.random.default_rng(0)
    assert histogram(generator.normal(20, 5, 2000)).r_squared > 0.99
    assert histogram(generator.choice([-30.0, 30.0], 2000)).r_squared < 0.5


def test_shares_add_up_to_one() -> None:
    found = histogram(np.random.default_rng(1).normal(0, 9, 500))
    assert found.share.sum() == pytest.approx(1)
    assert np.allclose(np.diff(found.centre_mN), 7.0)


def doubted(log: ContactLog) -> list[str]:
    analysis = analyse(log)
    return list(doubts(log, analysis, analysis.best()))


@pytest.mark.parametrize("law", ["measured", "proportional"])
@pytest.mark.parametrize("repetitions", [10, 30, 300])
def test_what_a_rig_draws_is_not_doubted(law: str, repetitions: int) -> None:
    """In 20 logs of each kind at most one is: each doubt asks for much more than chance gives."""
    logs = [insert_and_withdraw(rig({"law": law}), repetitions=repetitions, seed=seed) for seed in range(20)]
    assert sum(bool(doubted(log)) for log in logs) <= 1


@pytest.mark.parametrize(
    ("of_step", "of_force", "words"),
    [
        (1.0, 1e-3, "in N, multiply them by 1000"),
        (1.0, 1e3, "in uN, multiply them by 0.001"),
        (1e-3, 1.0, "step_um is in mm"),
        (1e3, 1.0, "step_um is in nm"),
    ],
)
def test_values_in_another_unit_than_the_column_says_are_told(of_step: float, of_force: float, words: str) -> None:
    log = insert_and_withdraw(rig({"law": "measured"}), repetitions=30)
    [told] = [
        doubt
        for doubt in doubted(replace(log, step_um=log.step_um * of_step, increment_mN=log.increment_mN * of_force))
        if "convert" in doubt or "multiply" in doubt
    ]
    assert words in told


def test_an_insertion_unlike_the_others_is_told_with_its_line_and_that_the_law_does_not_fit(tmp_path: Path) -> None:
    log = insert_and_withdraw(rig({"law": "measured"}), repetitions=100)
    log.increment_mN[333, 0] = 300.0
    write_log(log, tmp_path / "log.csv")
    outlier, *others = doubted(read_log(tmp_path / "log.csv"))
    assert "1 of 700 insertions lies far from the others" in outlier
    assert "log.csv:335: increment_x_mN 300" in outlier
    assert any("does not fit the variance of x" in other and "off most at 20 um" in other for other in others)


def test_increments_in_two_heaps_are_told_as_not_gaussian() -> None:
    log = insert_and_withdraw(rig({"law": "measured"}), repetitions=100)
    log.increment_mN[:, 1] += np.random.default_rng(0).choice([-25.0, 25.0], len(log.step_um))
    [told] = [doubt for doubt in doubted(log) if "not Gaussian" in doubt]
    assert "y at 2 um" in told


def test_a_coarse_sensor_is_told() -> None:
    assert identified({"law": "measured"}, force_resolution="7.8125 mN").coarse
    assert not identified({"law": "measured"}).coarse


def test_axes_that_are_the_same_still_make_a_contact() -> None:
    step = np.repeat([10.0, 20.0], 50)
    force = np.random.default_rng(0).normal(step, 3.0)
    found = analyse(ContactLog(step, np.stack([force, force], axis=1), "log.csv"))
    assert contact_of(found, found.best()).correlation.xy == pytest.approx(0.999)  # type: ignore[union-attr]


def test_a_log_comes_back_as_it_was_written(tmp_path: Path) -> None:
    log = insert_and_withdraw(rig({"law": "measured"}), repetitions=10)
    write_log(log, tmp_path / "log.csv")
    back = read_log(tmp_path / "log.csv")
    assert np.array_equal(back.step_um, log.step_um)
    assert np.array_equal(back.increment_mN, log.increment_mN)


def test_parquet_says_the_same_as_csv(tmp_path: Path) -> None:
    log = insert_and_withdraw(rig({"law": "measured"}), repetitions=10)
    columns = {
        "step_um": log.step_um,
        "increment_x_mN": log.increment_mN[:, 0],
        "increment_y_mN": log.increment_mN[:, 1],
    }
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "log.parquet")
    assert np.array_equal(read_log(tmp_path / "log.parquet").increment_mN, log.increment_mN)


def test_a_single_step_is_said_to_tell_no_law() -> None:
    log = insert_and_withdraw(rig({"law": "proportional"}), repetitions=30, seed=1000)
    one, two = (
        replace(log, step_um=log.step_um[kept], increment_mN=log.increment_mN[kept])
        for kept in (log.step_um == log.steps_um[3], np.isin(log.step_um, log.steps_um[2:4]))
    )
    assert any("all steps are" in doubt for doubt in doubted(one))
    assert not any("all steps are" in doubt for doubt in doubted(two))


def test_the_unit_that_a_parquet_column_states_is_heeded(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    fields = [
        pyarrow.field("step_um", pyarrow.float64(), metadata={"unit": "um"}),
        pyarrow.field("increment_x_mN", pyarrow.float64(), metadata={"unit": "N"}),
        pyarrow.field("increment_y_mN", pyarrow.float64()),
    ]
    table = pyarrow.table([[10.0] * 10] * 3, schema=pyarrow.schema(fields))
    pyarrow.parquet.write_table(table, path)
    with pytest.raises(NeuroroboError, match=r"log\.parquet: the column increment_x_mN says that it is in N"):
        read_log(path)


ROWS = "".join(f"10,{i},{2 * i}\n" for i in range(12))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "cannot be read"),
        ("", "no column step_um, increment_x_mN, increment_y_mN; a log has a row for each insertion"),
        ("step_um,increment_x_mN\n10,1\n", "no column increment_y_mN"),
        ("step_mm,increment_x_mN,increment_y_mN\n0.01,1,2\n", "the column step_mm is not in um; convert it"),
        ("step_um,increment_x_N,increment_y_N\n10,1,2\n", "the column increment_x_N is not in mN; convert it"),
        (HEADER, "no rows"),
        (HEADER + ROWS + "10,nan,1\n", ":14: increment_x_mN is 'nan', not a number; correct or remove"),
        (HEADER + ROWS + "10,1e300,1\n", ":14: increment_x_mN is '1e300', beyond 1000000; correct or remove"),
        (HEADER + ROWS + "10,1\n", ":14: increment_y_mN is nothing"),
        (HEADER + ROWS + "10,one,1\n", ":14: increment_x_mN is 'one'"),
        (HEADER + ROWS + "-10,1,1\n" * 10, ":14: step_um is -10; log insertions only"),
        (HEADER + ROWS + "20,1,1\n" * 9, "9 insertions of 20 um, too few for a variance"),
        (HEADER + ROWS + "20,1,1\n", "1 insertion of 20 um, too few"),
        ((HEADER + ROWS).replace(",", ";"), "columns are separated by semicolons; save it with commas"),
        ((HEADER + ROWS).replace(",", "\t"), "columns are separated by tabs; save it with commas"),
    ],
)
def test_a_faulty_log_is_refused_with_file_place_fault_and_cure(tmp_path: Path, text: str | None, words: str) -> None:
    path = tmp_path / "log.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(NeuroroboError) as caught:
        read_log(path)
    assert str(path) in str(caught.value)
    assert words in str(caught.value)


def test_something_else_than_a_log_is_refused(tmp_path: Path) -> None:
    for name in ("log.csv", "log.parquet"):
        (tmp_path / name).write_bytes(bytes(range(256)))
        with pytest.raises(NeuroroboError, match=name):
            read_log(tmp_path / name)


def test_a_force_that_never_varies_is_refused() -> None:
    log = ContactLog(np.repeat([10.0, 20.0], 10), np.ones((20, 2)), "log.csv")
    with pytest.raises(NeuroroboError, match=r"log\.csv: increment_x_mN never varies within a step; filter the sensor"):
        analyse(log)


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["neurorobo", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


@pytest.mark.parametrize("law", ["measured", "proportional"])
def test_what_the_command_writes_goes_under_body_contact(
    law: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    experiment = yaml.safe_load(EXAMPLE.read_text())
    experiment["body"] |= {"contact": {"law": law}, "force_resolution": "0 mN"}
    file, log, out = tmp_path / "rig.yaml", tmp_path / "log.csv", tmp_path / "contact.yaml"
    file.write_text(yaml.safe_dump(experiment, sort_keys=False))
    assert call(monkeypatch, "identify", str(log), "--simulate", str(file), "--out", str(out)) == 0
    assert law in capsys.readouterr().out
    fitted = yaml.safe_load(out.read_text())
    assert fitted["law"] == law
    experiment["body"]["contact"] = fitted
    file.write_text(yaml.safe_dump(experiment, sort_keys=False))
    assert call(monkeypatch, "validate", str(file)) == 0
    built = InsertionRigConfig.model_validate({"contact": fitted})
    slope = built.contact.mean_slope  # type: ignore[union-attr]
    assert slope[:2] == pytest.approx(rig({"law": law}).contact.mean_slope[:2], rel=0.1)  # type: ignore[union-attr]


def test_the_command_refuses_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = tmp_path / "log.csv", tmp_path / "contact.yaml"
    log.write_text(HEADER + ROWS)
    for more, words in (
        (("--law", "measured"), "one step tells no intercept"),
        (("--simulate", str(EXAMPLE)), "is there already"),
        (("--depth", "50"), "--depth is about a simulated log"),
        (("--filtered",), "--filtered is about a simulated log"),
    ):
        assert call(monkeypatch, "identify", str(log), "--out", str(out), *more) == 2
        said = capsys.readouterr().err
        assert words in said
        assert said.count("\n") == 1
        assert not out.exists()
    other = str(tmp_path / "other.csv")
    assert call(monkeypatch, "identify", other, "--out", str(out), "--simulate", str(EXAMPLE), "--depth", "1e6") == 2
    assert "does not fit the 2050 um" in capsys.readouterr().err
    out.write_text("law: measured")
    assert call(monkeypatch, "identify", str(log), "--out", str(out)) == 2
    assert "exists already, and is left as it is" in capsys.readouterr().err
    assert out.read_text() == "law: measured"
