"""The kinds of value that files are made of."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from modaltouch.protocol.document.problems import fault

RESERVED_NAMES = frozenset({"simulated", "pilot", "reference", "benchmarks", "analysis", "derivatives"})
"""Folders of a results tree that no protocol may be called after."""

DEVICE_NAMES = re.compile(r"(?i:con|prn|aux|nul|(com|lpt)[0-9])")
"""No file of Windows can have such a name."""


class Section(BaseModel):
    """A frozen part of a YAML file; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", title=None)


def described(text: str, **bounds: Any) -> Any:
    """Return a field whose description becomes the text that editors show."""
    return Field(description=text, **bounds)


def _plain_file_name(name: str) -> str:
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", name) is None:
        allowed = "at most 64 letters, digits, _ and -, the first a letter or digit"
        raise fault(f"{name!r}, which is no plain file name", allowed, "it names a folder of the results")
    if name.casefold() in RESERVED_NAMES:
        kept = ", ".join(sorted(RESERVED_NAMES))
        raise fault(f"{name!r}, which the results tree keeps for itself", f"any name but {kept}", "choose another")
    if DEVICE_NAMES.fullmatch(name):
        raise fault(f"{name!r}, which is a device to Windows", "any other name", "choose another")
    return name


def _word(value: object) -> object:
    """Say what a truth value or a number standing for a name was probably meant to be."""
    if isinstance(value, bool | int | float):
        raise fault(f"{str(value).lower()}, which is not text", "text", "write it in quotes")
    return value


SMALLEST, LARGEST = 1e-9, 1e12
"""Beyond these no quantity of this experiment lies in any of its units; within them nothing overflows."""

Number = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=SMALLEST, le=LARGEST)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=LARGEST)]
DampingRatio = Annotated[float, Field(strict=True, ge=SMALLEST, lt=1, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True, ge=1)]
Label = Annotated[int, Field(strict=True, ge=1, le=1000)]
Text = Annotated[str, BeforeValidator(_word)]
Word = Annotated[str, BeforeValidator(_word), Field(pattern=r"^[A-Za-z0-9_-]{1,32}$")]
FileName = Annotated[
    str,
    AfterValidator(_plain_file_name),
    BeforeValidator(_word),
    Field(
        json_schema_extra={
            "pattern": "^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$",
            "not": {"enum": sorted(RESERVED_NAMES)},
            "x-allowed": "letters, digits, _ and -",
        }
    ),
]
