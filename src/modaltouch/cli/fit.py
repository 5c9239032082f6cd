"""``modaltouch fit``: an observer for the next study, from the answers of this one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modaltouch.cli.analyse import participants
from modaltouch.cli.exit_status import print_json, reporting
from modaltouch.cli.options import JSON, MODE, OBSERVER, PROTOCOL


def fit(
    protocol: PROTOCOL,
    answers: Annotated[
        Path, typer.Argument(help="A results folder or a tidy CSV, as for `analyse`.", show_default=False)
    ],
    observer: OBSERVER = "paper",
    out: Annotated[
        Path | None, typer.Option(help="YAML file for the fitted observer.", show_default="nothing is written")
    ] = None,
    mode: MODE = None,
    json_output: JSON = False,
) -> None:
    """Fit a simulated observer to recorded answers, such as a pilot's, to plan the next study with.

    The observer that is given is the centre of the priors, and its front end is kept. Where the protocol has several
    stimuli, one observer is fitted to the answers to all of them.
    """
    from modaltouch.planning import fit_answers, read_observer, write_observer
    from modaltouch.preflight import examine
    from modaltouch.record import prepare_file, replace_file

    with reporting(json_output=json_output):
        prior = read_observer(observer)
        preflight = examine(protocol, uncalibrated=True).require()
        if out is not None:
            prepare_file(out)
        fitted = fit_answers(preflight, answers, prior, mode=mode)
        if out is not None:
            words = (
                f"Fitted to {fitted.fit.n_answers} answers of {participants(fitted.n_participants)} in {answers.name}"
            )
            text = write_observer(fitted.fit.observer, "fitted", words)
            replace_file(out, text.encode(), "give another file with --out")
        if json_output:
            print_json({**fitted.as_dict(), "file": None if out is None else str(out)})
            return
        print(f"{fitted.fit.n_answers} answers of {participants(fitted.n_participants)}")
        for estimate in (*fitted.fit.identified, *fitted.fit.parameters):
            tied = ", scale by the prior" if estimate.tied_to_scale else ""
            print(
                f"{estimate.name:44} {estimate.value:8.4g}  95 % interval {estimate.low:.4g} to {estimate.high:.4g}, "
                f"learned {estimate.learned:.0%}{tied}"
            )
        print(fitted.not_identifiable)
        if not fitted.fit.converged:
            typer.secho("the search did not end at a maximum; do not plan with this", err=True, fg=typer.colors.YELLOW)
        if out is not None:
            print(f"Next: modaltouch power {protocol} --observer {out}")
