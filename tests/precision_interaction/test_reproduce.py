"""The reproduction: what is kept, what is measured again, and what a report says."""

import json
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from click.testing import CliRunner
from precision_interaction.reproduce import command, dependencies, store
from precision_interaction.reproduce.command import measure_missing, reproduce
from precision_interaction.reproduce.pages import report
from precision_interaction.reproduce.pages.every import pages
from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted, duration
from precision_interaction.reproduce.pages.statistics import cell, interval, quotient
from precision_interaction.reproduce.row import Result, Row, Setting
from precision_interaction.reproduce.store import Store

from neurorobo.errors import NeuroroboError


class Toy(Row):
    """Two cells; the second fails while a file says so."""

    name: ClassVar[str] = "toy"

    def cells(self, setting: Setting) -> Sequence[str]:
        return ["one", "two"]

    def measure(self, cell: str, setting: Setting) -> Result:
        if cell == "two" and (setting.examples / "broken").exists():
            raise NeuroroboError("the toy is broken; remove the file")
        if cell == "two" and (setting.examples / "slow").exists():
            time.sleep(600)
        return {"value": len(cell), "when": time.time()}

    def files(self, setting: Setting) -> Sequence[Path]:
        return [setting.examples / "input.txt"]

    def words(self, setting: Setting) -> Sequence[str]:
        file = setting.examples / "word.txt"
        return [file.read_text()] if file.exists() else []


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    lines = [[name, str(result["value"])] for name, result in results.items()]
    wanted = Wanted()
    wanted.at_most("three", 3, 2)
    wanted.at_least("three", 3, 3)
    return Presentation(["Some `words` & *more*."], [Table(["cell", "value"], lines, "caption")], (), wanted.misses)


PAGE = Page(Toy(), title="A toy & its <cells>", paper="Fig. 0", minutes=0, present=present)


@pytest.fixture
def setting(tmp_path: Path) -> Setting:
    (tmp_path / "input.txt").write_text("1")
    return Setting(tmp_path)


def test_results_are_kept_and_not_measured_again(setting: Setting, tmp_path: Path) -> None:
    measure_missing([Store(tmp_path, Toy(), setting)], setting, jobs=1)
    first = Store(tmp_path, Toy(), setting)
    assert first.missing() == []
    assert {name: result["value"] for name, result in first.results().items()} == {"one": 3, "two": 3}
    measure_missing([first], setting, jobs=1)
    assert Store(tmp_path, Toy(), setting).results() == first.results()


def test_what_failed_is_named_and_what_is_done_is_kept(setting: Setting, tmp_path: Path) -> None:
    (tmp_path / "broken").touch()
    with pytest.raises(NeuroroboError, match="the toy is broken"):
        measure_missing([Store(tmp_path, Toy(), setting)], setting, jobs=1)
    assert Store(tmp_path, Toy(), setting).missing() == ["two"]


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Take Ctrl-C as a Ctrl-C, also where a shell has begun the tests in the background, and told them to ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interrupt_stops_at_once_and_says_what_is_kept(
    setting: Setting, tmp_path: Path, capsys: pytest.CaptureFixture[str], interruptible: None
) -> None:
    (tmp_path / "slow").touch()
    kept = Store(tmp_path, Toy(), setting)
    interrupted: list[float] = []

    def interrupt_when_one_is_kept() -> None:
        while not kept.file.exists():
            time.sleep(0.05)
        time.sleep(0.2)
        interrupted.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt_when_one_is_kept, daemon=True).start()
    with pytest.raises(KeyboardInterrupt, match=r"1 of 2 cells are kept in .*; the same command goes on from there"):
        measure_missing([kept], setting, jobs=2)
    assert time.monotonic() - interrupted[0] < 5
    while multiprocessing.active_children() and time.monotonic() - interrupted[0] < 30:
        time.sleep(0.05)
    assert not multiprocessing.active_children()
    (tmp_path / "slow").unlink()
    capsys.readouterr()
    measure_missing([Store(tmp_path, Toy(), setting)], setting, jobs=1)
    assert "1 of 2 cells are there from before; to be measured: 1" in capsys.readouterr().err


def test_a_changed_file_or_scale_has_everything_measured_again(setting: Setting, tmp_path: Path) -> None:
    measure_missing([Store(tmp_path, Toy(), setting)], setting, jobs=1)
    assert Store(tmp_path, Toy(), Setting(tmp_path, quick=True)).missing() == ["one", "two"]
    for name in ("input.txt", "word.txt"):
        (tmp_path / name).write_text("2")
        changed = Store(tmp_path, Toy(), setting)
        assert changed.missing() == ["one", "two"]
        measure_missing([changed], setting, jobs=1)


def test_a_cell_has_one_thread_also_where_there_is_one_process(
    setting: Setting, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Toy, "measure", lambda self, cell, setting: {"threads": torch.get_num_threads()})
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        store = Store(tmp_path, Toy(), setting)
        measure_missing([store], setting, jobs=1)
        assert {found["threads"] for found in store.results().values()} == {1}
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)


def test_a_row_of_one_version_is_whole_and_of_two_is_not(setting: Setting, tmp_path: Path) -> None:
    measure_missing([Store(tmp_path, Toy(), setting)], setting, jobs=1)
    (tmp_path / "input.txt").write_text("2")
    changed = Store(tmp_path, Toy(), setting)
    assert changed.missing() and changed.whole  # older, but all of one version: the report shows it with its commit
    (tmp_path / "broken").touch()
    with pytest.raises(NeuroroboError, match="the toy is broken"):
        measure_missing([changed], setting, jobs=1)
    assert not Store(tmp_path, Toy(), setting).whole


def test_a_cell_whose_code_changed_while_it_was_measured_is_not_kept(setting: Setting, tmp_path: Path) -> None:
    begun = Store(tmp_path, Toy(), setting)
    assert begun.missing() == ["one", "two"]
    begun.add("one", {"value": 3}, 0.0)
    (tmp_path / "input.txt").write_text("2")
    with pytest.raises(NeuroroboError, match=r"toy, two: .* changed while this was measured.* run this again"):
        begun.add("two", {"value": 3}, 0.0)
    assert set(Store(tmp_path, Toy(), setting).kept) == {"one"}


def test_what_a_module_imports_is_read_anew_when_it_is_to_be_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "toy.py"
    source.write_text("import neurorobo.clock\n")
    monkeypatch.setattr(dependencies, "_source", lambda module: source if module == "toy" else None)
    dependencies.forget()
    before = dependencies.fingerprint("toy", [])
    source.write_text("import neurorobo.units\n")
    dependencies.forget()
    assert dependencies.fingerprint("toy", []) != before
    dependencies.forget()


def test_the_quotient_of_two_means_is_that_of_pairs() -> None:
    under = [1.0, 2.0, 4.0, 8.0]
    assert quotient([2.0 * value for value in under], under) == pytest.approx((2.0, 2.0, 2.0))
    share, low, high = quotient([2.0, 1.0, 8.0, 4.0], under)
    assert low < share < high


def test_damaged_results_are_named(setting: Setting, tmp_path: Path) -> None:
    (tmp_path / "toy.json").write_text('{"cells": ')
    with pytest.raises(NeuroroboError, match=r"toy\.json is damaged .* remove it"):
        Store(tmp_path, Toy(), setting)


def test_a_row_depends_on_all_that_its_code_imports_and_names() -> None:
    found = dependencies.modules("precision_interaction.reproduce.hippocampus")
    for module in (
        "precision_interaction.reproduce.row",
        "neurorobo.engine.native",
        "precision_interaction.regions.hippocampus",
        "precision_interaction.teachers.contact_expectation",  # by the name that the plugin registers: precision.law
    ):
        assert module in found
    for module in ("rig.insertion_rig", "regions.cerebellum", "plugin", "reproduce.command"):
        assert f"precision_interaction.{module}" not in found


def test_a_row_does_not_depend_on_bystanders() -> None:
    module, rollout = "precision_interaction.reproduce.hippocampus", "neurorobo.experiment.rollout"
    every, fewer = dependencies.modules(module), dependencies.modules(module, frozenset({rollout}))
    assert {rollout, "neurorobo.experiment.closed_loop"} <= every - fewer
    assert "neurorobo.learning.supervise" in fewer


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.row.name)
def test_no_row_depends_on_how_rows_are_shown(page: Page) -> None:
    found = dependencies.modules(type(page.row).__module__)
    assert not [module for module in found if module.startswith("precision_interaction.reproduce.pages")]


def test_a_row_depends_on_what_its_examples_name(tmp_path: Path) -> None:
    def hashed(text: str) -> str:
        file = tmp_path / "a.yaml"
        file.write_text(text)
        return dependencies.fingerprint("precision_interaction.table_one", [file])

    named = {name: dependencies._registered_in(name) for name in ("precision.insertion_rig", "lif", "plan.speed")}
    assert list(named["precision.insertion_rig"]) == ["precision_interaction.rig.insertion_rig_config"]
    assert list(named["lif"]) == ["neurorobo.neurons.config"]
    assert list(named["plan.speed"]) == []
    assert hashed("body: precision.insertion_rig") == hashed("body: precision.insertion_rig")
    assert "precision_interaction.rig.insertion_rig" in dependencies.modules(
        "precision_interaction.rig.insertion_rig_config"
    )


def test_the_fingerprint_is_of_content(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_text("1")
    module = "precision_interaction.reproduce.pages.statistics"
    first = dependencies.fingerprint(module, [file], ["x"])
    assert first == dependencies.fingerprint(module, [file], ["x"])
    assert first != dependencies.fingerprint(module, [file], ["y"])
    file.write_text("2")
    assert first != dependencies.fingerprint(module, [file], ["x"])


def test_the_report_shows_every_row(setting: Setting, tmp_path: Path) -> None:
    kept = Store(tmp_path / "results", Toy(), setting)
    measure_missing([kept], setting, jobs=1)
    path = report.write_report(tmp_path, [(PAGE, kept)], setting, "neurorobo reproduce toy")
    page, markdown = path.read_text(), (tmp_path / "index.md").read_text()
    assert "<h2>Fig. 0: A toy &amp; its &lt;cells&gt;</h2>" in page
    assert "<code>words</code> &amp; <em>more</em>" in page
    assert "| one | 3 |" in markdown
    for text in (page, markdown):
        assert "Missed: three is 3, wanted at most 2." in text
        assert "neurorobo reproduce toy" in text
        assert "http" not in text  # it holds all that it shows


def test_pictures_are_drawn_the_same_each_time(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from precision_interaction.reproduce.pages.plotting import save

    picture = Picture("line", "A line.", lambda figure: figure.subplots().plot([0, 1], [0, 1]))
    first = [file.read_bytes() for file in save(picture, tmp_path)]
    assert first == [file.read_bytes() for file in save(picture, tmp_path)]


def test_an_interval_covers_the_mean() -> None:
    mean, low, high = interval([1.0, 2.0, 3.0, 4.0])
    assert low < mean == 2.5 < high
    assert cell([3.0, 3.0]) == "3.0"
    assert cell([3.0]) == "3.0"
    assert cell([1.0, 2.0, 3.0, 4.0]).startswith("2.5 [")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nonsense"], "there is no row `nonsense`; there are: "),
        (["--examples", "nowhere"], "nowhere holds no peg_in_hole.yaml"),
    ],
)
def test_mistakes_are_named(arguments: list[str], words: str) -> None:
    with pytest.raises(NeuroroboError, match=words):
        CliRunner().invoke(reproduce, arguments, catch_exceptions=False, standalone_mode=False)


def test_rows_have_names_of_their_own_and_are_listed() -> None:
    names = [page.row.name for page in pages()]
    assert len(set(names)) == len(names)
    listed = CliRunner().invoke(reproduce, ["--list"])
    assert all(name in listed.output for name in names)


def test_no_time_is_told_as_no_time() -> None:
    assert [duration(seconds) for seconds in (0.01, 7.4, 59.4, 66, 924)] == [
        "1 second",
        "7 seconds",
        "59 seconds",
        "1.1 minutes",
        "15.4 minutes",
    ]


def test_results_that_are_no_numbers_are_refused() -> None:
    with pytest.raises(ValueError, match="JSON"):
        store.as_json({"value": float("nan")})
    assert store.as_json({"value": (1, 2)}) == {"value": [1, 2]}


def test_the_commit_is_told_if_there_is_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert store.commit() == "unknown"


def test_the_command_measures_and_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "pages", lambda: (PAGE,))
    (tmp_path / "input.txt").write_text("1")
    (tmp_path / "peg_in_hole.yaml").touch()
    done = CliRunner().invoke(
        reproduce,
        ["--out", str(tmp_path / "out"), "--examples", str(tmp_path), "--quick", "--jobs", "1"],
        catch_exceptions=False,
        standalone_mode=False,
    )
    assert done.exit_code == 0
    assert (tmp_path / "out" / "report.html").exists()
    assert json.loads((tmp_path / "out" / "results" / "toy.json").read_text())["cells"].keys() == {"one", "two"}
