"""What the files of the lab's commands share."""

from __future__ import annotations

from typing import Any

DARK, MIDDLE, LIGHT = "#0b3c8c", "#5bb8e8", "#dbe3ee"
"""Measured, predicted, asked for: far apart in lightness, so that they differ without colour."""


def rounded(value: Any, digits: int) -> Any:
    """Plain values with every number to some decimals."""
    if isinstance(value, dict):
        return {key: rounded(each, digits) for key, each in value.items()}
    if isinstance(value, list):
        return [rounded(each, digits) for each in value]
    return round(value, digits) if isinstance(value, float) else value


def yaml_text(values: dict[str, Any]) -> str:
    """Plain values as YAML, their innermost lists and mappings on one line."""
    import io

    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 200
    yaml.allow_unicode = True
    stream = io.StringIO()
    yaml.dump(values, stream)
    return stream.getvalue()
