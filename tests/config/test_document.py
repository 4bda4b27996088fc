# ruff: noqa: E501 (messages are whole lines)
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from neurorobo.config.document import Document, dump, load_document, parse_document
from neurorobo.errors import ConfigError, Fault


def value(text: str) -> object:
    return parse_document(f"x: {text}", "x.yaml").value["x"]


def error(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        parse_document(text, "x.yaml")
    return str(caught.value).splitlines()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1e-3", 0.001),
        ("1e3", 1000.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("-.inf", float("-inf")),
        ("010", 10),
        ("0o10", 8),
        ("0x10", 16),
        ("12:30", "12:30"),
        ("2026-01-01", "2026-01-01"),
        ("on", "on"),
        ("no", "no"),
        ("Yes", "Yes"),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("'5'", "5"),
        ("!!str 5", "5"),
        ("1_000", "1_000"),
        ("0.5 um", "0.5 um"),
        ("[a, 1, {b: c}]", ["a", 1, {"b": "c"}]),
        ("&a [1]", [1]),
    ],
)
def test_scalars_are_those_of_yaml_1_2(text: str, expected: object) -> None:
    found = value(text)
    assert found == expected
    assert type(found) is type(expected)


plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@settings(max_examples=50)
@given(st.dictionaries(st.text(), plain, max_size=3))
def test_what_is_dumped_reads_back_and_means_the_same_to_a_yaml_1_1_reader(content: dict[str, object]) -> None:
    text = dump(content)
    assert yaml.safe_load(text) == content
    assert parse_document(text, "x.yaml").value == content


@pytest.mark.parametrize("text", ["1e3", "0o7", "on", "12:30", "1_000", "null", "", "2026-01-01"])
def test_a_text_that_looks_like_something_else_survives_a_dump(text: str) -> None:
    dumped = dump({"x": text})
    assert parse_document(dumped, "x.yaml").value == {"x": text}
    assert yaml.safe_load(dumped) == {"x": text}


def test_places_are_those_of_keys_and_of_list_items() -> None:
    document = parse_document("a:\n  b: 1\n  c:\n    - x\n    - {d: 2,\n       e: 3}\n", "x.yaml")
    assert document.mark(()) == (1, 1)
    assert document.mark(("a", "b")) == (2, 3)
    assert document.mark(("a", "c", 0)) == (4, 7)
    assert document.mark(("a", "c", 1, "d")) == (5, 8)
    assert document.mark(("a", "c", 1, "e")) == (6, 8)
    assert document.place(("a", "b")) == "x.yaml:2:3"


def test_the_place_of_what_is_missing_is_that_of_what_lacks_it() -> None:
    document = parse_document("a:\n  b: {c: 1}\n", "x.yaml")
    assert document.mark(("a", "b", "missing", "further")) == (2, 3)
    assert document.mark(("missing",)) == (1, 1)


def test_every_duplicate_key_is_reported_with_both_its_lines() -> None:
    assert error("a: 1\nb:\n  c: 1\n  c: 2\na: 2\na: 3\n") == [
        "x.yaml:4:3: b.c: duplicate key `c` (first at line 3); remove one of them",
        "x.yaml:5:1: a: duplicate key `a` (first at line 1); remove one of them",
        "x.yaml:6:1: a: duplicate key `a` (first at line 1); remove one of them",
    ]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "x.yaml:1:1: is empty; an experiment starts with 'neurorobo: 1'"),
        ("# nothing\n\n", "x.yaml:1:1: is empty; an experiment starts with 'neurorobo: 1'"),
        ("\n- 1\n", "x.yaml:2:1: is a list, not a mapping; an experiment starts with 'neurorobo: 1'"),
        ("hello", "x.yaml:1:1: is a single value, not a mapping; an experiment starts with 'neurorobo: 1'"),
        ("a: b: c", "x.yaml:1:5: is not valid YAML: mapping values are not allowed here"),
        (
            "a:\n  - [1, 2\nb: 1",
            "x.yaml:3:2: is not valid YAML: expected ',' or ']', but got ':' while parsing a flow sequence, which opens at 2:5",
        ),
        (
            "a: 1\n\tb: 2",
            "x.yaml:2:1: is not valid YAML: found character '\\t' that cannot start any token while scanning for the next token",
        ),
        ('a: 1\nb: "c\nd: 2\n', "x.yaml:2:4: is not valid YAML: a quote opens here that is not closed; close it"),
        ("a: 1\nb: 'c\n---\n", "x.yaml:2:4: is not valid YAML: a quote opens here that is not closed; close it"),
        ('a: 1\nb: "c\nd: "e"\n', "x.yaml:2:4: is not valid YAML: a quote opens here that is not closed; close it"),
        (
            "a: 'b' c\n",
            "x.yaml:1:8: is not valid YAML: expected <block end>, but found '<scalar>' while parsing a block mapping",
        ),
        ("a: *b", "x.yaml:1:4: is not valid YAML: found undefined alias 'b'"),
        ("a: 1\nb: \x00", "x.yaml:2:4: is not valid YAML: the character '\\x00' is not allowed"),
        (
            "a: 1\n---\nb: 1",
            "x.yaml:2:1: is not valid YAML: but found another document expected a single document in the stream",
        ),
        (
            "a: !!python/name:os.system x",
            "x.yaml:1:4: a: the tag 'tag:yaml.org,2002:python/name:os.system' is not allowed",
        ),
        ("a: !cure x", "x.yaml:1:4: a: the tag '!cure' is not allowed"),
        ("1: a", "x.yaml:1:1: a key must be text (got 1); put it in quotes"),
        ("[1]: a", "x.yaml:1:1: a key must be text (got a list or mapping); put it in quotes"),
        ("a: &x {b: 1}\nc: {<<: *x}", "x.yaml:2:5: c: YAML 1.2 has no merge key '<<'; write the keys out"),
    ],
)
def test_what_is_no_document_gives_one_line_with_its_place(text: str, line: str) -> None:
    assert error(text) == [line]


def test_an_anchor_s_copies_are_independent_values() -> None:
    found = parse_document("a: &x {b: [1]}\nc: *x\n", "x.yaml")
    found.value["a"]["b"].append(2)
    assert found.value["c"] == {"b": [1]}
    assert found.mark(("c", "b")) == (1, 8)


def test_anchors_cannot_multiply_without_end() -> None:
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 12)
    )
    [line] = error(bomb)
    assert "holds more than 100000 values" in line


@pytest.mark.parametrize("text", ["a: &x [*x]", "a: " + "[" * 1000, "a: &x {b: *x}"])
def test_endless_nesting_is_refused(text: str) -> None:
    [line] = error(text)
    assert "nested too deeply" in line


@given(st.text())
def test_any_text_is_either_a_mapping_or_a_config_error(text: str) -> None:
    try:
        assert isinstance(parse_document(text, "x.yaml").value, dict)
    except ConfigError as error:
        assert str(error).startswith("x.yaml:")


def test_files_that_cannot_be_read_are_config_errors(tmp_path: Path) -> None:
    def line(path: Path) -> str:
        with pytest.raises(ConfigError) as caught:
            load_document(path)
        return str(caught.value).removeprefix(f"{path}:1:1: ")

    (tmp_path / "latin.yaml").write_bytes("a: b\nc: é".encode("latin-1"))
    (tmp_path / "image.png").write_bytes(b"\x89PNG\r\n\x1a\n\x00")
    assert line(tmp_path / "missing.yaml") == "there is no such file"
    assert line(tmp_path) == "cannot be read: Is a directory"
    assert (
        line(tmp_path / "latin.yaml")
        == f"{tmp_path}/latin.yaml:2:4: is not text in UTF-8: there is a byte 0xe9; save the file as UTF-8"
    )
    assert line(tmp_path / "image.png") == "is not text in UTF-8: there is a byte 0x89; save the file as UTF-8"


def test_a_file_is_read_with_its_text_and_without_its_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\n")
    document = load_document(path)
    assert isinstance(document, Document)
    assert (document.value, document.text, document.source) == ({"a": 1}, "a: 1\n", str(path))


def test_a_fault_prints_its_path() -> None:
    assert str(Fault(("steps", 0, "plan"), "is wrong")) == "steps.0.plan: is wrong"
    assert str(Fault((), "is wrong")) == "is wrong"
