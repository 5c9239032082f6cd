"""Every field of the log, the table, `--json` and `--events`, found in what the program writes; their meaning is data.

The names come from the source, from every shipped protocol run at this build and from frozen outputs; ``docs/fields.yaml`` says what
each means. A field that it does not know, or an entry that nothing bears, stops the build.
"""

import ast
import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from generator.keys import keys
from generator.pages import definition, page, table, toctree, write
from generator.runs import run_all
from modaltouch.cli import MODULES

ROOT = Path(__file__).parents[2]
MEANINGS = ROOT / "docs" / "fields.yaml"
WRITERS = {"log", "append", "note", "record", "tell"}
"""Functions of the source that write an event, without underscores; its name is their first argument."""
ROOMS = ("session", "record", "rig", "window")

PAIRED = re.compile(r"^((?:finger_)?contrast)_[A-Z]_[A-Z]$")
"""Fields that have the zones of a pair in their names."""

Found = dict[str, dict[str, Any]]
"""Fields of each command or event, by their names, each with a value."""


@cache
def meanings() -> dict[str, Any]:
    """Return what is said of every field."""
    return YAML(typ="safe", pure=True).load(MEANINGS)


def fields_of(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every field of a value by its path: ``[]`` for each item of a list, ``<zone>`` for a name of its own."""
    named, opaque = meanings()["names"], meanings()["elsewhere"]
    leaf = path.rpartition(".")[2].removesuffix("[]")
    if path in opaque or leaf in opaque:
        yield path, value
    elif isinstance(value, dict) and value:
        for key, each in value.items():
            name = named[leaf] if leaf in named else PAIRED.sub(r"\1_<left>_<right>", key)
            yield from fields_of(each, f"{path}.{name}" if path else name)
    elif isinstance(value, list) and value and any(isinstance(each, dict | list) for each in value):
        for each in value:
            yield from fields_of(each, f"{path}[]")
    else:
        yield path, value


def outputs() -> Found:
    """Return the fields of the ``--json`` of each command, from frozen outputs and those kept beside this site."""
    found: Found = defaultdict(dict)
    for file in sorted((ROOT / "tests" / "golden" / "outputs").glob("*.json")):
        case = json.loads(file.read_text(encoding="utf-8"))
        words = case["line"].split()
        name = " ".join(words[:2]) if words[0] in ("rig", "fingers") else words[0]
        if words[0] in MODULES and isinstance(case["json"], dict):
            _add(found[name], case["json"])
    for file in sorted((ROOT / "docs" / "examples").glob("output_*.json")):
        _add(found[file.stem.removeprefix("output_").partition("-")[0].replace("_", " ")], json.loads(file.read_text()))
    return dict(found)


def _add(fields: dict[str, Any], value: dict[str, Any]) -> None:
    for path, each in fields_of(value):
        if fields.get(path) in (None, [], {}, "") or str(fields[path]).startswith("<"):
            fields[path] = each


@cache
def session_fields() -> tuple[Found, Found]:
    """Return the fields of the events of the log and of ``--events``, from sessions of every protocol and the source."""
    log: Found = defaultdict(dict)
    told: Found = defaultdict(dict)
    for found, lines in ((log, run_all().events["log"]), (told, run_all().events["events"])):
        for event in lines:
            _add(found[event["event"]], event)
    for file in sorted((ROOT / "tests" / "record" / "format_2").rglob("session.jsonl")):
        for line in file.read_text(encoding="utf-8").splitlines():
            _add(log[(event := json.loads(line))["event"]], event)
    for kind, names in written_events().items():
        log[kind] |= dict.fromkeys(names - log[kind].keys())
    return dict(log), dict(told)


@cache
def written_events() -> dict[str, set[str]]:
    """Return every event that the source writes by its name, with the fields that stand there by name."""
    found: dict[str, set[str]] = defaultdict(set)
    for room in ROOMS:
        for file in (ROOT / "src" / "modaltouch" / room).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if not (isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant)):
                    continue
                called = getattr(node.func, "attr", getattr(node.func, "id", "")).strip("_")
                kind = node.args[0].value
                if called in WRITERS and isinstance(kind, str) and kind.isidentifier():
                    found[kind] |= {each.arg for each in node.keywords if each.arg}
    return dict(found)


def meaning(group: str, path: str) -> str | None:
    """Return what is said of a field: of its whole path, or of the longest end of it, in its group or for all."""
    if group in meanings()["same_as"]:
        described = _described_keys(meanings()["same_as"][group])
        if path in described:
            return described[path]
    steps = [step for step in path.replace("[]", "").split(".") if not step.startswith("<")]
    for said in (meanings().get(group, {}), meanings()["all"]):
        for begin in range(len(steps)):
            name = ".".join(steps[begin:])
            if name in said:
                return said[name]
    return None


@cache
def _described_keys(kind: str) -> dict[str, str]:
    """Return what is said of the keys of a kind of file, by the names that they have here."""
    named = meanings()["names"]
    found = {}
    for key in keys(kind):
        leaf = key.path[-1]
        name = f"{key.name}.{named[leaf]}" if leaf in named and not key.name.endswith("]") else key.name
        found[key.name] = found[name] = key.info.description or ""
    return found


def missing(found: Found, group: str = "") -> list[str]:
    """Return the fields of which nothing is said, each with its group."""
    return [
        f"{group or name}: {path}"
        for name, fields in found.items()
        for path in fields
        if path and meaning(group or name, path) is None
    ]


def _type(value: Any) -> str:
    if isinstance(value, str) and value[:1] == "<" and value[-1:] == ">":
        return {"<str>": "text", "<float>": "number", "<list>": "list"}.get(value, "")
    kinds = {bool: "true or false", int: "number", float: "number", str: "text", dict: "object"}
    if isinstance(value, list):
        return "list of " + (_type(value[0]) or "values") if value else "list"
    return kinds.get(type(value), "")


def _example(value: Any) -> str:
    if value in (None, "", [], {}) or (isinstance(value, str) and value.startswith("<")):
        return ""
    shown = value[:3] if isinstance(value, list) else value
    text = json.dumps(round(shown, 6) if isinstance(shown, float) else shown, ensure_ascii=False)
    text = text.replace("`", "'")
    return f"`{text if len(text) <= 70 else text[:66] + ' ...'}`"


def _entries(group: str, fields: dict[str, Any], prefix: str) -> list[str]:
    entries = []
    for path, value in fields.items():
        facts = "; ".join(filter(None, (_type(value), _example(value))))
        anchor = f"{prefix}-{path}".replace(".", "-").replace("_", "-").replace(" ", "-")
        anchor = "".join(each for each in anchor if each.isalnum() or each == "-").lower()
        entries.append(definition(path, anchor, meaning(group, path) or "", facts))
    return entries


def write_fields(folder: Path) -> None:
    """Write the pages of the log, the table, ``--json`` and ``--events``."""
    (log, told), said = session_fields(), outputs()
    for command, values in run_all().said.items():
        for value in values:
            _add(said.setdefault(command, {}), value)
    unknown = [*missing(log, "log"), *missing(told, "events"), *missing(said)]
    unknown += [f"the event {kind}" for kind in {**log, **told} if kind not in meanings()["kinds"]]
    idle = [kind for kind in meanings()["kinds"] if kind not in {**log, **told} and kind not in _told_only()]
    if unknown or idle:
        raise ValueError(f"docs/fields.yaml does not say what these are: {', '.join(unknown)}; says too much: {idle}")
    _write_log(folder, log)
    _write_events(folder, told)
    _write_table(folder)
    _write_json(folder, said)


def _told_only() -> Iterable[str]:
    return meanings()["told_only"]


def _write_log(folder: Path, log: Found) -> None:
    every = ("n", "time", "clock", "event", "check")
    kinds = meanings()["kinds"]
    blocks = [
        "`session.jsonl` is the record of a session: one JSON object per line, appended and synced, each with a checksum "
        "that includes the line before. The table next to it is derived from it and can be regenerated at any time. "
        "`modaltouch verify` recomputes every line.",
        "## On every line",
        *_entries("log", {name: next(iter(log.values())).get(name) for name in every}, "log-every"),
    ]
    main = ("start", "rig", "placement", "fired", "answered", "trial", "rest", "stop")
    for kind in (*main, *sorted(set(log) - set(main))):
        fields = {path: value for path, value in log[kind].items() if path not in every}
        blocks += [f"## {kind}", kinds[kind], *_entries("log", fields, f"log-{kind}")]
    write(folder / "log.md", page("The session log", *blocks))


def _write_events(folder: Path, told: Found) -> None:
    together: dict[str, Any] = {}
    for fields in told.values():
        for path, value in fields.items():
            if together.get(path) in (None, "", [], {}):
                together[path] = value
    kinds = [(f"`{kind}`", text) for kind, text in meanings()["kinds"].items()]
    lead = (
        "`modaltouch run --events PATH` writes the state of the session, as one JSON object per line, whenever "
        "something happens. Every line has all fields, with `null` for those that are empty. `line` is the number of "
        "the line in the log."
    )
    write(
        folder / "events.md",
        page("Events", lead, "## Fields", *_entries("events", together, "events"), "## What `event` may be",
             table(("event", "when"), kinds)),
    )  # fmt: skip


def _write_table(folder: Path) -> None:
    from modaltouch.record import view

    extra = {name: column for needs, columns in view.FURTHER.items() for name, column in columns.items()
             if needs not in ("counted", "line")}  # fmt: skip
    extra |= {
        "value": {"Description": "Number given on a scale; n/a without an answer"},
        "<question>": {"Description": "Answer to the further question of this name: an answer or a number"},
        "<question>_time": view.QUESTION_TIME,
    }
    groups = {
        "In every session": view.COLUMNS,
        "In sessions whose bursts are counted": {**view.FURTHER["counted"], **view.FURTHER["line"]},
        "If the protocol has them": extra,
    }
    blocks = [
        "`sub-<participant>_ses-<n>_task-<protocol>_beh.tsv`: one row for each answer that counts, in BIDS format, "
        "tab-separated, with `n/a` for empty cells. The sidecar file of the same name, `.json`, says the same as this "
        "page."
    ]
    for title, columns in groups.items():
        blocks.append(f"## {title}")
        for name, column in columns.items():
            unit = f"unit: {column['Units']}" if "Units" in column else ""
            levels = "; ".join(f"`{level}`: {text}" for level, text in column.get("Levels", {}).items())
            blocks.append(
                definition(name, f"table-{name}".replace("_", "-"), column["Description"] + ".", unit, levels)
            )
    write(folder / "table.md", page("The table of answers", *blocks))


def _write_json(folder: Path, said: Found) -> None:
    names = []
    for command, fields in sorted(said.items()):
        name = command.replace(" ", "_")
        names.append(f"json/{name}")
        lead = f"What `modaltouch {command} --json` prints: one object on standard output."
        write(
            folder / "json" / f"{name}.md", page(f"{command} --json", lead, *_entries(command, fields, f"json-{name}"))
        )
    lead = (
        "With `--json` a command prints one object and nothing else on standard output; progress goes to standard "
        "error. Names end in the unit. If a command fails, the object has `error`, the reason in words, and "
        "`problems`, each with file, line and column. [How this may change](../explanation/what_is_public.md)."
    )
    write(folder / "json.md", page("JSON outputs", lead, toctree(*names)))
