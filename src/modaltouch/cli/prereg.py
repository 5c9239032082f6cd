"""``modaltouch prereg``: what will be tested, before the first participant comes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modaltouch.cli.exit_status import print_json, reporting
from modaltouch.cli.options import JSON, OBSERVER, PROTOCOL
from modaltouch.cli.tables import progress


def prereg(
    protocol: PROTOCOL,
    participants: Annotated[int, typer.Option("--participants", "-n", min=1, max=1000, help="How many are planned.")],
    observer: OBSERVER = "paper",
    experiments: Annotated[int, typer.Option(min=1, max=1_000_000, help="Experiments simulated for the power.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Seed; the same seed gives the same figures.")] = 1,
    out: Annotated[
        Path | None, typer.Option(help="File to write.", show_default="PROTOCOL.prereg.md, where analyse finds it")
    ] = None,
    json_output: JSON = False,
) -> None:
    """Write design, hypotheses, tests, margins, exclusion rules and sample size as one page of Markdown.

    The power is that of the protocol itself, simulated. A page that is there already is never overwritten.
    `modaltouch analyse` says what departs from it.
    """
    from modaltouch.planning import preregister, read_observer
    from modaltouch.preflight import examine
    from modaltouch.record import RecordError

    with reporting(json_output=json_output):
        preflight = examine(protocol, uncalibrated=True).require()
        source = preflight.experiment.sources.protocol.path
        file = out or (source if protocol.is_file() else Path(source.name)).with_suffix(".prereg.md")
        if file.exists():
            raise RecordError(f"{file}: is there already; move it away, or give another file with --out")
        with progress("experiments") as on_progress:
            text = preregister(
                preflight, read_observer(observer), participants, n_experiments=experiments, seed=seed,
                on_progress=on_progress,
            )  # fmt: skip
        try:
            with file.open("x", encoding="utf-8", newline="\n") as opened:
                opened.write(text)
        except OSError as error:
            raise RecordError(f"{file}: cannot be written ({error.strerror}); give another file with --out") from error
        print_json({"file": str(file)}) if json_output else print(
            f"{file}\nPut it where nobody can change it, such as OSF."
        )
