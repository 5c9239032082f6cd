"""Designs that are not crossed: a table of cells, cells in the protocol, and excluded cells; faults with positions."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

import pytest

from modaltouch.protocol import Findings, InputError, Protocol, Schedule, Sources

SHIPPED = Path(__file__).parents[3] / "protocols"
CROSSED = "  zone_pairs: [[A, C], [B, D], [C, E]]\n  peak_velocities_mm_s: [80, 200]\n"
TABLE = """zone_left,zone_right,peak_velocity_mm_s,finger_condition,weight
A,C,80,,2
A,C,200,,
B,D,150,one_hand,
C,E,100,,
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the shipped apparatus and texts."""
    place = tmp_path_factory.mktemp("protocols")
    for name in ("apparatus", "texts"):
        shutil.copytree(SHIPPED / name, place / name)
    return place


def read(folder: Path, conditions: str, table: str = "", order: str = "shuffled") -> Findings:
    """Return the findings of the demonstration with other conditions."""
    text = (SHIPPED / "demo.yaml").read_text("utf-8").replace(CROSSED, conditions)
    text = text.replace("max_same_pair_running: 2", f"order: {order}")
    (folder / "cells.csv").write_text(table, "utf-8")
    (folder / "own.yaml").write_text(text, "utf-8")
    return Findings.read(folder / "own.yaml")


def sound(findings: Findings) -> Protocol:
    """Return the protocol of findings without faults."""
    return findings.experiment().protocol


def faults(findings: Findings) -> list[str]:
    """Return the faults, with bare file names."""
    with pytest.raises(InputError, match="given") as refusal:
        findings.experiment()
    return [f"{Path(each.file).name}:{each.line}:{each.column} {each.message}" for each in refusal.value.problems]


def driven(protocol: Protocol, participant: str = "p01") -> Counter[tuple[str, str, float]]:
    """Return the number of trials by finger condition, pair and level."""
    trials = Schedule.draw(protocol, participant, 1).trials
    return Counter(
        (trial.condition.finger_condition, "-".join(trial.condition.zones), trial.condition.velocity_mm_s)
        for trial in trials
    )


def test_a_table_gives_levels_by_pair_and_weights(folder: Path) -> None:
    """A-C at 80 twice as often; B-D with one hand only; C-E at its own level."""
    findings = read(folder, "  table: cells.csv\n", TABLE)
    both = {("A-C", 80.0): 2, ("A-C", 200.0): 1, ("C-E", 100.0): 1}
    expected = {(name, *cell): n for name in ("one_hand", "two_hands") for cell, n in both.items()}
    expected["one_hand", "B-D", 150.0] = 1
    assert driven(sound(findings)) == expected
    assert sound(findings).n_trials == 9
    assert sound(findings).conditions.peak_velocities_mm_s == (80.0, 200.0, 150.0, 100.0)


def test_a_line_for_each_trial_is_a_weight(folder: Path) -> None:
    """A table of trials repeats its cells, in any order."""
    weighted = sound(read(folder, "  table: cells.csv\n", TABLE))
    lines = TABLE.replace(",2\n", ",1\n") + "A,C,80,,1\n"
    assert driven(sound(read(folder, "  table: cells.csv\n", lines))) == driven(weighted)


def test_one_level_may_be_written_in_two_ways(folder: Path) -> None:
    """As in spreadsheets: 80 and 80.0."""
    findings = read(folder, "  table: cells.csv\n", TABLE.replace("B,D,150", "B,D,80.0"))
    assert sound(findings).conditions.peak_velocities_mm_s == (80.0, 200.0, 100.0)


def test_the_record_keeps_the_table(folder: Path) -> None:
    """The protocol is restored from it without the file."""
    findings = read(folder, "  table: cells.csv\n", TABLE)
    kept = findings.experiment().sources.as_dict()
    assert kept["table"]["text"] == TABLE
    again = Findings.restored(Sources.from_dict(kept)).experiment().protocol
    assert again == sound(findings)


def test_cells_in_the_protocol_are_equivalent_to_a_table(folder: Path) -> None:
    """The same design in YAML, with several levels per line."""
    written = (
        "  cells:\n"
        "    - {pair: [A, C], peak_velocities_mm_s: [80], weight: 2}\n"
        "    - {pair: [A, C], peak_velocities_mm_s: [200]}\n"
        "    - {pair: [B, D], peak_velocities_mm_s: [150], finger_conditions: [one_hand]}\n"
        "    - {pair: [C, E], peak_velocities_mm_s: [100]}\n"
    )
    assert driven(sound(read(folder, written))) == driven(sound(read(folder, "  table: cells.csv\n", TABLE)))


def test_a_cell_is_excluded_if_all_keys_match(folder: Path) -> None:
    """Of 3 pairs x 2 levels x 2 finger conditions, A-C at 80 and B-D with two hands are excluded: 12 - 2 - 2."""
    exclude = "  exclude: [{pair: [A, C], peak_velocity_mm_s: 80}, {pair: [B, D], finger_condition: two_hands}]\n"
    own = driven(sound(read(folder, CROSSED + exclude)))
    assert sum(own.values()) == 8
    assert not [cell for cell in own if cell[1:] == ("A-C", 80.0) or cell[:2] == ("two_hands", "B-D")]


@pytest.mark.parametrize("participant", ["p01", "p02"])
def test_as_listed_repeats_the_order_of_the_rows(folder: Path, participant: str) -> None:
    """A cell may be in several rows."""
    table = "zone_left,zone_right,peak_velocity_mm_s\nC,E,100\nA,C,80\nC,E,100\n"
    findings = read(folder, "  table: cells.csv\n", table, "as_listed")
    protocol = sound(findings)
    twice = protocol.model_copy(update={"schedule": protocol.schedule.model_copy(update={"repetitions": 2})})
    for block in Schedule.draw(twice, participant, 1).blocks:
        assert [trial.condition.velocity_mm_s for trial in block.trials] == [100, 80, 100] * 2


@pytest.mark.parametrize("order", ["by_pair", "by_velocity", "latin_square"])
def test_every_order_presents_the_same_cells(folder: Path, order: str) -> None:
    """The order does not change the number of trials of a cell."""
    protocol = sound(read(folder, "  table: cells.csv\n", TABLE))
    schedule = protocol.schedule.model_copy(update={"order": order})
    for participant in ("p01", "p02", "p03"):
        assert driven(protocol.model_copy(update={"schedule": schedule}), participant) == driven(protocol)


@pytest.mark.parametrize(
    ("table", "told"),
    [
        (TABLE.replace("A,C,80", "A,C,80x"), "cells.csv:2:5 given '80x'; allowed: a number [mm/s] above 0"),
        (TABLE.replace("B,D", "B,Q"), "cells.csv:4:3 given 'Q', which is not a zone of this beam; allowed: A, B, C, D"),
        (TABLE.replace("200", "2000"), "cells.csv:3:5 given 2000 mm/s, above the safety limit of the apparatus"),
        (TABLE.replace(",,2", ",,0"), "cells.csv:2:9 given 0; allowed: a whole number of at least 1"),
        (TABLE.replace("one_hand", "on_hand"), "cells.csv:4:9 given 'on_hand', which is not a finger condition"),
        (TABLE.replace("C,E,100,,", "C,E,100"), "cells.csv:5:1 given 3 fields; allowed: 5, one for each column"),
        (TABLE.replace("peak_velocity_mm_s", "velocity"), "cells.csv:1:1 given a table without the column peak_velo"),
        (
            TABLE.replace("weight", "masked"),
            "cells.csv:1:58 given the column 'masked'; allowed: once each: zone_left, zone_right, peak_velocity_mm_s, "
            "zone_between, finger_condition, stimulus, weight; give it to the `stimuli` of the protocol (masked), and",
        ),
        (TABLE.replace("weight", "weigth"), "cells.csv:1:58 given the column 'weigth'; allowed: once each"),
        (TABLE.replace("A,C,80,", 'A,"C","80,5",'), "cells.csv:2:8 given '80,5'; allowed: a number [mm/s] above 0"),
        (
            TABLE.replace("A,C,80,", "A,C,80,5,"),
            "cells.csv:2:1 given 6 fields; allowed: 5, one for each column; correct the",
        ),
        (TABLE.replace("A,C,80,", 'A,"C,80,'), "cells.csv:2:1 given an unpaired quotation mark; allowed: q"),
        (TABLE.splitlines()[0] + "\n", "cells.csv:1:1 given a table without rows; allowed: at least one cell"),
    ],
)
def test_a_fault_in_a_table_has_its_line_and_column(folder: Path, table: str, told: str) -> None:
    """Consequences of the fault are not reported as well."""
    said = faults(read(folder, "  table: cells.csv\n", table))
    assert any(each.startswith(told) for each in said), said
    assert not any("missing key" in each for each in said)


@pytest.mark.parametrize(
    ("conditions", "told"),
    [
        (CROSSED + "  table: cells.csv\n", "given zone_pairs and table, which say the same"),
        ("  table: none.csv\n", "given 'none.csv', a file that does not exist"),
        (CROSSED + "  exclude: [{pair: [A, D]}]\n", "given cells that are not in the design"),
        (CROSSED + "  exclude: [{finger_condition: one_hand}]\n", "given one_hand, which has no cells left"),
        (
            CROSSED + "  exclude: [{finger_condition: one_hand}, {finger_condition: two_hands}]\n",
            "given one_hand, which has no cells left",
        ),
        (CROSSED + "  exclude: [{stimulus: wide}]\n", "given 'wide', which is not a stimulus of the protocol"),
        (
            CROSSED + "  exclude: [{stimulus: wide}]\nstimuli: {narrow: {}, wide: {field: {base_mm: 80}}}\n",
            "given wide, which is in no cell; allowed: stimuli with cells; leave it out, or give it cells",
        ),
    ],
)
def test_contradictory_conditions_are_refused(folder: Path, conditions: str, told: str) -> None:
    """The message has the remedy."""
    said = faults(read(folder, conditions, TABLE))
    assert any(told in each for each in said), said


def test_a_misspelt_zone_is_reported_once(folder: Path) -> None:
    """Not also as excluded cells that are missing from the design."""
    cells = (
        "  cells:\n    - {pair: [A, C], peak_velocities_mm_s: [80]}\n    - {pair: [B, Q], peak_velocities_mm_s: [80]}\n"
    )
    (said,) = faults(read(folder, cells + "  exclude: [{pair: [B, D]}]\n"))
    assert "given 'Q', which is not a zone of this beam; allowed: A, B, C, D, E" in said


@pytest.mark.parametrize(
    ("conditions", "path"),
    [
        ("  cells: [{pair: [A, C], peak_velocities_mm_s: [80]}, {pair: [B, Q], peak_velocities_mm_s: [80]}]\n",
         "conditions.cells[1].pair[1]"),
        (CROSSED + "  exclude: [{peak_velocity_mm_s: 80}, {pair: [Q, C]}]\n", "conditions.exclude[1].pair[0]"),
        ("  table: cells.csv\n", "zone_right"),
    ],
)  # fmt: skip
def test_a_misspelt_zone_has_its_own_path(folder: Path, conditions: str, path: str) -> None:
    """Or its column in a table; not the path of the derived list of zones or of the whole entry."""
    (found,) = read(folder, conditions, "zone_left,zone_right,peak_velocity_mm_s\nA,Q,80\n").problems
    assert (found.as_dict()["path"], found.given) == (path, "'Q', which is not a zone of this beam")
    assert f": {path}: given 'Q'" in str(found)


def test_a_faulty_stimulus_is_not_reported_as_unknown(folder: Path) -> None:
    """Excluding its cells causes no second problem."""
    read(folder, CROSSED + "  exclude: [{stimulus: sharp}]\n")
    file, fields = folder / "own.yaml", "stimuli:\n  sharp: {}\n  blunt: {field: {shape: gausian}}\n"
    file.write_text(file.read_text("utf-8").replace("conditions:\n", fields + "conditions:\n"), "utf-8")
    (said,) = faults(Findings.read(file))
    assert "'gausian'" in said


def test_a_stimulus_is_designed_only_for_its_own_levels(folder: Path) -> None:
    """A blunt field need not reach the level of the sharp one, which the amplifier could not drive."""
    fields = "stimuli:\n  sharp: {field: {base_mm: 56}}\n  blunt: {field: {shape: raised_cosine, base_mm: 100}}\n\n"
    cells = "  cells:\n    - {pair: [A, C], peak_velocities_mm_s: [260], stimuli: [sharp]}\n"
    cells += "    - {pair: [A, C], peak_velocities_mm_s: [80, 120], stimuli: [blunt]}\n"
    assert own_levels(folder, fields, cells) == {"sharp": [260.0], "blunt": [80.0, 120.0]}


def own_levels(folder: Path, stimuli: str, conditions: str, intervals: str = "") -> dict[str, list[float]]:
    """Return the levels for which each stimulus is designed [mm/s]."""
    read(folder, conditions)
    file, extra = folder / "own.yaml", f"{stimuli}{intervals}conditions:\n"
    text = file.read_text("utf-8").replace("conditions:\n", extra)
    if intervals:
        text = text.replace("stimulus_until: answer", "stimulus_until: question")
        text = text[: text.index("  keys:")] + "  keys: {first: [left], second: [right]}\n"
        text += "  intervals: {first: 1, second: 2}\n"
    file.write_text(text, "utf-8")
    parts = dict(Findings.read(file).each_stimulus())
    assert not [problem for part in parts.values() for problem in part.problems]
    return {name: sorted(part.levels.values()) for name, part in parts.items()}


def test_stimuli_with_the_same_records_share_their_levels(folder: Path) -> None:
    """Bursts, masking and rate do not change a waveform, so such stimuli share the generator's memories."""
    stimuli = "stimuli:\n  few: {presentation_bursts: 2}\n  slow: {repetition_rate_Hz: 3.5}\n"
    stimuli += "  blunt: {field: {shape: raised_cosine, base_mm: 100}}\n\n"
    cells = "".join(
        f"    - {{pair: [A, C], peak_velocities_mm_s: [{level}], stimuli: [{name}]}}\n"
        for name, level in (("few", 80), ("slow", 150), ("blunt", 60))
    )
    shared = own_levels(folder, stimuli, f"  cells:\n{cells}")
    assert shared == {"few": [80.0, 150.0], "slow": [80.0, 150.0], "blunt": [60.0]}


@pytest.mark.parametrize(
    ("standard", "levels"),
    [
        ("{velocity_mm_s: 100, stimulus: blunt}", {"sharp": [80.0, 200.0], "blunt": [100.0]}),
        ("{stimulus: blunt}", {"sharp": [80.0, 200.0], "blunt": [80.0, 200.0]}),
    ],
)
def test_a_standard_of_another_field_is_designed_only_for_its_level(
    folder: Path, standard: str, levels: dict[str, list[float]]
) -> None:
    """Unless it has the level of the comparison."""
    fields = "stimuli:\n  sharp: {field: {base_mm: 56}}\n  blunt: {field: {shape: raised_cosine, base_mm: 100}}\n\n"
    intervals = f"intervals: {{number: 2, standard: {standard}, asked: comparison}}\n"
    assert own_levels(folder, fields, CROSSED + "  exclude: [{stimulus: blunt}]\n", intervals) == levels
