"""JSON Schemas of the YAML files, for completion and checks in editors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.calibration import AnyCalibration
from modaltouch.protocol.observers import ObserverFile
from modaltouch.protocol.placements import FingersFile
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.texts import Texts

SCHEMAS: dict[str, type[BaseModel]] = {
    "protocol": Protocol,
    "apparatus": Apparatus,
    "texts": Texts,
    "observer": ObserverFile,
    "calibration": AnyCalibration,
    "fingers": FingersFile,
}
"""Model of each kind of file."""


def schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file, by its name in `SCHEMAS`."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **_without(SCHEMAS[name].model_json_schema(), "x-allowed"),
    }


def write_schemas(folder: Path) -> tuple[Path, ...]:
    """Write the JSON Schemas to a folder and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = tuple(folder / f"{name}.json" for name in SCHEMAS)
    for file, name in zip(files, SCHEMAS, strict=True):
        file.write_text(json.dumps(schema(name), indent=2, ensure_ascii=False) + "\n", encoding="utf-8", newline="\n")
    return files


def _without(value: Any, key: str) -> Any:
    if isinstance(value, dict):
        return {name: _without(each, key) for name, each in value.items() if name != key}
    return [_without(each, key) for each in value] if isinstance(value, list) else value
