"""Values as they are kept in JSON files: plain, readable line by line, compared within a tolerance."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
WIDTH = 200


def load(name: str) -> Any:
    """Return what is frozen under a name."""
    return json.loads((HERE / f"{name}.json").read_text(encoding="utf-8"))


def write(name: str, values: Any) -> Path:
    """Freeze values under a name."""
    file = HERE / f"{name}.json"
    file.parent.mkdir(exist_ok=True)
    file.write_text(in_lines(values) + "\n", encoding="utf-8", newline="\n")
    return file


def in_lines(value: Any, indent: int = 0) -> str:
    """Return JSON in which whatever fits stands on one line, and all else on lines of its own."""
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if len(flat) + indent <= WIDTH or not isinstance(value, dict | list) or not value:
        return flat
    pad = " " * (indent + 1)
    if isinstance(value, dict):
        rows = [
            f"{pad}{json.dumps(key, ensure_ascii=False)}: {in_lines(each, indent + 1)}" for key, each in value.items()
        ]
        return "{\n" + ",\n".join(rows) + "\n" + " " * indent + "}"
    rows = [pad + in_lines(each, indent + 1) for each in value]
    return "[\n" + ",\n".join(rows) + "\n" + " " * indent + "]"


def kinds(value: Any) -> Any:
    """Return types in place of what may differ from day to day; of a list of objects, the kinds it holds."""
    if isinstance(value, dict):
        return {key: kinds(each) for key, each in value.items()}
    if isinstance(value, list) and any(isinstance(each, dict) for each in value):
        found: list[Any] = []
        for each in map(kinds, value):
            if each not in found:
                found.append(each)
        return found
    return f"<{type(value).__name__}>"


def masked(value: Any, volatile: Sequence[str], unordered: Sequence[str] = (), path: str = "") -> Any:
    r"""Return a value without what differs from day to day, or from one processor to another.

    Parameters
    ----------
    value
        Plain values.
    volatile : sequence of str
        Patterns of paths, such as ``rows\[\].found``, where the `kinds` of a value take its place.
    unordered : sequence of str
        Patterns of the paths of lists of objects, which are sorted by all that is no fraction in these.
    path : str
        Where in the whole the value stands.
    """

    def among(patterns: Sequence[str]) -> bool:
        return any(re.fullmatch(pattern, path) for pattern in patterns)

    if among(volatile):
        return kinds(value)
    rules = (volatile, unordered)
    if isinstance(value, dict):
        return {key: masked(each, *rules, f"{path}.{key}".lstrip(".")) for key, each in value.items()}
    if isinstance(value, list):
        rows = [masked(each, *rules, f"{path}[]") for each in value]
        return sorted(rows, key=_by_names) if among(unordered) else rows
    return value


def _by_names(row: dict[str, Any]) -> str:
    return json.dumps([each for each in row.values() if not isinstance(each, float)])


def differences(found: Any, frozen: Any, *, rel: float = 1e-9, absolute: float = 0.0, path: str = "") -> list[str]:
    """Return where a value is not the frozen one: keys, types, texts and whole numbers exactly, others within bounds.

    Parameters
    ----------
    found, frozen
        Plain values.
    rel, absolute : float
        A number may differ by the larger of `rel` times itself and `absolute`.
    path : str
        Where in the whole the two stand.
    """
    bounds = {"rel": rel, "absolute": absolute}
    if isinstance(found, dict) and isinstance(frozen, dict):
        said = [f"{path}.{key}: missing" for key in frozen.keys() - found.keys()]
        said += [f"{path}.{key}: new" for key in found.keys() - frozen.keys()]
        both = [key for key in frozen if key in found]
        return sorted(said) + [
            each for key in both for each in differences(found[key], frozen[key], path=f"{path}.{key}", **bounds)
        ]
    if isinstance(found, list) and isinstance(frozen, list):
        said = [f"{path}: {len(found)} items, frozen {len(frozen)}"] if len(found) != len(frozen) else []
        pairs = enumerate(zip(found, frozen, strict=False))
        return said + [each for n, pair in pairs for each in differences(*pair, path=f"{path}[{n}]", **bounds)]
    if type(found) is not type(frozen):
        return [f"{path}: {found!r} is a {type(found).__name__}, frozen {frozen!r}"]
    if isinstance(found, float) and math.isclose(found, frozen, rel_tol=rel, abs_tol=absolute):
        return []
    return [] if found == frozen else [f"{path}: {found!r}, frozen {frozen!r}"]
