"""JSON Schemas for editors are current and as strict as possible."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest

from modaltouch.protocol.schemas import SCHEMAS, write_schemas
from modaltouch.protocol.source import Source
from modaltouch.protocol.tree import parse_tree


def plain(file: Path) -> dict:
    """Return the values of a YAML file."""
    root, _ = parse_tree(Source(file, file.read_text(encoding="utf-8")))
    assert root is not None
    return root.plain()


def named_schema(file: Path) -> dict:
    """Return the schema that a YAML file names in its first line."""
    first = file.read_text(encoding="utf-8").splitlines()[0]
    assert first.startswith("# yaml-language-server: $schema=")
    return json.loads((file.parent / first.split("=", 1)[1]).read_text(encoding="utf-8"))


def test_committed_schemas_are_current(shipped: Path, tmp_path: Path) -> None:
    """`write_schemas` gives the contents of protocols/schema."""
    for file in write_schemas(tmp_path):
        committed = (shipped / "schema" / file.name).read_text(encoding="utf-8")
        assert committed == file.read_text(encoding="utf-8"), f"write {file.name} again with `make schemas`"


def test_schemas_are_json_schema_2020_12(shipped: Path) -> None:
    """Against the meta-schema of jsonschema."""
    for name in SCHEMAS:
        schema = json.loads((shipped / "schema" / f"{name}.json").read_text(encoding="utf-8"))
        jsonschema.Draft202012Validator.check_schema(schema)


def test_every_shipped_file_is_valid_under_its_schema(shipped: Path) -> None:
    """Its first line names the schema, for editors."""
    files = sorted(shipped.rglob("*.yaml"))
    assert len(files) >= 5
    for file in files:
        jsonschema.validate(plain(file), named_schema(file))


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("stimulus", "law", "exakt"),
        ("stimulus", "n_samples", 125_001),
        ("stimulus", "colour", "red"),
        ("conditions", "peak_velocities_mm_s", []),
        ("conditions", "peak_velocities_mm_s", [80, 80]),
        ("conditions", "zone_pairs", [["A"]]),
        ("answers", "keys", {"left": [], "right": ["right"]}),
    ],
)
def test_schemas_refuse_faults_within_one_file(shipped: Path, section: str, key: str, value: object) -> None:
    """Faults that do not involve another file."""
    file = shipped / "differentiated_stimulation.yaml"
    values = plain(file)
    values[section][key] = value
    with pytest.raises(jsonschema.ValidationError, match=r".+"):
        jsonschema.validate(values, named_schema(file))


def test_every_key_has_a_description(shipped: Path) -> None:
    """Editors show these texts."""
    for name in SCHEMAS:
        schema = json.loads((shipped / "schema" / f"{name}.json").read_text(encoding="utf-8"))
        for section in (schema, *schema.get("$defs", {}).values()):
            for key, value in section.get("properties", {}).items():
                named = schema["$defs"][value["$ref"].rsplit("/", 1)[1]] if "$ref" in value else value
                assert value.get("description") or named.get("description"), f"{name}: {key} has no description"
