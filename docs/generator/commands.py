"""Every command with its arguments and options, as the program itself lists them; every exit status."""

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer.main import get_command

from generator.pages import definition, page, table, toctree, write
from modaltouch.cli import MODULES, app

STATUSES = (
    ("DONE", "Done."),
    ("BAD_INPUT", "A file, an option or a record is invalid; each error is reported with its position. Nothing was begun."),
    ("RIG_FAILED", "Generator, vibrometer or window failed, or a measurement missed its limits. The outputs are off; "
     "the answers are kept, and `modaltouch resume` continues the session."),
    ("RECORD_AT_RISK", "A record is damaged, would be overwritten, or could not be written. The outputs are off."),
    ("INTERRUPTED", "Ctrl-C, a signal, Escape in the window or the experimenter ended the command. The outputs are off; "
     "the answers are kept."),
)  # fmt: skip
"""What each exit status means, by its name in the program."""


def commands() -> Iterator[tuple[str, Any, Any]]:
    """Yield the words of each command, the command and its context."""
    group = get_command(app)
    top = group.make_context("modaltouch", ["--help"], resilient_parsing=True)
    for name in MODULES:
        command = group.get_command(top, name)
        context = command.make_context(name, [], parent=top, resilient_parsing=True)
        subs = getattr(command, "commands", None)
        if not subs:
            yield name, command, context
            continue
        for sub, each in subs.items():
            yield f"{name} {sub}", each, each.make_context(sub, [], parent=context, resilient_parsing=True)


def _paragraphs(text: str) -> list[str]:
    return [" ".join(part.split()) for part in inspect.cleandoc(text or "").split("\n\n")]


def _parameter(parameter: Any, context: Any, words: str) -> str:
    record = parameter.get_help_record(context)
    if record is None:
        return ""
    name, said = record
    anchor = f"{words} {parameter.name}".replace(" ", "-").replace("_", "-").lower()
    said, _, facts = said.replace("<", "&lt;").partition("  [")
    facts = facts.removesuffix("]").replace("(", "").replace(")", "")
    facts = re.sub(r"([\d.]+)<=x<=([\d.]+)", r"\1 to \2", facts)
    facts = re.sub(r"x>=([\d.]+)", r"\1 or more", facts)
    return definition(" ".join(name.split()), f"option-{anchor}", said, facts)


def write_commands(folder: Path) -> None:
    """Write a page for each command, and the page that leads to them."""
    names, rows = [], []
    for words, command, context in commands():
        first, *more = _paragraphs(command.help)
        usage = " ".join(["modaltouch", words, *command.collect_usage_pieces(context)])
        arguments = [each for each in command.params if each.param_type_name == "argument"]
        options = [each for each in command.get_params(context) if each.param_type_name == "option"]
        blocks = [first, *more, f"```text\n{usage}\n```"]
        for title, parameters in (("Arguments", arguments), ("Options", options)):
            entries = list(filter(None, (_parameter(each, context, words) for each in parameters)))
            blocks += [f"## {title}", *entries] if entries else []
        name = words.replace(" ", "_")
        names.append(name)
        rows.append((f"[`modaltouch {words}`]({name}.md)", first))
        write(folder / f"{name}.md", page(f"modaltouch {words}", *blocks))
    lead = "These pages are generated from `--help`. Commands that report something accept `--json`."
    write(folder / "index.md", page("Commands", lead, table(("command", "does"), rows), toctree(*names)))


def write_statuses(folder: Path) -> None:
    """Write the page of exit statuses."""
    from modaltouch import cli

    known = {name: value for name, value in vars(cli).items() if name.isupper() and type(value) is int}
    if set(known) != {name for name, _ in STATUSES}:
        raise ValueError(f"the exit statuses are {', '.join(known)}: say in docs/generator/commands.py what each means")
    lead = (
        "A command that fails explains why on standard error, without a traceback. With `--json` the explanation is "
        "the field `error` of one object on standard output."
    )
    rows = [(f"`{known[name]}`", meaning) for name, meaning in STATUSES]
    bug = (
        "The output could not be printed: the disk is full or, without a message, the reader has closed. With a "
        "traceback, it is a bug of the program: please report it. The outputs are off; the answers are kept."
    )
    rows.insert(1, ("`1`", bug))
    write(folder / "exit_statuses.md", page("Exit statuses", lead, table(("status", "meaning"), rows)))
