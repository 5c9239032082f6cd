"""``modaltouch new``: create a study folder with a shipped protocol and the files it names."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from modaltouch import protocol, system
from modaltouch.cli import JSON, print_json, reporting


def new(
    folder: Annotated[Path, typer.Argument(help="Folder of the study, new or empty.", show_default=False)],
    template: Annotated[str, typer.Option("--from", help="A shipped protocol.")] = "differentiated_stimulation",
    json_output: JSON = False,
) -> None:
    """Make a study folder: a shipped protocol with the shipped apparatus, texts and schemas, ready to edit.

    Its README.md lists the commands in order. Nothing is ever overwritten.
    """
    with reporting(json_output=json_output):
        files = write_study(folder, template)
        if json_output:
            print_json({"folder": str(folder), "protocol": str(files[0]), "files": [*map(str, files)]})
        else:
            print(f"{len(files)} files in {folder}; its README.md lists the commands of the study")
            print(f"Next: modaltouch check {shlex.quote(files[0].as_posix())}")


def write_study(folder: Path, template: str) -> tuple[Path, ...]:
    """Write a study folder and return its files, the protocol first.

    Parameters
    ----------
    folder : Path
        New or empty folder; nothing is ever overwritten.
    template : str
        Name of a shipped protocol.

    Raises
    ------
    InputError
        If there is no such protocol, or the folder is not empty or cannot be written.
    """
    contents = _contents(template)
    try:
        if folder.exists() and (held := next(folder.iterdir(), None)):
            raise protocol.InputError.of(folder, f"a folder that holds {held.name}", "a folder that is new or empty")
        # Sessions are private to their owner, and a session does not change the mode of an existing folder.
        (folder / "results").mkdir(mode=0o700, parents=True)
        for place, text in contents.items():
            (folder / place).parent.mkdir(parents=True, exist_ok=True)
            with (folder / place).open("x", encoding="utf-8", newline="\n") as opened:
                opened.write(text)
    except OSError as error:
        raise protocol.InputError.of(
            folder, f"a folder that cannot be written ({error.strerror})", "one that you may write to"
        ) from error
    return tuple(folder / place for place in contents)


def _contents(template: str) -> dict[str, str]:
    """Return the text of each file by its path in the study, the protocol first."""
    known = protocol.Source.shipped("protocol")
    if template not in known:
        raise protocol.InputError.of("--from", f"{template!r}, which is not a shipped protocol", ", ".join(known))
    experiments = [protocol.Findings.read(known[template]).experiment()]
    if own := experiments[0].protocol.conditions.sensation_levels:
        experiments.append(protocol.Findings.read(known[own.thresholds_from]).experiment())
    named = [vars(each.sources)[key].path for each in experiments for key in ("protocol", "apparatus", "texts")]
    folder = known[template].parent
    # Include all languages and instruments, so that switching only needs another name in the protocol.
    others = (file for each in ("apparatus/*.yaml", "texts/*.yaml", "schema/*.json") for file in folder.glob(each))
    files = {file.relative_to(folder).as_posix(): file for file in (*named, *sorted(others))}
    copied = {f"protocols/{place}": file.read_text(encoding="utf-8") for place, file in files.items()}
    readme = "".join(f"{line}\n" for line in _readme([each.protocol for each in experiments]))
    return copied | {"README.md": readme, "results/.gitignore": "*\n!.gitignore\n"}


def _readme(protocols: list[protocol.Protocol]) -> Iterator[str]:
    """Yield the lines of the study's README: the commands for the protocol and its prerequisite, if any."""
    first, name = protocols[0], protocols[0].protocol
    files = [f"protocols/{each.protocol}.yaml" for each in reversed(protocols)]
    yield f"# {first.title}\n"
    yield f"Written by modaltouch {system.version()} from its protocol `{name}`. Run in this folder, in this order:\n"
    yield "| command | purpose |\n|---|---|"
    for file in files:
        yield f"| `modaltouch check {file}` | after each change: errors with their position, speeds, duration |"
        yield f"| `modaltouch simulate {file} -n 10` | simulate participants, to see what the data will look like |"
    yield f"| `modaltouch analyse results/simulated/{name}` | tables, figures, statistics, report of the simulation |"
    for file in files:
        yield f"| `modaltouch run {file} -p p01 --fullscreen` | run a session; asks for the generator's address |"
    yield f"| `modaltouch verify results/{name}/sub-p01/ses-1` | check the record by recomputing it |"
    yield f"| `modaltouch analyse results/{name}` | the same for the real sessions |"
    yield f"\nDescribe your beam in `protocols/{first.apparatus}`, and edit the screens in `protocols/{first.texts}`."
