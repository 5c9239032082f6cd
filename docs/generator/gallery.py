"""The gallery: every shipped protocol with its screens, an order, its predicted field and a report of simulated people."""

import html
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

import modaltouch
from generator.pages import page, table, toctree, write
from generator.runs import COHORT, protocols, run_all
from generator.screens import png, screens
from modaltouch.protocol import Schedule
from modaltouch.report import CONDITION_COLOURS, PAIR_COLOURS, house_style, quiet_grid
from modaltouch.report.page import render

ROOT = Path(__file__).parents[2]
PARTICIPANT, SEED = "p01", 1
ANSWERED_ON = {"vas": "a place on a line", "likert": "a point of a scale", "number": "a number that is typed"}


def _field(preflight) -> Figure:
    figure = Figure(figsize=(6.4, 2.8))
    axes = figure.subplots()
    fields = preflight.fields
    for field, colour in zip(fields, [*PAIR_COLOURS[:2], *CONDITION_COLOURS[1:]], strict=False):
        name = field.get("stimulus") or field.get("placement", "")
        place = np.linspace(-field["length_mm"] / 2, field["length_mm"] / 2, len(field["predicted_mm_s"]))
        axes.plot(place, field["predicted_mm_s"], color=colour, label=name or "predicted", linewidth=1.8)
    axes.plot(place, fields[0]["target_mm_s"], color="#5d6775", linestyle="--", linewidth=1, label="target")
    for zone, (low, high) in fields[0]["zones_mm"].items():
        axes.text(
            (low + high) / 2, 1.0, zone, transform=axes.get_xaxis_transform(), ha="center", va="bottom", color="#5d6775"
        )
        axes.axvline(high, color="#e3e7ec", linewidth=0.8, zorder=0)
    axes.set_xlabel("place on the beam (mm)")
    axes.set_ylabel(f"velocity at {fields[0]['velocity_mm_s']:g} mm/s (mm/s)")
    axes.legend(frameon=False)
    quiet_grid(axes)
    return figure


def _lead(file: Path) -> str:
    lines = [line[2:] for line in file.read_text(encoding="utf-8").splitlines() if line.startswith("# ")]
    return " ".join(line for line in lines if not line.startswith("yaml-language-server"))


def _order(preflight) -> str:
    protocol = preflight.experiment.protocol
    trials = Schedule.draw(protocol, PARTICIPANT, SEED, 1).trials[:12]
    columns = {
        "trial": [str(trial.index) for trial in trials],
        "fingers": [trial.condition.finger_condition.replace("_", " ") for trial in trials],
        "zones": ["–".join(trial.condition.zones) for trial in trials],
        "stimulus": [trial.condition.stimulus for trial in trials],
        "interval of the comparison": [str(trial.interval or "") for trial in trials],
        "level": [_level(protocol, trial.condition) for trial in trials],
    }
    shown = {name: cells for name, cells in columns.items() if any(cells)}
    return table(list(shown), zip(*shown.values(), strict=True))


def _level(protocol, condition) -> str:
    if condition.is_catch:
        return "nothing"
    if protocol.adaptive is not None:
        return "set by the adaptive run"
    own = protocol.conditions.sensation_levels
    if own is None:
        return f"{condition.velocity_mm_s:g} mm/s"
    # Until a threshold is known, the order is drawn for the highest that can be used.
    highest = max(protocol.conditions.peak_velocities_mm_s)
    return f"{condition.velocity_mm_s / highest * max(own.multiples):.3g} × threshold"


def _levels(protocol) -> str:
    levels = [f"{level:g}" for level in protocol.conditions.peak_velocities_mm_s]
    if protocol.adaptive is None and protocol.conditions.sensation_levels is None:
        return f"{', '.join(levels)} mm/s"
    return f"{levels[0]} to {levels[-1]} mm/s"


def _screens(preflight, name: str, static: Path) -> str:
    """Draw the screens of a session, and return what shows them."""
    shown = []
    for picture in screens(preflight.experiment):
        file = f"screen_{name}_{picture.name}.png"
        write(static / file, png(picture, preflight.experiment.texts))
        shown.append(
            f'<img src="../../_static/{file}" width="800" height="500" loading="lazy" '
            f'alt="{html.escape("; ".join(picture.texts), quote=True)}">'
        )
    return "\n".join(("```{raw} html", '<div class="screens">', *shown, "</div>", "```"))


def write_gallery(folder: Path, static: Path) -> None:
    """Write a page for each shipped protocol, and the page that leads to them."""
    rows = []
    for file in protocols():
        name, preflight = file.stem, modaltouch.examine(file).require()
        values = preflight.as_dict()
        with house_style():
            write(static / f"field_{name}.svg", render(_field(preflight), "svg"))
        scale = preflight.experiment.protocol.answers.scale
        answers = ", ".join(preflight.experiment.protocol.answers.keys) if scale is None else ANSWERED_ON[scale.kind]
        facts = [
            ("trials", f"{values['n_trials']}, plus {values['n_practice_trials']} for practice"),
            ("length", f"about {values['estimated_duration_min']:.0f} min"),
            ("levels", _levels(preflight.experiment.protocol)),
            ("answers", answers),
            ("modes", ", ".join(map(str, values["stimuli"][-1]["selected_modes"]))),
        ]
        write(static / f"report_{name}.html", run_all().reports[name])
        blocks = [
            _lead(file), table(("", ""), facts),
            "## What the participant sees", _screens(preflight, name, static),
            f"## The first trials of {PARTICIPANT}", _order(preflight),
            "## The predicted field",
            f"```{{image}} ../static/field_{name}.svg\n:alt: Predicted and target velocity along the beam.\n:class: drawn\n```",
            "## The report",
            f'```{{raw}} html\n<p><a href="../../_static/report_{name}.html">The report for {COHORT.get(name, 6)} simulated participants'
            "</a></p>\n```",
            "## The file", f"```{{literalinclude}} ../../../protocols/{file.name}\n:language: yaml\n```",
        ]  # fmt: skip
        title = values["title"] or name
        write(folder / f"{name}.md", page(title, *blocks))
        rows.append(
            (
                f"[{title}]({name}.md)",
                f"`{name}`",
                f"{values['n_trials']}",
                f"{values['estimated_duration_min']:.0f} min",
            )
        )
    lead = (
        "The shipped protocols. Their names work in any folder: `modaltouch check NAME`, `modaltouch new --from NAME`."
    )
    names = [file.stem for file in protocols()]
    write(
        folder / "index.md",
        page("Gallery", lead, table(("protocol", "name", "trials", "length"), rows), toctree(*names)),
    )


matplotlib.use("agg")
