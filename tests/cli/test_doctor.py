"""What the doctor tells."""

import json

import pytest
import torch

import neurorobo
from neurorobo.engine import engine_path
from tests.cli.test_commands import call
from tests.engine.paths import engine


def test_the_doctor_tells_versions_and_the_path_in_use(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, _ = call(capsys, monkeypatch, "doctor", "--json")
    assert code == 0
    told = json.loads(out)
    path = engine_path()
    assert (told["engine"], told["reason"], told["instructions"]) == (path.name, path.reason, path.instructions)
    assert (told["neurorobo"], told["torch"]) == (neurorobo.__version__, str(torch.__version__))
    assert told["threads"] == torch.get_num_threads()
    with engine("portable"):
        _, out, _ = call(capsys, monkeypatch, "doctor")
    assert "reason              NEUROROBO_ENGINE=portable\n" in out


def test_a_path_that_there_is_not_is_bad_input(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with engine("fast"):
        code, _, err = call(capsys, monkeypatch, "doctor")
    assert code == 2
    assert "not 'fast'" in err
