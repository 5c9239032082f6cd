"""What a comparison says, in sentences made from its numbers: where each method wins, and at what price."""

from __future__ import annotations

from collections.abc import Sequence

from modaltouch.lab.comparison.results import Criterion, Row, criteria

OWN = "exact"
"""The method of this program."""


def paragraphs(rows: Sequence[Row], level: float, n_beams: int) -> list[str]:
    """Return what the numbers say.

    Parameters
    ----------
    rows : sequence of dict
        As `rows_of` returns them.
    level : float
        Velocity wished at the focus [mm/s].
    n_beams : int
        Other beams that the drives were played on.
    """
    own = next(row for row in rows if row["method"] == OWN)
    every = [each for each in criteria(rows) if each.best != "none"]
    lost = [each for each in every if own not in each.winners(rows, level)]
    won = [each for each in every if each not in lost]
    said = [_own_wins(won, own, rows, level)]
    said += [_by_rival(row, lost, own, rows, level) for row in rows if row is not own]
    said += [_reach(rows, level)]
    if n_beams:
        said.append(_changed(rows, n_beams))
    return [words for words in said if words]


def _own_wins(won: Sequence[Criterion], own: Row, rows: Sequence[Row], level: float) -> str:
    parts = []
    for each in won:
        shared = len(each.winners(rows, level)) > 1
        parts.append(f"{each.name} ({_value(each, own)}{', shared' if shared else ''})")
    return f"{_named(own)}: best in {'; '.join(parts) or 'nothing'}."


def _by_rival(row: Row, lost: Sequence[Criterion], own: Row, rows: Sequence[Row], level: float) -> str:
    """Return where a rival beats all others, and how it compares in the wished field."""
    wins = [each for each in lost if row in each.winners(rows, level)]
    parts = [f"{each.name} ({_value(each, row)}, against {_value(each, own)} by the {own['name']})" for each in wins]
    field = next(each for each in criteria(rows) if each.key == "rms_error_mm_s")
    first = f"{_named(row)}: best in {'; '.join(parts) or 'nothing'}."
    times = row[field.key] / own[field.key]
    if times > 1:
        price = f"It is {times:.1f} times as far from the wished field as the {own['name']}"
    else:
        price = f"It is closer to the wished field than the {own['name']}"
    return f"{first} {price}: {_value(field, row)} against {_value(field, own)}."


def _reach(rows: Sequence[Row], level: float) -> str:
    short = [row for row in rows if row["at_focus_mm_s"] < 0.95 * level]
    if not short:
        return f"Within the voltage limit every method reaches the {level:g} mm/s within 5 %."
    names = "; ".join(f"{row['name']} {row['at_focus_mm_s']:.0f} mm/s" for row in short)
    return f"More than 5 % short of the {level:g} mm/s: {names}."


def _changed(rows: Sequence[Row], n_beams: int) -> str:
    order = sorted(rows, key=lambda row: float(row["changed_drift_mm_s"]))
    least, most = order[0], order[-1]
    return (
        f"Played on {n_beams} other beams, drawn around the one that was learned, the field changes least by the "
        f"{least['name']} ({least['changed_drift_mm_s']:.1f} mm/s rms, median) and most by the {most['name']} "
        f"({most['changed_drift_mm_s']:.1f} mm/s). Nothing was learned anew on them."
    )


def _named(row: Row) -> str:
    """Return a method's name as a sentence begins with it."""
    name = str(row["name"])
    return name[:1].upper() + name[1:]


def _value(each: Criterion, row: Row) -> str:
    return f"{each.printed(row)} {each.unit}".strip()
