"""The gallery: every shipped protocol with what it asks, the field that is predicted, and the order of a participant."""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from typer.testing import CliRunner

import modaltouch
from generator.pages import page, table, toctree, write
from modaltouch.cli import app
from modaltouch.protocol import Schedule
from modaltouch.report import CONDITION_COLOURS, PAIR_COLOURS, house_style, quiet_grid
from modaltouch.report.style import render

ROOT = Path(__file__).parents[2]
SCREENS = ROOT / "docs" / "_static" / "screens"
PARTICIPANT, SEED = "p01", 1
PAPER = "differentiated_stimulation"


def protocols() -> list[Path]:
    """Return the shipped protocols, the paper's first."""
    return sorted((ROOT / "protocols").glob("*.yaml"), key=lambda file: (file.stem != PAPER, file.stem))


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
    rows = []
    for trial in trials:
        condition = trial.condition
        level = (
            "nothing"
            if condition.is_catch
            else f"{condition.velocity_mm_s:g} mm/s"
            if condition.velocity_mm_s
            else "as the run says"
        )
        fingers = condition.finger_condition.replace("_", " ")
        rows.append(
            (
                str(trial.index),
                fingers,
                f"{condition.zone_left}–{condition.zone_right}",
                condition.stimulus or "",
                level,
            )
        )
    head = ["trial", "fingers", "zones", "stimulus", "level"]
    if not any(row[3] for row in rows):
        head, rows = [*head[:3], head[4]], [(*row[:3], row[4]) for row in rows]
    return table(head, rows)


def _report(static: Path) -> str:
    """Write the report of ten simulated participants of the paper's protocol, and return the link to it."""
    with TemporaryDirectory() as name:
        results, out = Path(name, "results"), Path(name, "report")
        for words in (f"simulate {PAPER} -n 10 --results {results}", f"analyse {results} --out {out}"):
            done = CliRunner().invoke(app, words.split())
            if done.exit_code:
                raise RuntimeError(f"modaltouch {words} ended with {done.exit_code}: {done.output}")
        write(static / "report.html", (out / "report.html").read_bytes())
    return '```{raw} html\n<p><a href="../../_static/report.html">The report of ten simulated participants</a></p>\n```'


def write_gallery(folder: Path, static: Path) -> None:
    """Write a page for each shipped protocol, and the page that leads to them."""
    rows = []
    for file in protocols():
        name, preflight = file.stem, modaltouch.examine(file).require()
        values = preflight.as_dict()
        with house_style():
            write(static / f"field_{name}.svg", render(_field(preflight), "svg"))
        answers = ", ".join(preflight.experiment.protocol.answers.keys)
        facts = [
            ("trials", f"{values['n_trials']}, and {values['n_practice_trials']} for practice"),
            ("length", f"about {values['estimated_duration_min']:.0f} min"),
            (
                "levels",
                ", ".join(f"{level:g}" for level in preflight.experiment.protocol.conditions.peak_velocities_mm_s)
                + " mm/s",
            ),
            ("answers", answers),
            ("modes", ", ".join(map(str, values["stimuli"][-1]["selected_modes"]))),
        ]
        kind = "with_catch_trials" if "none" in preflight.experiment.protocol.answers.keys else "demo"
        pictures = "\n".join(
            f"```{{image}} ../../_static/screens/{shot.name}\n:alt: The screen “{shot.stem.partition('-')[2][2:].replace('_', ' ')}”\n:width: 49%\n```"
            for shot in sorted(SCREENS.glob(f"{kind}-*.png"))
        )
        blocks = [
            _lead(file), table(("", ""), facts), "## The field that is predicted",
            f"```{{image}} ../static/field_{name}.svg\n:alt: Predicted and target velocity along the beam.\n:class: drawn\n```",
            f"## The first trials of {PARTICIPANT}", _order(preflight), "## What the participant sees", pictures,
            *(("## The report", _report(static)) if name == PAPER else ()),
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
    lead = "Every protocol that is shipped, by its name known in any folder: `modaltouch check NAME`, `modaltouch new --from NAME`."
    names = [file.stem for file in protocols()]
    write(
        folder / "index.md",
        page("Gallery", lead, table(("protocol", "name", "trials", "length"), rows), toctree(*names)),
    )


matplotlib.use("agg")
