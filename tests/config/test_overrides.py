from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurorobo.config.document import parse_document
from neurorobo.config.overrides import apply_overrides
from neurorobo.errors import ConfigError

TEXT = """
seed: 1
train:
  - {phase: a, epochs: 1}
  - {phase: b}
none: null
"""


def applied(*overrides: str) -> Any:
    return apply_overrides(parse_document(TEXT, "x.yaml"), overrides).value


def error(*overrides: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        applied(*overrides)
    return str(caught.value).splitlines()


@pytest.mark.parametrize(
    ("override", "path", "value"),
    [
        ("seed=3", ["seed"], 3),
        ("train.1.epochs=1e-3", ["train", 1, "epochs"], 0.001),
        ("train.0={phase: c}", ["train", 0], {"phase": "c"}),
        ("new.deep.key=0.5 um", ["new", "deep", "key"], "0.5 um"),
        ("none.key=on", ["none", "key"], "on"),
        ("seed=", ["seed"], None),
        ("reference=a=b", ["reference"], "a=b"),
        (" train . 0 . epochs = 5 ", ["train", 0, "epochs"], 5),
    ],
)
def test_an_override_sets_one_yaml_value(override: str, path: list[str | int], value: object) -> None:
    found = applied(override)
    for part in path:
        found = found[part]
    assert found == value


def test_all_else_stays_and_the_document_itself_too() -> None:
    document = parse_document(TEXT, "x.yaml")
    changed = apply_overrides(document, ["train.0.epochs=2", "train.0.epochs=3"])
    assert changed.value == document.value | {"train": [{"phase": "a", "epochs": 3}, {"phase": "b"}]}
    assert document.value == parse_document(TEXT, "x.yaml").value


names = st.from_regex(r"[a-z_]{1,5}", fullmatch=True)


@given(st.lists(names, min_size=1, max_size=4), st.integers())
def test_any_path_of_new_keys_can_be_set(path: list[str], number: int) -> None:
    found = apply_overrides(parse_document("other: 1", "x.yaml"), [f"new.{'.'.join(path)}={number}"]).value["new"]
    for part in path:
        found = found[part]
    assert found == number


def test_the_place_of_what_an_override_set_is_the_override() -> None:
    document = apply_overrides(parse_document(TEXT, "x.yaml"), ["train.0={phase: c}", "train.0.epochs=2"])
    assert document.place(("train", 0, "epochs")) == "--set train.0.epochs=2"
    assert document.place(("train", 0, "phase")) == "--set train.0={phase: c}"
    assert document.place(("train", 1)) == "x.yaml:5:5"
    assert document.place(("seed",)) == "x.yaml:2:1"


def test_the_place_of_what_overrides_have_changed_in_part_names_them_too() -> None:
    overrides = ["train.0.epochs=2", "train.0.epochs=3", "train.1.phase=c", "new.deep.key=1"]
    document = apply_overrides(parse_document(TEXT, "x.yaml"), overrides)
    assert document.place(("train", 0)) == "x.yaml:4:5 with --set train.0.epochs=3"
    assert document.place(("train",)) == "x.yaml:3:1 with --set train.0.epochs=3 with --set train.1.phase=c"
    assert document.place(("new", "deep", "missing")) == "--set new.deep.key=1"
    assert document.place(("new", "missing")) == "--set new.deep.key=1"
    assert document.place(("missing",)) == "x.yaml:1:1"


def test_a_key_below_a_bare_name_keeps_the_name_as_its_type() -> None:
    document = apply_overrides(
        parse_document("region: planner  # short", "x.yaml"), ["region.gain=2", "region.width=3"]
    )
    assert document.value == {"region": {"type": "planner", "gain": 2, "width": 3}}
    assert document.place(("region", "gain")) == "--set region.gain=2"
    assert document.place(("region", "width")) == "--set region.width=3"


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ("seed", "--set seed: is not of the form key.key=value"),
        ("a..b=1", "--set a..b=1: is not of the form key.key=value"),
        ("=1", "--set =1: is not of the form key.key=value"),
        ("seed.x=1", "--set seed.x=1: `seed` is 1, which has no `x`"),
        ("train.2.epochs=1", "--set train.2.epochs=1: `train` is a list and has the indices 0 to 1 (got '2')"),
        ("train.-1.epochs=1", "--set train.-1.epochs=1: `train` is a list and has the indices 0 to 1 (got '-1')"),
        ("train.first=1", "--set train.first=1: `train` is a list and has the indices 0 to 1 (got 'first')"),
    ],
)
def test_an_override_that_does_not_fit_is_named(override: str, line: str) -> None:
    assert error(override) == [line]


def test_all_overrides_that_do_not_fit_are_named() -> None:
    lines = error("seed", "seed=2", "a=[1", "train.9=1")
    assert len(lines) == 3
    assert lines[1].startswith("--set a=[1:1:3: is not valid YAML: expected ',' or ']'")
