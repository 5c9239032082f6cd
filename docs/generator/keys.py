"""Every key of the YAML files: what may stand there, its unit, bounds and default, and an example from a real file."""

import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from ruamel.yaml import YAML

from generator.pages import definition, page, toctree, write
from modaltouch.protocol.schemas import SCHEMAS
from modaltouch.protocol.wording import describe

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs" / "examples"

FILES = {
    "protocol": ("The protocol", "The experiment. Shipped ones are in `protocols/`."),
    "apparatus": ("The apparatus", "The beam, its modes and the instruments. A lab has one for each rig."),
    "texts": ("The texts", "Everything that a participant reads, one file per language."),
    "fingers": ("Fingers", "What a finger adds to the beam where it touches, typical or measured."),
    "observer": ("An observer", "A model of how participants answer, for `simulate`, `power` and `fit`."),
    "calibration": ("A calibration", "Written by `modaltouch calibrate`; read, never edited."),
}
"""Title and first line of the page of each kind of file."""

Path_ = tuple[str, ...]
"""Keys from the top of a file; ``[]`` for each item of a list, ``<name>`` for a name that the file chooses."""


class Key(typing.NamedTuple):
    """A key of a kind of file."""

    path: Path_
    steps: tuple[str | int, ...]
    info: FieldInfo
    model: type[BaseModel]
    section: type[BaseModel]

    @property
    def name(self) -> str:
        """The path as it is written on a page."""
        return ".".join(self.path).replace(".[]", "[]")


def keys(kind: str) -> list[Key]:
    """Return every key of a kind of file, in the order of its sections."""
    found: dict[Path_, Key] = {}
    for model in _models(SCHEMAS[kind]):
        for key in _walk(model, (), (), model):
            found.setdefault(key.path, key)
    return list(found.values())


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        root = annotation.model_fields.get("root")
        return _models(root.annotation) if root is not None else [annotation]
    return [model for each in typing.get_args(annotation) for model in _models(each)]


def _walk(model: type[BaseModel], path: Path_, steps: tuple, top: type[BaseModel]) -> Iterator[Key]:
    for name, info in model.model_fields.items():
        name = info.alias or name
        yield Key((*path, name), (*steps, name), info, top, model)
        for below, placeholders, real in _below(info.annotation):
            yield from _walk(below, (*path, name, *placeholders), (*steps, name, *real), top)


def _below(annotation: Any, placeholders: tuple = (), real: tuple = ()) -> Iterator[tuple]:
    """Yield the sections that may stand under a key, with what stands between."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation, placeholders, real
    elif origin is Annotated:
        yield from _below(arguments[0], placeholders, real)
    elif origin in (typing.Union, types.UnionType):
        for each in arguments:
            yield from _below(each, placeholders, real)
    elif origin is dict:
        yield from _below(arguments[1], (*placeholders, "<name>"), (*real, "name"))
    elif origin in (tuple, list):
        yield from _below(arguments[0], (*placeholders, "[]"), (*real, 0))


def sources(kind: str) -> list[Path]:
    """Return real files of a kind: the shipped ones first, then those beside this site."""
    shipped = ROOT / "protocols"
    folders = {"protocol": shipped, "observer": shipped / "observers", "fingers": shipped / "fingers"}
    folder = folders.get(kind, shipped / kind)
    return [*sorted(folder.glob("*.yaml")), *sorted(EXAMPLES.glob(f"{kind}*.yaml"))]


def examples(kind: str) -> dict[Path_, tuple[Any, str]]:
    """Return an example of every key that a real file of this kind holds, with the file's name."""
    known = {key.path: (key.section, key.path[-1]) for key in keys(kind)}
    found: dict[Path_, tuple[Any, str]] = {}
    alike: dict[tuple[type[BaseModel], str], tuple[Any, str]] = {}
    for file in sources(kind):
        for path, value in _values(YAML(typ="safe", pure=True).load(file), (), set(known)):
            for place, name in ((found, path), (alike, known[path])):
                if name not in place or place[name][0] in (None, [], {}, ""):
                    place[name] = value, file.name
    # A section that may stand in several places, such as a finger, is shown by an example of it in any of them.
    return {path: found.get(path, alike.get(name)) for path, name in known.items() if path in found or name in alike}


def _values(value: Any, path: Path_, known: set[Path_]) -> Iterator[tuple[Path_, Any]]:
    if path in known:
        yield path, value
    if isinstance(value, dict):
        for name, each in value.items():
            below = (*path, str(name))
            is_named = any(one[: len(path) + 1] == below for one in known)
            yield from _values(each, below if is_named else (*path, "<name>"), known)
    elif isinstance(value, list):
        for each in value:
            yield from _values(each, (*path, "[]"), known)


def without_example(kind: str) -> list[str]:
    """Return the keys of which no real file has an example."""
    found = examples(kind)
    return [key.name for key in keys(kind) if key.path not in found]


def in_yaml(value: Any, longest: int = 70) -> str:
    """Return a value in a line of YAML, cut where it is long."""
    if isinstance(value, dict):
        text = "{" + ", ".join(f"{name}: {in_yaml(each)}" for name, each in value.items()) + "}"
    elif isinstance(value, list | tuple):
        text = "[" + ", ".join(in_yaml(each) for each in value) + "]"
    elif isinstance(value, bool) or value is None:
        text = {True: "true", False: "false", None: "null"}[value]
    elif isinstance(value, float):
        text = f"{value:g}"
    elif isinstance(value, BaseModel):
        text = in_yaml(value.model_dump(mode="json", exclude_unset=True))
    else:
        text = str(value).strip().partition("\n")[0] + (" ..." if "\n" in str(value).strip() else "")
        text = text or "''"
    return text if len(text) <= longest else text[: longest - 4].rstrip() + " ..."


def _entry(key: Key, kind: str, found: dict[Path_, tuple[Any, str]]) -> str:
    info, words = key.info, describe(key.model, key.steps) or "a value"
    if info.is_required():
        state = "required"
    else:
        default = (
            info.get_default(call_default_factory=True) if info.default_factory is None else info.default_factory()
        )
        state = "" if default is PydanticUndefined else f"default `{in_yaml(default)}`"
    example = ""
    if key.path in found:
        value, file = found[key.path]
        example = f"`{key.path[-1]}: {in_yaml(value)}` ({file})"
    facts = "; ".join(filter(None, (words, state)))
    return definition(key.name, anchor(kind, key.name), info.description or "", facts, example)


def anchor(kind: str, name: str) -> str:
    """Return what a link to a key names."""
    return (
        f"{kind}-{name}".replace(".", "-").replace("[]", "").replace("<", "").replace(">", "").replace("_", "-").lower()
    )


def write_keys(folder: Path) -> None:
    """Write a page for each kind of file, and the page that leads to them."""
    counts = {}
    for kind, (title, first) in FILES.items():
        found, all_keys = examples(kind), keys(kind)
        counts[kind] = len(all_keys)
        blocks, section = [], None
        for key in all_keys:
            top = key.path[0]
            if len(key.path) == 1 and any(one.path[0] == top and len(one.path) > 1 for one in all_keys):
                section = top
                blocks.append(f"## {top}")
            elif section is not None and top != section:
                section = None
                blocks.append("## At the top of the file")
            blocks.append(_entry(key, kind, found))
        lead = f"{first} {len(all_keys)} keys; the schema for editors is `protocols/schema/{kind}.json`."
        write(folder / f"{kind}.md", page(title, lead, *blocks))
    lead = (
        "What each file of an experiment may contain. Every key is listed with its meaning, type, unit, bounds and "
        "default, and an example from a real file. Keys end in the unit: `pause_s` is in seconds, `base_mm` in "
        "millimetres. A key that is not listed is refused, with its line and column, and the nearest one is suggested."
    )
    write(folder / "index.md", page("YAML keys", lead, toctree(*FILES)))
