"""``modaltouch check``: validate a protocol before a participant sits down."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any

import typer

from modaltouch import preflight, record
from modaltouch.cli import (
    BAD_INPUT,
    CALIBRATION,
    JSON,
    PROTOCOL,
    WITH_MARKED,
    print_json,
    print_table,
    reporting,
    say,
)

_MOST_ROWS = 12
"""Maximum number of rows of the sensitivity table to show, the worst first."""

_PULL = (
    "at most: the level under the finger with the amplifier at its limit. pull: the force with which the skin would "
    "have to stick to the beam to follow it; a finger that presses with less force lifts off, and these speeds do not "
    "hold."
)


_TOLERANCE = Annotated[
    float | None,
    typer.Option(
        min=1e-6,
        max=0.999,
        help="Also show the fewest samples that keep the field around the focus within this share of the level.",
        show_default=False,
    ),
]


def check(
    protocol: PROTOCOL,
    calibration: CALIBRATION = None,
    with_marked_calibration: WITH_MARKED = False,
    json_output: JSON = False,
    compare: Annotated[bool, typer.Option("--compare", help="Also show the other drive law.")] = False,
    sensitivity: Annotated[
        bool, typer.Option("--sensitivity", help="Also show how well the beam must be identified.")
    ] = False,
    contrast: Annotated[
        bool,
        typer.Option(
            "--contrast",
            help="Also show how much faster the focus could move than the other touched zone; takes some seconds.",
        ),
    ] = False,
    fingers: Annotated[
        str | None,
        typer.Option(
            help="Also show each level under fingers: `typical`, or a YAML file; `none` for the untouched beam only.",
            show_default="those that the protocol is designed for",
        ),
    ] = None,
    export: Annotated[
        Path | None,
        typer.Option(
            help="Also write the drive at the highest level into this .npz file: `time_s`, the start of each sample "
            "at the beam, and `voltage_V`, held until the next, before the pole of an amplifier with a bandwidth."
        ),
    ] = None,
    tolerance: _TOLERANCE = None,
) -> None:
    """Validate a protocol, synthesise its stimuli and predict the speeds at the zones.

    No instrument is opened, and only --export writes a file. All errors are reported at once, each with file, line and
    column.
    """
    with reporting(json_output=json_output):
        checked = preflight.check_legibility(preflight.examine(protocol, calibration, marked=with_marked_calibration))
        asked: dict[str, Any] = {}
        if not checked.problems and (sensitivity or contrast or tolerance is not None):
            asked = checked.explore(sensitivity=sensitivity, contrast=contrast, tolerance=tolerance)
        if export is not None and not checked.problems:
            _export(checked, export)
        if json_output:
            print_json(checked.as_dict(compare=compare, fingers=fingers) | asked)
        elif checked.problems:
            for problem in checked.problems:
                typer.secho(str(problem), err=True, fg=typer.colors.RED)
        else:
            show(checked, compare=compare, fingers=fingers, asked=asked)
        if checked.problems:
            raise typer.Exit(BAD_INPUT)


def _export(checked: preflight.Preflight, file: Path) -> None:
    """Write the drive voltages at the beam to an ``.npz`` file."""
    import numpy as np

    if file.suffix != ".npz":
        raise typer.BadParameter(f"given --export {file}; allowed: a file whose name ends with .npz, such as drive.npz")
    np.savez_compressed(contents := BytesIO(), **checked.drive_arrays())
    record.replace_file(file, contents.getvalue(), "give another file with --export")


def show(
    checked: preflight.Preflight,
    *,
    compare: bool = False,
    fingers: str | None = None,
    asked: dict[str, Any] | None = None,
) -> None:
    """Print a summary of the protocol's sessions and the additional results in `asked`."""
    values = checked.as_dict(compare=compare, fingers=fingers)
    catches = f" ({values['n_catch_trials']} of them catch trials)" if values["n_catch_trials"] else ""
    say(
        f"{values['title'] or values['protocol']}: {values['n_trials']} trials{catches} and "
        f"{values['n_practice_trials']} for practice, about {values['estimated_duration_min']:.0f} min",
        bold=True,
    )
    stimuli = values["stimuli"]
    say(*_stimulus_lines(checked, stimuli))
    for each in values.get("occasions", ()):
        levels = ", ".join(format(level, "g") for level in each["peak_velocities_mm_s"])
        say(
            f"{' '.join(filter(None, (each['group'], each['session_kind'])))}: {each['n_trials']} trials and "
            f"{each['n_practice_trials']} for practice, about {each['estimated_duration_min']:.0f} min; {levels} mm/s"
        )
    if calibration := values["calibration"]:
        say(
            f"Calibrated {calibration['made']} on {calibration['generator']}: worst modal error then "
            f"{calibration['worst_modal_error_mm_s']:.2g} mm/s at {calibration['reference_mm_s']:g} mm/s"
        )
    if own := values["sensation_levels"]:
        say(
            f"Levels calibrated by participant: {', '.join(f'{each:g}' for each in own['multiples'])} times the "
            f"threshold that a session of the protocol {own['thresholds_from']} found, for thresholds of "
            f"{own['thresholds_mm_s'][0]:g} to {own['thresholds_mm_s'][1]:.4g} mm/s; below, the bounds of all levels"
        )
    for whose, rows in _by_occasion(checked, stimuli, fingers).items():
        _show_levels(rows, whose)
        if any("touched" in each for each in rows):
            _show_touched(rows, whose)
    if any("touched" in each for each in stimuli):
        say(_PULL, dim=True)
    elif fingers is None and (untouched := checked.untouched_warning()):
        say(untouched, fg="yellow")
    if (highest := max(stimuli, key=lambda each: each["velocity_mm_s"]))["release"] == "free":
        say(
            f"Released freely, at {highest['velocity_mm_s']:g} mm/s the first burst misses a mode by "
            f"{highest['worst_modal_error_mm_s']:.2g} mm/s, the later ones, which begin before it has died out, by "
            f"{highest['worst_modal_error_steady_mm_s']:.2g} mm/s"
        )
    for stimulus in values.get("comparison", []):
        say(
            f"Law {stimulus['law']} at {stimulus['velocity_mm_s']:g} mm/s on the same rig: worst modal error "
            f"{stimulus['worst_modal_error_mm_s']:.3g} mm/s",
            dim=True,
        )
    say(*values["warnings"], fg="yellow")
    _show_explored(asked or {})


def _stimulus_lines(checked: preflight.Preflight, stimuli: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a summary line for each stimulus."""
    protocol, firsts = checked.experiment.protocol, dict[str, dict[str, Any]]()
    for each in stimuli:
        firsts.setdefault(each.get("stimulus", ""), each)
    for name, each in firsts.items():
        rate, mask = protocol.stimulus_of(name).repetition_rate_Hz, "" if protocol.is_masked(name) else ", not masked"
        n_bursts = protocol.n_bursts(name)
        yield (
            f"{f'{name}: focus' if name else 'Focus'} {each['focus']}, law {each['law']}, modes "
            f"{', '.join(map(str, each['selected_modes']))}, {each['n_samples']} samples at "
            f"{each['sampling_rate_Hz'] / 1e6:g} MHz, spot {each['fwhm_mm']:.1f} mm wide (FWHM)"
            + (f"; {n_bursts} burst{'s' * (n_bursts > 1)} at {rate:g} Hz{mask}" if name else "")
        )


def _show_explored(asked: dict[str, Any]) -> None:
    if found := asked.get("sensitivity"):
        print_table(
            f"What an error of a parameter does at {found['velocity_mm_s']:g} mm/s",
            ("parameter", "mode", "error %", "field mm/s", "displacement mm/s"),
            [
                (
                    str(row["parameter"]).replace("_", " "),
                    str(row["mode"]),
                    f"{row['error'] * 100:g}",
                    f"{row['field_mm_s']:.2f}",
                    f"{row['displacement_mm_s']:.2f}",
                )
                for row in found["table"][:_MOST_ROWS]
            ],
        )
        drawn, spread = found["drawn"], found["drawn"]["deviations"]
        say(
            f"{drawn['n_draws']} beams drawn with standard deviations of {spread['natural_frequency']:.1%} in "
            f"frequency, {spread['damping_ratio']:.0%} in damping and {spread['modal_gain']:.0%} in gain: worst modal "
            f"error {drawn['median_modal_error_mm_s']:.1f} mm/s (median), {drawn['p95_modal_error_mm_s']:.1f} mm/s "
            "(95th percentile)"
        )
    if rows := asked.get("contrast"):
        _show_contrast(rows)
    if found := asked.get("samples"):
        say(found["said"])


def _show_contrast(rows: list[dict[str, Any]]) -> None:
    print_table(
        "Highest speed of the focus over that under the other finger",
        ("pair", "design", "contrast", "below 1 kHz", "focus below 1 kHz mm/s", "peak V"),
        [
            (
                row["placement"],
                row["design"],
                *(f"{row[key]:.2f}" for key in ("contrast", "contrast_below_1_kHz")),
                *(f"{row[key]:.0f}" for key in ("focus_below_1_kHz_mm_s", "peak_drive_V")),
            )
            for row in rows
        ],
        n_words=2,
    )
    say(
        "contrast: the drive that moves the other zone least, regardless of the field and of modes that are not "
        "in the table; the skin is most sensitive below 1 kHz.",
        dim=True,
    )


def _by_occasion(
    checked: preflight.Preflight, stimuli: list[dict[str, Any]], fingers: str | None
) -> dict[str, list[dict[str, Any]]]:
    """Return the table rows for each set of groups and session kinds that share them, unnamed if all do."""
    found: list[tuple[list[str], list[dict[str, Any]]]] = []
    for each in (checked, *checked.others):
        rows = [*_in_order(each, stimuli if each is checked else each.as_dict(fingers=fingers)["stimuli"])]
        alike = next((names for names, known in found if known == rows), None)
        if alike is None:
            found.append((alike := [], rows))
        alike.append(" ".join(filter(None, each.findings.occasion)))
    return {f" ({', '.join(names)})" if len(found) > 1 else "": rows for names, rows in found}


def _in_order(checked: preflight.Preflight, stimuli: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the rows sorted by stimulus and level, with a level label that marks the standard of interval trials."""
    protocol = checked.experiment.protocol
    standard = None if protocol.intervals is None else protocol.intervals.standard
    names = list(protocol.stimuli) or [""]
    for each in sorted(stimuli, key=lambda row: (names.index(row.get("stimulus", "")), row["velocity_mm_s"])):
        level = each["velocity_mm_s"]
        is_told = standard and standard.velocity_mm_s == level and standard.stimulus in (None, each.get("stimulus"))
        yield {**each, "level": f"{level:g}" + (" (standard)" if is_told else "")}


def _show_levels(stimuli: list[dict[str, Any]], whose: str) -> None:
    zones = list(stimuli[0]["zone_peak_mm_s"])
    drive = "peak drive V: " + ", ".join(f"CH{channel}" for channel in stimuli[0]["peak_drive_V"])
    _show_speeds(
        f"Largest speed at the centre of each zone, mm/s{whose}",
        (*zones, "modal error mm/s", drive),
        [
            (
                stimulus,
                *(_in_two_digits(stimulus["zone_peak_mm_s"][zone]) for zone in zones),
                f"{stimulus['worst_modal_error_mm_s']:.1e}",
                ", ".join(map(_in_two_digits, stimulus["peak_drive_V"].values())),
            )
            for stimulus in stimuli
        ],
    )


def _show_touched(stimuli: list[dict[str, Any]], whose: str) -> None:
    focus, zones = stimuli[0]["focus"], list(stimuli[0]["zone_peak_mm_s"])
    _show_speeds(
        f"The same with fingers on the beam{whose}",
        ("pair", *zones, f"{focus} at focus mm/s", f"{focus} at most mm/s", "pull N"),
        [
            (
                stimulus,
                place,
                *(_in_two_digits(found["zone_peak_mm_s"][zone]) for zone in zones),
                _in_two_digits(found["zone_at_focus_mm_s"][focus]),
                _in_two_digits(found["attainable_mm_s"]),
                f"{found['pull_N']:.2f}",
            )
            for stimulus in stimuli
            for place, found in stimulus["touched"].items()
        ],
    )


def _show_speeds(title: str, headings: Sequence[str], rows: Sequence[tuple[Any, ...]]) -> None:
    """Print a table whose rows begin with the level, preceded by the stimulus name if there are several stimuli."""
    named = ["stimulus"] * ("stimulus" in rows[0][0])
    print_table(
        title,
        (*named, "level mm/s", *headings),
        [(*map(stimulus.get, named), stimulus["level"], *cells) for stimulus, *cells in rows],
        n_words=len(named),
    )


def _in_two_digits(value: float) -> str:
    """Format a value as an integer, or with two significant digits if it is below 10."""
    return f"{value:.0f}" if abs(value) >= 9.95 else f"{value:.2g}"
