"""Problems of values in words: what is given, what is allowed, and the remedy; loaded only if a file has problems."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel, ValidationError

from modaltouch.protocol.section import LARGEST, SMALLEST, Step, adapter, plain_word
from modaltouch.protocol.source import Problem, suggest
from modaltouch.protocol.tree import Node, resolve


def problems_of(reading: Any, error: ValidationError) -> list[Problem]:
    """Return the problems of a tree that its model rejects, without those that follow from others.

    Parameters
    ----------
    reading : Reading
        The tree and its model.
    error : ValidationError
        What the model rejects.
    """
    errors = error.errors(include_url=False)
    return [_translate(reading, each) for each in errors if not _follows(each, errors)]


def _follows(details: Any, errors: Iterable[Any]) -> bool:
    """Test whether a list is too short only because of invalid items, or a key missing only because it is misspelt."""
    loc, kind = details["loc"], details["type"]
    return any(
        (kind == "too_short" and len(other["loc"]) > len(loc) and other["loc"][: len(loc)] == loc)
        or (
            (kind, other["type"]) == ("missing", "extra_forbidden")
            and other["loc"][:-1] == loc[:-1]
            and suggest(str(other["loc"][-1]), [str(loc[-1])])
        )
        for other in errors
    )


def _translate(reading: Any, details: Any) -> Any:
    """Convert a pydantic error to a problem."""
    kind, path = str(details["type"]), _real_path(reading, details)
    context = details.get("ctx", {})
    if kind == "modaltouch":
        return reading.problem(path, context["given"], context["allowed"], context["remedy"])
    if kind == "extra_forbidden":
        known = keys_of(reading.model, path[:-1])
        return reading.unknown(path, "a key here", known, _home_of(reading.model, path), at_key=True)
    if details["loc"] and details["loc"][-1] == "[key]":
        allowed = context.get("expected") or "a word of letters, digits, _ and -"
        return reading.problem(
            path,
            f"{path[-1]!r} as a key",
            allowed.replace(" or ", ", "),
            f"write '{meant}'" if "expected" not in context and (meant := plain_word(path[-1])) else "",
            at_key=True,
        )
    if kind == "missing" and path and isinstance(path[-1], str):
        return reading.problem(path, "nothing", describe(reading.model, path), f"add the missing key `{path[-1]}`")
    if kind == "missing":
        path = path[:-1]
    node = reading.find(path)
    if kind == "string_type" and isinstance(details["input"], bool | int | float):
        return reading.problem(path, f"{_content_of(node)}, which is not text", "text", "write it in quotes")
    return reading.problem(
        path,
        _content_of(node) + (", which is not finite" if kind == "finite_number" else ""),
        describe(reading.model, path) + _beyond_all(details["input"]),
        _remedy(reading, path, node),
    )


def _home_of(model: type[BaseModel], path: tuple[Step, ...]) -> str:
    """Return a phrase with the section to which a misplaced key belongs; empty if there is none."""
    if path[-1] == "<<":
        return "YAML 1.2 has no merge keys: write out the keys that it would bring"
    homes = ["the top of the file, not indented"] * (len(path) > 1 and path[-1] in model.model_fields)
    homes += [f"the section {name}" for name in model.model_fields if path[-1] in keys_of(model, (name,))]
    return f"it belongs to {' or '.join(homes[:2])}" if homes else ""


def _beyond_all(value: object) -> str:
    """Return a phrase with the general bound of quantities if a value exceeds it, since `describe` does not have it."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return ""
    if abs(value) > LARGEST:
        return f", of at most {LARGEST:g} either way"
    return f", not that small: at least {SMALLEST:g}" if 0 < value < SMALLEST else ""


def _real_path(reading: Any, details: Any) -> tuple[Step, ...]:
    """Return the path of an error without pydantic's additions (branch tags, ``[key]``)."""
    path: list[Step] = []
    node = reading.root
    loc = details["loc"]
    for position, step in enumerate(loc):
        child = node.child(step) if node is not None else None
        if child is not None:
            path.append(step)
            node = child
        elif details["type"] == "missing" and position == len(loc) - 1:
            path.append(step)
    return tuple(path)


def _content_of(node: Node | None) -> str:
    """Describe the content of a node."""
    if node is None or node.content is None:
        return "nothing"
    if isinstance(node.content, list):
        return "an empty list" if not node.content else f"a list of {len(node.content)}"
    if isinstance(node.content, dict):
        return "a mapping"
    if isinstance(node.content, str):
        return repr(_shortened(node.content))
    return _shortened(node.text)


def _shortened(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def _remedy(reading: Any, path: tuple[Step, ...], node: Node | None) -> str:
    """Return the remedy for a value of the wrong kind."""
    allowed = describe(reading.model, path)
    if node is None:
        return ""
    words = _BETWEEN.split(node.text)
    values = [resolve(word) for word in words]
    if node.text and allowed.startswith("a list") and _fits(reading.model, path, values):
        # Names of keys are checked later, so these may be wrong.
        is_key = allowed.endswith("the name of a key")
        return "write names in brackets, as in [left, num_4]" if is_key else f"write [{', '.join(words)}]"
    if isinstance(node.content, str):
        number, after = suggest_number(node.content) if "number" in allowed else ("", "")
        if number:
            unit = unit_of(path)
            if after == "%" and not unit and _fits(reading.model, path, float(number) / 100):
                return f"write it as a share: {float(number) / 100:g}"
            only = f"write only the number: {number}" + ("; the unit is part of the key" if unit and after else "")
            return f"write the number in {unit}, without the unit" if unit and after not in ("", unit) else only
        is_item = bool(path) and isinstance(path[-1], int)
        if is_item and "number" in allowed and all(_fits(reading.model, path, value) for value in values):
            return f"write each number by itself, as in {', '.join(words)}"
        meant = suggest(node.content, allowed.split(", "))
        return f"did you mean '{meant}'?" if meant else ""
    if allowed == "text" and not isinstance(node.content, list | dict | None):
        return f'write "{node.text}" in quotes'
    if isinstance(node.content, float) and "whole number" in allowed and node.content == node.content // 1:
        return f"write {node.content:.0f}"
    return ""


def _fits(model: type[BaseModel], path: tuple[Step, ...], value: object) -> bool:
    """Test whether a value is allowed at a path of a model."""
    known = adapter(model, path)
    try:
        return known is not None and known.validate_python(value) is not None
    except ValidationError:
        return False


_BETWEEN = re.compile(r"\s*[;,]\s*|\s+")
"""What separates the items of a list that is written as one word."""


def describe(model: type[BaseModel], path: Iterable[Step]) -> str:
    """Describe what is allowed at a path of a model; empty if the model has no such path."""
    steps = tuple(path)
    known = adapter(model, steps)
    if known is None:
        return ""
    schema = known.json_schema()
    words = _in_words(schema, schema)
    unit = unit_of(steps)
    return words.replace("number", f"number [{unit}]", 1) if unit else words


def keys_of(model: type[BaseModel], path: Iterable[Step]) -> tuple[str, ...]:
    """Return the keys allowed in the mapping at a path; empty if any key is allowed."""
    known = adapter(model, tuple(path))
    schema = {} if known is None else known.json_schema()
    # An optional section is one of two branches; the other is null.
    branches = (_resolved(schema, branch) for branch in _branches(_resolved(schema, schema)))
    return tuple(dict.fromkeys(key for branch in branches for key in branch.get("properties", ())))


def _resolved(root: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    while "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rsplit("/", 1)[1]]
    return schema


def _branches(schema: dict[str, Any]) -> list[dict[str, Any]]:
    branches: list[dict[str, Any]] = schema.get("anyOf") or schema.get("oneOf") or []
    return [leaf for branch in branches for leaf in _branches(branch)] or [schema]


def _in_words(root: dict[str, Any], schema: dict[str, Any]) -> str:
    branches = [_resolved(root, branch) for branch in _branches(_resolved(root, schema))]
    return " or ".join(dict.fromkeys(_one_in_words(root, branch) for branch in branches))


def _one_in_words(root: dict[str, Any], schema: dict[str, Any]) -> str:
    if "x-allowed" in schema:
        return str(schema["x-allowed"])
    if "enum" in schema or "const" in schema:
        return ", ".join(str(value) for value in schema.get("enum", [schema.get("const")]))
    kind = schema.get("type")
    if kind in ("number", "integer"):
        return ("a whole number" if kind == "integer" else "a number") + _bounds(schema)
    if kind == "string":
        return "a word of letters, digits, _ and -" if "pattern" in schema else "text"
    if kind == "array":
        return _list_in_words(root, schema)
    if kind == "object":
        keys = schema.get("properties")
        return f"a mapping with the keys {', '.join(keys)}" if keys else "a mapping"
    return {"boolean": "true or false", "null": "null"}.get(str(kind), "")


def _list_in_words(root: dict[str, Any], schema: dict[str, Any]) -> str:
    prefix = schema.get("prefixItems")
    if prefix:
        each = dict.fromkeys(_in_words(root, item) for item in prefix)
        return f"a list of exactly {len(prefix)}, each {', '.join(each)}"
    least = "a list" if not schema.get("minItems") else f"a list of at least {schema['minItems']}"
    if "maxItems" in schema:
        least += f" and at most {schema['maxItems']}"
    return f"{least}, each {_in_words(root, schema.get('items', {}))}"


def _bounds(schema: dict[str, Any]) -> str:
    # The bounds against overflow do not belong in a message.
    schema = {key: value for key, value in schema.items() if value not in (LARGEST, -LARGEST)}
    if schema.get("minimum") == SMALLEST:
        schema = {**schema, "minimum": None, "exclusiveMinimum": 0}
    words = [
        f"{word} {schema[key]:g}"
        for key, word in (
            ("exclusiveMinimum", "above"),
            ("minimum", "of at least"),
            ("exclusiveMaximum", "below"),
            ("maximum", "at most"),
        )
        if schema.get(key) is not None
    ]
    if schema.get("multipleOf") == 2:
        words.append("even")
    return (" " + ", ".join(words)) if words else ""


_UNITS = {
    "mm": "mm",
    "ms": "ms",
    "us": "us",
    "s": "s",
    "Hz": "Hz",
    "kHz": "kHz",
    "V": "V",
    "g": "g",
    "N_per_mm": "N/mm",
    "N_s_per_m": "N s/m",
    "mm_s": "mm/s",
    "V_per_V": "V/V",
    "percent": "%",
    "mm_s_per_V": "mm/s per V",
    "mm_s2_per_V": "mm/s^2 per V",
}


def unit_of(path: Iterable[Step]) -> str:
    """Return the unit at the end of the last key of a path, or an empty string.

    >>> [unit_of([key, 0]) for key in ("peak_velocities_mm_s", "gain_V_per_V", "sensitivity_mm_s_per_V", "zones")]
    ['mm/s', 'V/V', 'mm/s per V', '']
    """
    words = next((step for step in reversed(tuple(path)) if isinstance(step, str)), "").split("_")
    return next((_UNITS[end] for n in range(1, len(words)) if (end := "_".join(words[n:])) in _UNITS), "")


# Only a unit may follow: the 1 of 1_000, of 1/3 or of a date is not the intended number.
_WITH_UNIT = re.compile(r"\s*([-+]?(?:[0-9]+(?:[.,][0-9]*)?|[.,][0-9]+)(?:[eE][-+]?[0-9]+)?)\s*((?:[^\W\d_]|[%°]).*|)")


def suggest_number(word: str) -> tuple[str, str]:
    """Split a word such as ``80 mm/s`` into number and unit; both are empty if it has no number.

    >>> suggest_number("80 mm/s"), suggest_number("0,5"), suggest_number("many")
    (('80', 'mm/s'), ('0.5', ''), ('', ''))
    """
    match = _WITH_UNIT.fullmatch(word)
    return (match.group(1).replace(",", "."), match.group(2).strip()) if match else ("", "")


def place_of(
    root: Node | None, path: tuple[Step, ...], *, at_key: bool
) -> tuple[tuple[str, int, int], tuple[Step, ...]]:
    """Return file, line and column of the value (or key) at a path, and its path as written in the file."""
    if root is None:
        return ("", 1, 1), path
    node = root
    place, depth = (node.line, node.column), 0
    while depth < len(path) and (child := node.child(path[depth])) is not None:
        step = path[depth]
        key_place = node.keys.get(step, place) if isinstance(step, str) else (child.line, child.column)
        # A block mapping begins on the line after its key, but users look at the key.
        is_section = isinstance(child.content, dict) or (at_key and depth == len(path) - 1)
        place = key_place if is_section else (child.line, child.column)
        node, depth = child, depth + 1
    if node.file and node.keys:
        return (node.file, *place), ("row" if isinstance(node.content, dict) else ", ".join(node.keys),)
    # A missing key is reported at the key of its section.
    # A value of a group or cell is in the tree twice: below its group or cell, and where it applies.
    return (node.file, *place), (*max(root.paths_of(node), key=len, default=path[:depth]), *path[depth:])
