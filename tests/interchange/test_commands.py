"""The commands `export` and `import`."""

import sys
from pathlib import Path

import pytest
from samples import NETWORKS

from neurorobo.cli.main import main
from neurorobo.interchange.export import export_region
from neurorobo.plugins import Registry

EXAMPLE = str(Path(__file__).parents[2] / "examples" / "peg_in_hole.yaml")


def call(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: object
) -> tuple[int, str, str]:
    """Run the command line and return its exit code and what it says on both streams."""
    monkeypatch.setattr(sys, "argv", ["neurorobo", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    return int(ended.value.code or 0), said.out, said.err


def test_a_shipped_region_is_exported_imported_and_valid(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, _ = call(capsys, monkeypatch, "export", EXAMPLE, "--region", "prefrontal_cortex", "--nir", "plan.nir")
    assert (code, out.splitlines()[0]) == (0, "prefrontal_cortex: plan.nir")
    assert "without the output `confidence`, which carries numbers" in out
    assert "fresh" not in out
    code, printed, _ = call(capsys, monkeypatch, "import", "plan.nir")
    assert code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["plan.nir"]
    code, out, _ = call(capsys, monkeypatch, "import", "plan.nir", "--out", "brain/plan.yaml")
    assert code == 0
    assert "the code of `remaining` has no name: population_uniform stands in its place" in out
    assert Path("brain/plan.yaml").read_text() == printed
    assert Path("brain/plan.safetensors").exists()
    assert call(capsys, monkeypatch, "validate", "brain/plan.yaml") == (0, "brain/plan.yaml: ok\n", "")


def test_an_import_replaces_nothing_and_an_untrained_export_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    fresh = ("--set", "regions.prefrontal_cortex.weights=null")
    code, out, _ = call(capsys, monkeypatch, "export", EXAMPLE, *fresh, "--region", "prefrontal_cortex", "--nir", "p")
    assert (code, "with fresh weights, untrained" in out) == (0, True)
    assert call(capsys, monkeypatch, "import", "p", "--out", "net.yaml")[0] == 0
    code, _, err = call(capsys, monkeypatch, "import", "p", "--out", "net.yaml")
    assert (code, err.count("\n")) == (2, 1)
    assert "net.yaml exists already, and is left as it is; choose another place with `--out`" in err


def test_without_a_region_all_that_can_be_are_exported_and_the_others_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, err = call(capsys, monkeypatch, "export", EXAMPLE, "--nir", tmp_path / "brain")
    assert (code, err) == (0, "")
    assert sorted(path.name for path in (tmp_path / "brain").iterdir()) == ["cerebellum.nir", "prefrontal_cortex.nir"]
    assert "`hippocampus` cannot be exported: the neurons of its layer `hidden` are spiking neural units" in out
    assert "`add` cannot be exported: its input `a` carries numbers" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["export", EXAMPLE, "--region", "hippocampus", "--nir", "x.nir"], "`hippocampus` cannot be exported: the neu"),
        (
            ["export", EXAMPLE, "--region", "cerebelum", "--nir", "x.nir"],
            "uses a region `cerebelum`; did you mean `cer",
        ),
        (["import", "net.nir", "--dt", "soon"], "--dt soon: "),
        (["import", "net.nir", "--dt", "0 ms"], "a time step is longer than zero"),
        (["import", "net.nir", "--dt", "1 s"], "is too short for steps of 1 s"),
        (
            ["export", EXAMPLE, "--nir", "net.nir/brain"],
            "cannot be written (Not a directory); make room for it, or choose another place with `--nir`",
        ),
        (
            ["export", EXAMPLE, "--region", "cerebellum", "--nir", "."],
            ". is a folder; name a file with `--nir`, such as cere",
        ),
        (["import", "nowhere.nir"], "there is no file nowhere.nir"),
        (["import", "net.nir", "--out", "net.nir/x.yaml"], "cannot be written"),
    ],
)
def test_bad_input_ends_in_one_clear_error(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    export_region(NETWORKS["recurrent"](0), tmp_path / "net.nir", Registry())
    code, _, err = call(capsys, monkeypatch, *arguments)
    assert code == 2
    assert words in err
    assert err.count("\n") == 1
