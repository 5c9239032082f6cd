"""What is frozen, by collection: each collects its cases as plain values, for a test and for `write.py` alike."""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from freezing import masked
from inside import drive_of, orders_of
from outside import COMPLETE, ROOT, UNFINISHED, Outcome, call, change, workplace
from sayings import REFUSALS, Output, Refusal, log_of

import modaltouch

PROTOCOLS = tuple(sorted(file.stem for file in (ROOT / "protocols").glob("*.yaml")))
LAWS = ("exact", "paper")

UNDER_FINGERS = "under_the_finger"
"""The paper's law is one of the untouched beam."""

WHO = (("p01", 1, 1), ("p02", 1, 1), ("p02", 1, 2), ("p11", 20_260, 1), ("anna", 1, 1))
"""Participant, seed of the study and session: two who take turns, a further session, another seed, no number."""

RUNS = "max_same_pair_running: 2"
VARIANTS: dict[str, tuple[tuple[str, str], ...]] = {
    "by_pair": ((RUNS, "order: by_pair"),),
    "by_velocity": ((RUNS, "order: by_velocity"),),
    "latin_square": ((RUNS, "order: latin_square"),),
    "without_limit": ((RUNS, "max_same_pair_running: null"),),
    "unlike_neighbours": ((RUNS, "max_same_pair_running: 1"),),
    "many_repetitions": (("repetitions: 1", "repetitions: 12"),),
    "catches_by_pair": ((RUNS, "order: by_pair\n  catch_trials: 3"),),
    "placements": (("hand: right ", "placements: [normal, mirrored, swapped, mirrored_swapped]\n  hand: right "),),
    "one_order": (("counterbalance_finger_conditions: true", "counterbalance_finger_conditions: false"),),
}
"""Changes of the paper's protocol that have orders drawn in the other ways."""

HEAVY_LINE = "\N{BOX DRAWINGS HEAVY HORIZONTAL}"
"""What a bar of progress is drawn with."""

COHORT = "simulate differentiated_stimulation -n 10 --results results --json"
"""The ten participants of results/reference, whom `make results` simulates too."""


def codes(folder: Path) -> dict[str, Any]:
    """Return hashes of what each channel is given, and the amplitudes, of each stimulus of each protocol and law."""
    with workplace(folder):
        return {
            f"{name}, {law}": _drive(name, law)
            for name in PROTOCOLS
            for law in (LAWS if name != UNDER_FINGERS else LAWS[:1])
        }


def _drive(name: str, law: str) -> dict[str, Any]:
    file = change(
        Path("protocols", f"{name}.yaml"), (f"\n  law: {'exact' if law == 'paper' else law}", f"\n  law: {law}")
    )
    codes, rows = drive_of(file)
    return {
        stimulus: {
            "codes_sha256": [hashlib.sha256(row.astype(">u2").tobytes()).hexdigest() for row in given],
            "shape": list(given.shape),
            "amplitude_Vpp": {
                f"{row['velocity_mm_s']:g}": list(row["amplitude_Vpp"].values())
                for row in rows
                if " ".join(filter(None, (row.get("stimulus"), row.get("placement")))) == stimulus
            },
        }
        for stimulus, given in codes.items()
    }


def orders(folder: Path) -> dict[str, Any]:
    """Return the order of every shipped protocol, and of variants, for a few participants, seeds and sessions."""
    source = Path("protocols", "differentiated_stimulation.yaml")
    with workplace(folder):
        for name, changes in VARIANTS.items():
            copy = source.with_name(f"{name}.yaml")
            copy.write_bytes(source.read_bytes())
            change(copy, *changes)
        return {name: _orders(Path("protocols", f"{name}.yaml")) for name in (*PROTOCOLS, *VARIANTS)}


def _orders(protocol: Path) -> dict[str, Any]:
    drawn = zip(WHO, orders_of(protocol, WHO), strict=True)
    return {f"{who}, seed {seed}, session {n}": _in_short(order) for (who, seed, n), order in drawn}


def _in_short(schedule: dict[str, Any]) -> dict[str, Any]:
    """Return the hash of a whole order, practice included, with its first trials to look at."""
    return {
        "order_hash": schedule["order_hash"],
        "sha256": hashlib.sha256(json.dumps([schedule["practice"], schedule["order"]]).encode()).hexdigest(),
        "finger_conditions": schedule["finger_conditions"],
        "by": schedule["finger_conditions_by"],
        "n_trials": [schedule["n_practice_trials"], schedule["n_trials"]],
        "first": [*schedule["practice"][:1], *schedule["order"][:3]],
    }


def commands(folder: Path) -> dict[str, Any]:
    """Return the names of all commands with their arguments and options, as ``--help`` lists them."""
    return {f"modaltouch {words}".strip(): page for words, page in _pages("")}


def _pages(words: str) -> list[tuple[str, dict[str, Any]]]:
    said = call(f"{words} --help").stdout
    usage = re.search(r"^Usage: modaltouch(.*?)\n\n", said, flags=re.MULTILINE | re.DOTALL)
    assert usage is not None, said
    _, _, below = said.partition("\nCommands:\n")
    names = re.findall(r"^  ([a-z]\S*)", below, flags=re.MULTILINE)
    arguments = [word.strip("[]{}.").lower() for word in usage.group(1).split()[len(words.split()) :]]
    entries = re.findall(r"^  (-.*?)(?:  |$)", said, flags=re.MULTILINE)
    page = {
        "arguments": [word for word in arguments if word not in ("options", "command", "args")],
        "options": [option for entry in entries for option in re.findall(r"--?[A-Za-z][\w-]*", entry)],
        **({"commands": names} if names else {}),
    }
    return [(words, page), *(each for name in names for each in _pages(f"{words} {name}".strip()))]


def output(case: Output, folder: Path) -> dict[str, Any]:
    """Return exit status and object of a command that is given in a folder of its own."""
    with workplace(folder):
        case.prepare()
        done = call(case.line, interrupt_at=case.interrupt_at)
    said = re.sub(case.by_chance, case.usual, without_places(done.stdout, folder))
    found = {"status": done.status, "json": json.loads(said)}
    return {"line": case.line, **masked(found, case.volatile, case.unordered)}


def refusals(folder: Path) -> dict[str, Any]:
    """Return exit status and words of every command line that is refused or ends early."""
    return {case.name: refusal(case, folder / str(number)) for number, case in enumerate(REFUSALS)}


def refusal(case: Refusal, folder: Path) -> dict[str, Any]:
    """Return exit status and the words on standard error of a command that is given in a folder of its own."""
    with workplace(folder):
        case.prepare()
        done = call(case.line, interrupt_at=case.interrupt_at)
    return {"status": done.status, "stderr": words_of(done, folder)}


def words_of(done: Outcome, folder: Path) -> list[str]:
    """Return the lines on standard error without what differs from day to day, and without the words of Typer."""
    said = without_places(done.stderr, folder)
    for pattern in (r"(?<=127\.0\.0\.1,)\d+", r"\d+\.\d+(?= s after the first burst)", r"\d+ (?:s|min)(?= left)"):
        said = re.sub(pattern, "{number}", said)
    said = re.sub(r"^(Usage: |Try ').*\n", "", said, flags=re.MULTILINE)
    said = re.sub(r"^(Error: (?:No such \w+|Missing \w+|Invalid value for)).*", r"\1", said, flags=re.MULTILINE)
    return [line.rstrip() for line in said.splitlines() if line.strip() and HEAVY_LINE not in line]


def without_places(text: str, folder: Path) -> str:
    """Return a text with names in place of this machine's folders."""
    return text.replace(str(folder), "{folder}").replace(str(ROOT), "{root}")


def records(folder: Path) -> dict[str, Any]:
    """Return what is read from the recorded sessions, and from the unfinished one when it has been resumed."""
    with workplace(folder):
        found = {"complete": _read(COMPLETE), "unfinished": _read(UNFINISHED)}
        for line in (f"resume {UNFINISHED}", f"verify {UNFINISHED}"):
            done = call(line)
            assert done.status == 0, done.stderr
        return {**found, "resumed": _read(UNFINISHED)}


def _read(session: str) -> dict[str, Any]:
    read = modaltouch.read_session(log_of(session))
    answers = []
    for event in read.trials:
        trial, condition = event["trial"], event["trial"]["condition"]
        place = [condition[name] for name in ("finger_condition", "zone_left", "zone_right", "velocity_mm_s")]
        answers.append(
            ["practice" if trial["practice"] else "trial", trial["index"], *place, event["response"]["answer"]]
        )
    told = {name: getattr(read, name) for name in ("mode", "participant", "protocol", "complete", "n_answered")}
    kinds = dict(sorted(Counter(event["event"] for event in read.events).items()))
    return {**told, "problems": list(read.problems), "events": kinds, "answers": answers}


def statistics(folder: Path) -> dict[str, Any]:
    """Return every number of the analysis of the simulated cohort, and the heads of its tables."""
    with workplace(folder):
        return analysed(cohort())


def cohort() -> Path:
    """Simulate the cohort, analyse it in the folder ``analysis``, and return that."""
    for line in (COHORT, "analyse results --out analysis --json"):
        done = call(line)
        assert done.status == 0, done.stderr
    Path("analysis", "said.json").write_text(done.stdout, encoding="utf-8")
    return Path("analysis").absolute()


def analysed(folder: Path) -> dict[str, Any]:
    """Return what an analysis said, with the heads of its tables."""
    said = masked(json.loads((folder / "said.json").read_text(encoding="utf-8")), ("version", "source"))
    heads = {file.name: file.read_text(encoding="utf-8").splitlines()[0] for file in sorted(folder.glob("*.csv"))}
    return {**said, "files": sorted(said["files"]), "heads": heads}


COLLECTIONS: dict[str, Callable[[Path], dict[str, Any]]] = {
    "codes": codes,
    "orders": orders,
    "commands": commands,
    "refusals": refusals,
    "records": records,
    "statistics": statistics,
}
