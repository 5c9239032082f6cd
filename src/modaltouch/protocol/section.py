"""Types of the values in YAML files, and descriptions of allowed values for messages."""

from __future__ import annotations

import re
import types
import typing
from collections.abc import Iterable
from functools import lru_cache, reduce
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, TypeAdapter

from modaltouch.protocol.source import fault

RESERVED_NAMES = frozenset({"simulated", "pilot", "reference", "benchmarks", "analysis", "derivatives"})
"""Folders of the results tree, not allowed as names of protocols."""

DEVICE_NAMES = re.compile(r"(?i:con|prn|aux|nul|(com|lpt)[0-9])")
"""File names not allowed by Windows."""


class Section(BaseModel):
    """Base class of the frozen parts of a YAML file; unknown keys are rejected."""

    model_config = ConfigDict(frozen=True, extra="forbid", title=None, defer_build=True)


def described(text: str, **bounds: Any) -> Any:
    """Return a field with a description, shown by editors."""
    return Field(description=text, **bounds)


def _plain_file_name(name: str) -> str:
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", name) is None:
        raise fault(
            f"{name!r}, which is not a plain file name",
            "at most 64 letters, digits, _ and -, the first a letter or digit",
            "it names a folder of the results",
        )
    if name.casefold() in RESERVED_NAMES:
        kept = ", ".join(sorted(RESERVED_NAMES))
        raise fault(f"{name!r}, which is reserved in the results tree", f"any name but {kept}", "choose another")
    if DEVICE_NAMES.fullmatch(name):
        raise fault(f"{name!r}, which is a device on Windows", "any other name", "choose another")
    return name


SMALLEST, LARGEST = 1e-9, 1e12
"""Bounds of every quantity in any unit: wide enough for this experiment, narrow enough that nothing overflows."""

Number = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=SMALLEST, le=LARGEST)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=LARGEST)]
Spread = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=3)]
DampingRatio = Annotated[float, Field(strict=True, ge=SMALLEST, lt=1, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True, ge=1)]
Label = Annotated[int, Field(strict=True, ge=1, le=1000)]
Text = str
Word = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,32}$")]
FileName = Annotated[
    str,
    AfterValidator(_plain_file_name),
    Field(
        json_schema_extra={
            "pattern": "^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$",
            "not": {"enum": sorted(RESERVED_NAMES)},
            "x-allowed": "letters, digits, _ and -",
        }
    ),
]


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise fault(f"an interval from {pair[0]:g} to {pair[1]:g}", "the lower end first", "exchange them")
    return pair


Interval = Annotated[tuple[Number, Number], AfterValidator(_ordered)]
"""Lower and upper bounds."""


def plain_word(name: object) -> str:
    """Return the `Word` nearest to a name.

    >>> plain_word("very strong"), plain_word("強い")
    ('very_strong', '')
    """
    return re.sub(r"[^A-Za-z0-9_-]+", "_", str(name)).strip("_")[:32]


NUMBER_OR_LIST = Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "number")
"""Discriminator of the branches tagged ``number`` and ``list``."""

Step = str | int


@lru_cache(maxsize=1024)
def adapter(model: type[BaseModel], path: tuple[Step, ...]) -> TypeAdapter[Any] | None:
    """Return the type adapter for the value at a path of a model; None if the model has no such path."""
    annotation = annotation_at(model, path)
    return None if annotation is None else TypeAdapter(annotation)


def annotation_at(model: type[BaseModel], path: Iterable[Step]) -> Any:
    """Return the annotation at a path of a model, or None."""
    return reduce(_step_into, path, model)


def _step_into(annotation: Any, step: Step) -> Any:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Annotated:
        return _step_into(arguments[0], step)
    if origin in (typing.Union, types.UnionType):
        return next((found for branch in arguments if (found := _step_into(branch, step)) is not None), None)
    if origin is tuple and isinstance(step, int):
        return arguments[0] if arguments[-1] is Ellipsis else arguments[min(step, len(arguments) - 1)]
    if origin is dict and isinstance(step, str):
        return arguments[1]
    if isinstance(annotation, type) and issubclass(annotation, BaseModel) and step in annotation.model_fields:
        info = annotation.model_fields[str(step)]
        return Annotated[info.annotation, info] if info.metadata or info.json_schema_extra else info.annotation
    return None


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
    branches: list[dict[str, Any]] = schema.get("anyOf") or schema.get("oneOf") or [schema]
    return branches


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
