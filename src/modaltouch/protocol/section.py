"""Types of the values in YAML files."""

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
