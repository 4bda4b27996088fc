"""The schema is checked with a small validator of its own, which knows the keywords that the schema uses."""

import json
import os
import re
import subprocess
import sys
from typing import Any

import pytest

from neurorobo.config.document import parse_document
from neurorobo.config.schema import experiment_schema
from neurorobo.plugins import Registry

from .conftest import Load
from .test_experiment import GOOD

TYPES: dict[str, type | tuple[type, ...]] = {
    "object": dict,
    "array": list,
    "string": str,
    "integer": int,
    "number": (int, float),
    "boolean": bool,
    "null": type(None),
}


APPLIES_TO: dict[str, type | tuple[type, ...]] = {
    "required": dict,
    "properties": dict,
    "additionalProperties": dict,
    "minProperties": dict,
    "maxProperties": dict,
    "items": list,
    "minItems": list,
    "minimum": (int, float),
    "exclusiveMinimum": (int, float),
    "exclusiveMaximum": (int, float),
    "pattern": str,
}


def valid(schema: Any, value: Any, root: Any) -> bool:
    if isinstance(schema, bool):
        return schema
    return all(
        holds(schema, keyword, value, root) for keyword in schema if isinstance(value, APPLIES_TO.get(keyword, object))
    )


def holds(schema: Any, keyword: str, value: Any, root: Any) -> bool:
    content = schema[keyword]
    match keyword:
        case "$ref":
            return valid(root["$defs"][content.removeprefix("#/$defs/")], value, root)
        case "type":
            return isinstance(value, TYPES[content]) and (content == "boolean" or not isinstance(value, bool))
        case "const":
            return bool(value == content)
        case "enum":
            return value in content
        case "oneOf":
            return sum(valid(option, value, root) for option in content) == 1
        case "anyOf":
            return any(valid(option, value, root) for option in content)
        case "if":
            return valid(schema["then"] if valid(content, value, root) else schema["else"], value, root)
        case "required":
            return set(content) <= set(value)
        case "properties":
            return all(valid(part, value[key], root) for key, part in content.items() if key in value)
        case "additionalProperties":
            return all(valid(content, value[key], root) for key in set(value) - set(schema.get("properties", {})))
        case "items":
            return all(valid(content, item, root) for item in value)
        case "minItems" | "minProperties":
            return len(value) >= content
        case "maxProperties":
            return len(value) <= content
        case "minimum":
            return bool(value >= content)
        case "maximum":
            return bool(value <= content)
        case "exclusiveMinimum":
            return bool(value > content)
        case "exclusiveMaximum":
            return bool(value < content)
        case "pattern":
            return re.search(content, value) is not None
        case "$schema" | "$defs" | "title" | "description" | "default" | "examples" | "discriminator" | "then" | "else":
            return True
    raise AssertionError(f"a keyword that editors may not know: {keyword}")


@pytest.fixture
def schema(registry: Registry) -> dict[str, Any]:
    return experiment_schema(registry)


def test_good_files_satisfy_the_schema_as_given_and_resolved(schema: dict[str, Any], load: Load) -> None:
    experiment = load(GOOD)
    assert valid(schema, experiment.document.value, schema)
    assert valid(schema, experiment.resolved(), schema)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("  stage_", "  stag_"),
        ("500 nm", "0.5"),
        ("size: 3", "size: -3"),
        ("size: 3, ", ""),
        ("kind: adaptive", "kind: adaptiv"),
        ("zoo.cortex", "zoo.cortx"),
        ("zoo.cortex", "zoo.rig"),
        ("zoo.drill", "zoo.dril"),
        ("zoo.tape", "zoo.tap"),
        ("neurorobo: 1", "neurorobo: 2"),
        ("name: reach\n", ""),
        ("1 s", "1"),
        ("state: fork", "state: frok"),
        ("previous plan.speed", "3"),
        ("repeat: 2", "repeat: 0"),
        ("- plan:", "- act: {use: cortex}\n    plan:"),
    ],
)
def test_what_the_loader_refuses_the_schema_refuses_too(schema: dict[str, Any], old: str, new: str) -> None:
    assert valid(schema, parse_document(GOOD, "x.yaml").value, schema)
    assert not valid(schema, parse_document(GOOD.replace(old, new, 1), "x.yaml").value, schema)


def test_types_are_offered_with_their_own_fields_and_nested_kinds(schema: dict[str, Any]) -> None:
    definitions = schema["$defs"]
    assert definitions["region zoo.cortex"]["properties"]["type"] == {"enum": ["zoo.cortex"]}
    assert definitions["region core.sum"]["properties"]["type"] == {"enum": ["core.sum", "sum"]}
    assert definitions["neuron zoo.neuron"]["properties"]["threshold"]["default"] == "1 mV"
    assert "region zoo.ghost" not in definitions


def test_defaults_are_shown_as_they_are_written(schema: dict[str, Any]) -> None:
    cortex = schema["$defs"]["region zoo.cortex"]["properties"]
    assert cortex["gain"]["default"] == "80 mN/um"
    assert cortex["speed"]["default"] == "0..100 um/s"
    assert cortex["membrane"]["default"] == {"kind": "spiking", "time_constant": "20 ms", "decay": 0.5}


def test_every_reference_resolves_and_every_definition_is_used(registry: Registry) -> None:
    schema = experiment_schema(registry)
    text = json.dumps(schema)
    definitions = schema["$defs"]
    assert {name for name in re.findall(r'"#/\$defs/([^"]+)"', text)} == set(definitions)


def test_the_schema_is_the_same_in_every_process_and_needs_nothing_heavy() -> None:
    code = (
        "import json, sys; from neurorobo.plugins import Registry; "
        "from neurorobo.config.schema import experiment_schema; "
        "print(json.dumps(experiment_schema(Registry())), *{'torch', 'rerun', 'gymnasium', 'pint'} & set(sys.modules))"
    )
    outputs = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    [output] = outputs
    assert output.rstrip().endswith("}")
