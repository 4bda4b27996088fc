"""Bad input ends in one clear message, with file, line, column, fault and cure, and exit code 2."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from neurorobo.cli.main import main
from neurorobo.clock import Clock
from neurorobo.regions.weights import save_weights
from tests.cli.installed import install_plugin

GOOD = """\
neurorobo: 1
name: tiny
time: {control: 1 s, fast: 250 ms}
episode: {duration: 2 s}
regions:
  left: {type: minimal.echo, neurons: 8}
  law: {type: precision.law, period: control}
  add: {type: sum, unit: mN, width: 2}
steps:
  - a: {use: left, heard: previous b.said}
  - b: {use: left, heard: a.said}
  - c: {use: law}
"""


TRAIN = """\
- c: {{use: law}}
train:
  - {{phase: supervise, region: left, teacher: {{type: minimal.echo, {}}}, data: precision.insertion_speeds, loss: {{said: 1 Hz}}, steps: 3}}
"""  # noqa: E501


def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: str) -> tuple[int, str]:
    """Run the command line and return its exit code and what it says on the error stream."""
    monkeypatch.setattr(sys, "argv", ["neurorobo", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0), capsys.readouterr().err


def test_the_file_to_be_spoilt_is_good(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "x.yaml").write_text(GOOD)
    assert call(capsys, monkeypatch, "validate", str(tmp_path / "x.yaml")) == (0, "")


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("episode:", "episod:", "4:1: episod", "did you mean `episode`?"),
        ("unit: mN", "unit: mN, widht: 2", ":8:", "did you mean"),
        ("250 ms", "250 mm", "3:22: time.fast", "is a length, wanted a time"),
        ("250 ms", "250", "3:22: time.fast", "must be a time such as"),
        ("neurons: 8", "neurons: -8", "6:3: regions.left: ", "at least one neuron (got -8); give it 1 or more"),
        ("width: 2", "width: -2", "8:30: regions.add.width: ", "must be greater than or equal to 1 (got -2)"),
        (
            "steps:",
            "  spare: {type: minimal.echo, neurons: 0}\nsteps:",
            "9:3: regions.spare: ",
            "neuron (got 0); give it",
        ),
        ("name: tiny", "name: tiny\nname: big", "3:1: name: ", "duplicate key `name` (first at line 2); remove one"),
        ("- c: {use: law}\n", TRAIN.format("neurons: -3"), "14:38: train.0.teacher: ", "neuron (got -3); give it"),
        (
            "- c: {use: law}\n",
            TRAIN.format("neurons: 4"),
            ": train.0.loss.said: ",
            "carries spikes, not numbers; take a teacher that computes with numbers",
        ),
        ("minimal.echo", "minimal.ecko", "6:10: regions.left.type", "did you mean `minimal.echo`?"),
        ("b: {use: left, heard: a.said}", "b: {use: law, speed: a.said}", "11:", "is Hz, but `speed` takes um/s"),
        ("- c: {use: law}", "- c: {use: add, a: c2.mean}", "12:", "there is no step `c2`"),
        ("- c: {use: law}", "- c: {use: add, a: previous c.sum, b: previous c.sum}", "12:", "no value at the start"),
        ("- c: {use: law}", "- c: {use: add}", "12:", "the input `a` (2 x mN) of `add` is not wired"),
        ("heard: previous b.said", "heard: b.said", "10:", "a cycle without delay: a -> b -> a"),
        ("fast: 250 ms", "fast: 300 ms", "3:22: time.fast", "does not divide control: 1 s"),
        (
            "- b: {use: left, heard: a.said}",
            "- b: {use: left, heard: a.said, every: fats}",
            "11:",
            "did you mean `fast`?",
        ),
    ],
)
def test_a_fault_is_named_with_its_place(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    old: str,
    new: str,
    place: str,
    words: str,
) -> None:
    file = tmp_path / "x.yaml"
    assert old in GOOD
    file.write_text(GOOD.replace(old, new, 1))
    code, message = call(capsys, monkeypatch, "validate", str(file))
    assert code == 2
    assert f"{file}:" in message
    assert place in message
    assert words in message
    assert "Traceback" not in message


def test_several_faults_are_reported_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "x.yaml"
    file.write_text(
        GOOD.replace("minimal.echo", "minimal.ecko").replace("250 ms", "250 mm").replace("name: tiny", "nam: x")
    )
    code, message = call(capsys, monkeypatch, "validate", str(file))
    assert code == 2
    assert {line.split(":")[1] for line in message.splitlines()} >= {"2", "3", "6"}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"- 1\n- 2\n", "not a mapping"),
        (b"a: [1\n", ":2:1: is not valid YAML: expected ',' or ']'"),
        (b"a: \x07\n", ":1:4: is not valid YAML: the character '\\x07' is not allowed"),
        (b"\xff\xfe\x00", ":1:1: is not text in UTF-8: there is a byte 0xff; save the file as UTF-8"),
        (
            b"neurorobo_rig: 1\nname: bench\n",
            ":1:1: neurorobo_rig: says what kind of file this is, and it is no experiment",
        ),
        (b"just words", ":1:1: is a single value, not a mapping; an experiment starts with 'neurorobo: 1'"),
    ],
)
def test_a_file_that_is_no_experiment(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, content: bytes, words: str
) -> None:
    file = tmp_path / "x.yaml"
    file.write_bytes(content)
    code, message = call(capsys, monkeypatch, "run", str(file))
    assert code == 2
    assert message.startswith(str(file))
    assert words in message
    assert "Traceback" not in message


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, "there is no weights file"), (b"not safetensors", "not a whole safetensors file"), (b"", "not a whole")],
)
def test_weights_that_cannot_be_used(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    content: bytes | None,
    words: str,
) -> None:
    if content is not None:
        (tmp_path / "w.safetensors").write_bytes(content)
    file = tmp_path / "x.yaml"
    file.write_text(GOOD.replace("neurons: 8", "neurons: 8, weights: w.safetensors"))
    code, message = call(capsys, monkeypatch, "run", str(file), "--out", str(tmp_path / "out"))
    assert code == 2
    assert message.startswith(f"{file}:6:42: regions.left.weights: ")
    assert words in message
    assert not (tmp_path / "out").exists()


def save(file: Path, neurons: int) -> None:
    """Write weights of a `minimal.echo` of so many neurons."""
    from neurorobo_minimal.plugin import EchoConfig
    from neurorobo_minimal.region import Echo

    config = EchoConfig(type="minimal.echo", neurons=neurons)
    save_weights(Echo(config, Clock({"control": 10**9}, 10**6, 50), torch.Generator()), file, {})


def test_weights_of_another_configuration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    save(tmp_path / "w.safetensors", neurons=9)
    file = tmp_path / "x.yaml"
    file.write_text(GOOD.replace("neurons: 8", "neurons: 8, weights: w.safetensors"))
    code, message = call(capsys, monkeypatch, "run", str(file), "--out", str(tmp_path / "out"))
    assert code == 2
    assert message == (
        f"{file}:6:42: regions.left.weights: trained for `neurons: 9`, not `neurons: 8`: "
        f"{tmp_path / 'w.safetensors'}; use the configuration it was trained for, or train this one\n"
    )


WEIGHTS = """\
neurorobo: 1
name: tiny
time: {control: 1 s}
episode: {duration: 2 s}
regions:
  absent: {type: minimal.echo, weights: none.safetensors}
  other: {type: minimal.echo, neurons: 8, weights: nine.safetensors}
  shipped: {type: precision.hippocampus, period: control, hidden_neurons: 3, weights: pretrained}
  spare: {type: minimal.echo, weights: none.safetensors}
steps:
  - a: {use: absent}
  - b: {use: other}
  - c: {use: shipped}
train:
  - {phase: supervise, region: othre, teacher: precision.law, data: precision.insertion_speeds, loss: {said: 1 Hz}, steps: 3}
"""  # noqa: E501


@pytest.mark.parametrize("path", ["~nosuchuser/w.safetensors", "round.safetensors", '"a\\0b"'])
def test_a_path_of_weights_that_leads_nowhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    (tmp_path / "round.safetensors").symlink_to(tmp_path / "round.safetensors")
    file = tmp_path / "x.yaml"
    file.write_text(GOOD.replace("neurons: 8", f"neurons: 8, weights: {path}"))
    code, message = call(capsys, monkeypatch, "validate", str(file), "--set", "seed=3")
    assert code == 2
    assert message.startswith(f"{file}:6:42: regions.left.weights: ")
    assert "is no path: " in message
    assert len(message.splitlines()) == 1  # and no note that the seed may be the cause


def test_validate_tells_all_weights_that_a_run_could_not_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    save(tmp_path / "nine.safetensors", neurons=9)
    file = tmp_path / "x.yaml"
    file.write_text(WEIGHTS)
    code, message = call(capsys, monkeypatch, "validate", str(file))
    assert code == 2
    absent, other, shipped, training = message.splitlines()
    assert absent.startswith(f"{file}:6:32: regions.absent.weights: there is no weights file {tmp_path}/none.safe")
    assert other.startswith(f"{file}:7:43: regions.other.weights: trained for `neurons: 9`, not `neurons: 8`: ")
    assert shipped.startswith(f"{file}:8:78: regions.shipped.weights: no shipped weights fit this `precision.hippo")
    assert training.startswith(f"{file}:15:24: train.0.region: there is no region `othre`; did you mean `other`?")


FAULTY = {
    "an unknown key": GOOD.replace("episode:", "episod:"),
    "a wrong wire": GOOD.replace("heard: a.said", "heard: c.mean"),
    "no weights": WEIGHTS.partition("train:")[0],
}


@pytest.mark.parametrize(
    ("command", "fault"),
    [
        (command, fault)
        for command in ("validate", "run", "compare", "train")
        for fault in FAULTY
        if (command, fault) != ("train", "no weights")  # they are to be trained
    ],
)
def test_what_needs_no_torch_is_told_without_waiting_for_it(tmp_path: Path, command: str, fault: str) -> None:
    (tmp_path / "x.yaml").write_text(FAULTY[fault])
    code = (
        "import sys\nfrom neurorobo.cli.main import main\n"
        f"sys.argv = ['neurorobo', '{command}', 'x.yaml']\n"
        "try:\n    main()\n"
        "except SystemExit as ended:\n    sys.exit(100 if 'torch' in sys.modules else ended.code)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("x.yaml:")
    assert [path.name for path in tmp_path.iterdir()] == ["x.yaml"]


@pytest.mark.parametrize(
    ("plugin", "words"),
    [
        ("import no_such_module", "failed to import: ModuleNotFoundError: No module named 'no_such_module'"),
        ("raise SystemExit(3)", "failed to import: SystemExit: 3"),
        (
            "from neurorobo.plugins import hookimpl\n@hookimpl\ndef neurorobo_register(registry): 1 / 0",
            "failed to register: ZeroDivisionError: division by zero",
        ),
    ],
)
def test_a_plugin_that_cannot_be_loaded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, plugin: str, words: str
) -> None:
    install_plugin(tmp_path, monkeypatch, "lamed", plugin)
    file = tmp_path / "x.yaml"
    file.write_text(GOOD.replace("minimal.echo", "lamed.echo"))
    code, message = call(capsys, monkeypatch, "validate", str(file))
    assert code == 2
    assert message == (
        f"{file}:6:10: regions.left.type: `lamed.echo` belongs to the plugin lamed-nr 0.2, which {words}\n"
    )


def test_a_network_that_cannot_be_imported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plugin = (
        "from neurorobo.plugins import hookimpl\nfrom neurorobo_minimal.plugin import EchoConfig\n"
        "class Config(EchoConfig):\n    implementation = 'lamed_network:Echo'\n    type: str\n"
        "@hookimpl\ndef neurorobo_register(registry): registry.add('region', 'lamed.echo', 'lamed_nr:Config')\n"
    )
    install_plugin(tmp_path, monkeypatch, "lamed", plugin)
    file = tmp_path / "x.yaml"
    file.write_text(GOOD.replace("minimal.echo", "lamed.echo"))
    code, message = call(capsys, monkeypatch, "run", str(file), "--out", str(tmp_path / "out"))
    assert code == 2
    assert message.startswith(f"{file}:6:3: regions.left: `lamed_network:Echo` cannot be imported (ModuleNotFoundError")
    assert "repair or reinstall the plugin that provides it" in message


@pytest.mark.parametrize("command", ["run", "train", "compare"])
def test_a_place_that_cannot_be_written_is_named_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    phase = "{phase: supervise, region: mind, teacher: {type: precision.law, period: control}, "
    phase += "data: precision.insertion_speeds, loss: {mean: 1 mN}, steps: 9999999}"
    file = tmp_path / "x.yaml"
    file.write_text(
        GOOD.replace("steps:", "  mind: {type: precision.hippocampus, period: control}\nsteps:")
        + f"train:\n  - {phase}\n"
    )
    (tmp_path / "taken").write_text("")
    code, message = call(capsys, monkeypatch, command, str(file), "--out", str(tmp_path / "taken" / "out"))
    assert code == 2
    *notes, last = message.splitlines()
    assert re.fullmatch(r".*/taken/out\S* cannot be written \(Not a directory\); make room for it, or choose .*", last)
    assert all(note.startswith("note: ") for note in notes)


def test_help_is_quick_to_import() -> None:
    code = (
        "import sys\nfrom neurorobo.cli.main import cli\n"
        "cli.main(['--help'], standalone_mode=False)\n"
        "sys.exit(bool({'torch', 'rerun', 'gymnasium', 'pint'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0
