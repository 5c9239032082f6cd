"""Command lines whose answer is frozen, each given in a `workplace`; those that spoil something first say how."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from outside import COMPLETE, ROOT, UNFINISHED, change

SIMULATED = "--rig simulated --answers simulated"


def nothing() -> None:
    """Leave the workplace as it is."""


@dataclass(frozen=True)
class Output:
    """A command with ``--json`` that is done.

    Attributes
    ----------
    line : str
        The words after ``modaltouch``.
    volatile : tuple of str
        Patterns of the paths, in exit status and object, whose values differ by day or machine:
        of these the types are frozen.
    unordered : tuple of str
        Patterns of the paths of lists that rounding alone may order.
    prepare : callable
        What is done in the workplace before.
    rel, absolute : float
        Bounds within which a number may differ from the frozen one by other processors' rounding; wider where a search
        ends or noise is fitted.
    interrupt_at : str
        Words on standard error at which Ctrl-C is pressed.
    by_chance, usual : str
        Pattern of words that a busy machine may bring about, and what takes their place.
    """

    line: str
    volatile: tuple[str, ...] = ()
    unordered: tuple[str, ...] = ()
    prepare: Callable[[], None] = nothing
    rel: float = 1e-9
    absolute: float = 1e-9
    interrupt_at: str = ""
    by_chance: str = "(?!)"
    usual: str = ""


@dataclass(frozen=True)
class Refusal:
    """A command that is refused, or ends early."""

    line: str
    prepare: Callable[[], None] = nothing
    interrupt_at: str = ""

    @property
    def name(self) -> str:
        """The line, and what was done before or meanwhile."""
        before = "" if self.prepare is nothing else f" [{self.prepare.__name__}]"
        return f"{self.line}{before}{' [interrupted]' if self.interrupt_at else ''}"


def log_of(session: str = COMPLETE) -> Path:
    """Return the log of a session."""
    return Path(session, "beh", "session.jsonl")


def damage() -> None:
    """Change one letter in the middle of a log."""
    data = log_of().read_bytes()
    place = data.index(b'"answer":"', len(data) // 2) + len(b'"answer":"')
    log_of().write_bytes(data[:place] + b"x" + data[place + 1 :])


def cut() -> None:
    """Cut the log's last line in two, as a power failure does."""
    data = log_of(UNFINISHED).read_bytes()
    log_of(UNFINISHED).write_bytes(data[:-40])


def forge() -> None:
    """Say of an answer that it was another, and make the checks of all lines fit.

    The check of a line is the SHA-256 of that of the line before, in hexadecimal digits, and the line up to it.
    """
    lines, check = [], "0" * 64
    forged = False
    for line in log_of().read_text(encoding="utf-8").splitlines():
        event: dict[str, Any] = json.loads(line)
        event.pop("check")
        if event["event"] == "trial" and not forged:
            event["planned"]["velocity_mm_s"], forged = 99.0, True
        body = json.dumps(event, ensure_ascii=False, separators=(",", ":"))[:-1]
        check = hashlib.sha256(f"{check}{body}".encode()).hexdigest()
        lines.append(f'{body},"check":"{check}"}}\n')
    log_of().write_text("".join(lines), encoding="utf-8", newline="\n")


def rewrite_table() -> None:
    """Change an answer in the table beside the log."""
    (table,) = log_of().parent.glob("*_beh.tsv")
    text = table.read_text(encoding="utf-8")
    assert "\tboth\t" in text
    table.write_text(text.replace("\tboth\t", "\tleft\t", 1), encoding="utf-8", newline="\n")


def spoil_protocol() -> None:
    """Make four faults in a protocol."""
    change(
        Path("protocols/demo.yaml"),
        ("[C, E]]", "[C, F], [A, C]]"),
        ("[80, 200]", "[80, 900]"),
        ("hand: right", "hnad: right"),
    )


def overdrive() -> None:
    """Ask for more velocity than the amplifier can drive."""
    change(Path("protocols/demo.yaml"), ("[80, 200]", "[80, 400]"))


def break_yaml() -> None:
    """Leave a bracket open."""
    change(Path("protocols/demo.yaml"), ("[80, 200]", "[80, 200"))


def spoil_apparatus() -> None:
    """Give a damping ratio that no beam has, and name a channel twice."""
    change(
        Path("protocols/apparatus/beam_100x6x2.yaml"),
        ("damping_ratio: 0.0437", "damping_ratio: -1"),
        ("side: {channel: 2}", "side: {channel: 1}"),
    )


def spoil_texts() -> None:
    """Leave a text out, and a word in braces."""
    change(
        Path("protocols/texts/english.yaml"),
        ("\nleft: Left", ""),
        ("Practice {number} of {total}", "Practice {number}"),
    )


def spoil_observer() -> None:
    """Give an observer that no person can be."""
    file = shutil.copy(ROOT / "protocols" / "observers" / "paper.yaml", "mine.yaml")
    text = Path(file).read_text(encoding="utf-8")
    Path(file).write_text(text + "nonsense: 1\n", encoding="utf-8")


def write_answers(*rows: str) -> None:
    """Write a table of answers."""
    head = "participant,finger_condition,zone_left,zone_right,velocity_mm_s,response"
    Path("answers.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")


def few_answers() -> None:
    """Write the answers of six people at two levels."""
    write_answers(
        *(
            f"p{n},one_hand,{left},{right},{level},{answer}"
            for n in range(1, 7)
            for left, right, answers in (
                ("A", "C", ("both", "right")),
                ("C", "E", ("left", "left" if n > 2 else "both")),
            )
            for level, answer in zip((80, 200), answers, strict=True)
        )
    )


def bad_answers() -> None:
    """Write answers that cannot be: a word, a level, a column too few."""
    write_answers("p1,one_hand,A,C,80,right", "p1,one_hand,A,C,80,up", "p2,one_hand,A,C,-3,left", "p2,one_hand,A,C")


def other_output() -> None:
    """Put what another command wrote where a plan should go."""
    Path("taken").mkdir()
    Path("taken/manifest.json").write_text('{"generated_by": "modaltouch analyse", "files": {}}', encoding="utf-8")


def response_file() -> None:
    """Write a velocity response of two modes, without noise."""
    import numpy as np

    frequency = np.arange(1, 1200) * 0.5
    omega = 2 * np.pi * frequency
    values = np.zeros(frequency.size, dtype=complex)
    for own, ratio in ((120.0, 0.01), (330.0, 0.01)):
        pole = 2 * np.pi * own
        values += 1j * omega / (pole**2 - omega**2 + 2j * ratio * pole * omega)
    np.savez("point.npz", frequency=frequency, response=values[None, None], sets=["hammer"], quantity="velocity")


def former_records() -> None:
    """Bring the records of format 1."""
    shutil.copytree(ROOT / "tests" / "record" / "format_1", "format_1")


OUTPUTS: dict[str, Output] = {
    **{
        f"check_{name}": Output(f"check protocols/{name}.yaml --json")
        for name in ("differentiated_stimulation", "sensation_levels", "threshold", "two_fields", "with_catch_trials")
    },
    # Gains of modes that are not driven change nothing: the last rows of the table are zeros, ordered by rounding.
    "check_explored": Output(
        "check protocols/demo.yaml --json --compare --sensitivity --tolerance 0.01",
        unordered=(r"json\.sensitivity\.table",),
    ),
    "check_problems": Output("check protocols/demo.yaml --json", prepare=spoil_protocol),
    "new": Output("new study --from threshold --json"),
    "simulate": Output("simulate protocols/demo.yaml -n 1 --seed 3 --observer near_miss --results results --json"),
    "run": Output(f"run protocols/with_catch_trials.yaml -p p03 {SIMULATED} --pilot --results results --json"),
    "run_sensation": Output(f"run protocols/sensation_levels.yaml -p p03 {SIMULATED} --threshold 15 --json"),
    "run_interrupted": Output(f"run demo -p p03 {SIMULATED} --json", interrupt_at="2 of 12 answered"),
    "resume": Output(f"resume {UNFINISHED} --json"),
    "resume_complete": Output(f"resume {COMPLETE} --json"),
    "study": Output("study records --json"),
    "verify": Output(f"verify {COMPLETE} --json"),
    "verify_several": Output("verify records --json", prepare=damage),
    "verify_unfinished": Output(f"verify {UNFINISHED} --json"),
    "verify_forged": Output(f"verify {COMPLETE} --json", prepare=forge),
    "verify_damaged": Output(f"verify {COMPLETE} --json", prepare=damage),
    "doctor": Output("doctor --json", volatile=("status", r"json\.findings\[\]\.(state|found|remedy)")),
    "doctor_record": Output(f"doctor {COMPLETE} --json"),
    "doctor_damaged": Output(f"doctor {COMPLETE} --json", prepare=damage),
    "doctor_recovered": Output(f"doctor {COMPLETE} --into recovered --json", prepare=damage),
    "analyse": Output("analyse records --out analysis --json"),
    "analyse_table": Output("analyse answers.csv --json", prepare=few_answers),
    "analyse_runs": Output("analyse format_1/simulated/threshold --out a --json", prepare=former_records, rel=1e-6),
    "analyse_catches": Output("analyse format_1/simulated/with_catch_trials --out a --json", prepare=former_records),
    "prereg": Output("prereg protocols/demo.yaml -n 8 --experiments 20 --json"),
    "power": Output("power protocols/demo.yaml -n 6,10 --experiments 20 --questions a2,d --out plan --json"),
    "power_of_two": Output("power protocols/two_fields.yaml -n 8 --experiments 10 --questions a2,d --null --json"),
    "fit": Output("fit protocols/demo.yaml records --out fitted.yaml --json", rel=1e-4, absolute=1e-4),
    "identify": Output("identify point.npz --out identification --json", prepare=response_file, rel=1e-6),
    "calibrate": Output(
        "calibrate protocols/demo.yaml --out calibration.yaml --json",
        volatile=(r"json\.made", r"json\.made_by"),
        rel=1e-6,
    ),
    "rig_list": Output("rig list --json", volatile=(r"json\.addresses",)),
    "rig_check": Output(
        "rig check simulated --json",
        volatile=(r"json\.address", r"json\.rows\[\]\.answer"),
        by_chance=r"passes [\d.]+ Vpp, which took longest",
        usual="steps through all of these",
    ),
    "usage": Output("check --json", volatile=(r"json\.error",)),
    "option": Output("check demo --jsn --json", volatile=(r"json\.error",)),
    "run_nowhere": Output("run protocols/demo.yaml --json"),
    "run_size": Output("run protocols/demo.yaml -p p01 --size 10x10 --json"),
    "run_answers": Output("run protocols/demo.yaml -p p01 --answers bogus --json", volatile=(r"json\.error",)),
    "simulate_nobody": Output("simulate protocols/demo.yaml -n 0 --json", volatile=(r"json\.error",)),
    "verify_nothing": Output("verify nowhere --json"),
}
"""One or more to each command that takes ``--json`` and needs no window; compare, validate and a scan cost too much."""

REFUSALS: tuple[Refusal, ...] = (
    Refusal("chek demo"),
    Refusal("check"),
    Refusal("check demo --jsn"),
    Refusal("check demo --tolerance 2"),
    Refusal("check two_fields --sensitivity"),
    Refusal("check demmo"),
    Refusal("check nowhere.yaml"),
    Refusal("check protocols"),
    Refusal("check protocols/demo.yaml", spoil_protocol),
    Refusal("check protocols/demo.yaml", overdrive),
    Refusal("check protocols/demo.yaml", break_yaml),
    Refusal("check protocols/threshold.yaml", spoil_apparatus),
    Refusal("check protocols/two_fields.yaml", spoil_texts),
    Refusal("check protocols/demo.yaml --calibration nowhere.yaml"),
    Refusal("check protocols/demo.yaml --calibration protocols/demo.yaml"),
    Refusal("new records"),
    Refusal("new study --from treshold"),
    Refusal(f"run protocols/demo.yaml -p ../x {SIMULATED}"),
    Refusal(f"run protocols/demo.yaml {SIMULATED}"),
    Refusal("run protocols/demo.yaml -p p01"),
    Refusal("run protocols/demo.yaml -p p01 --yes"),
    Refusal("run protocols/demo.yaml -p p01 --size big"),
    Refusal("run protocols/demo.yaml -p p01 --rig TCPIP::127.0.0.1,9::inst0::INSTR --answers simulated"),
    Refusal(f"run protocols/demo.yaml -p p01 {SIMULATED}", spoil_protocol),
    Refusal(f"run protocols/demo.yaml -p p01 {SIMULATED} --results protocols/demo.yaml"),
    Refusal(f"run protocols/demo.yaml -p sim01 -s 1 {SIMULATED} --results records"),
    Refusal(f"run protocols/sensation_levels.yaml -p p01 {SIMULATED}"),
    Refusal(f"run protocols/demo.yaml -p p01 {SIMULATED} --events nowhere/events"),
    Refusal(f"run demo -p p04 {SIMULATED} --results results", interrupt_at="3 of 12 answered"),
    Refusal("resume nowhere"),
    Refusal("resume protocols/demo.yaml"),
    Refusal(f"resume {COMPLETE}", damage),
    Refusal(f"resume {UNFINISHED}", interrupt_at="7 of 12 answered"),
    Refusal("simulate protocols/demo.yaml -n 0"),
    Refusal("simulate protocols/demo.yaml --observer papr"),
    Refusal("simulate protocols/demo.yaml --observer mine.yaml", spoil_observer),
    Refusal("verify nowhere"),
    Refusal(f"verify {COMPLETE}", damage),
    Refusal(f"verify {COMPLETE}", forge),
    Refusal(f"verify {COMPLETE}", rewrite_table),
    Refusal(f"verify {UNFINISHED}", cut),
    Refusal("doctor nowhere"),
    Refusal("doctor --into elsewhere"),
    Refusal(f"doctor {COMPLETE}", damage),
    Refusal(f"doctor {UNFINISHED}", cut),
    Refusal(f"doctor {COMPLETE} --into records", damage),
    Refusal("analyse nowhere"),
    Refusal("analyse protocols"),
    Refusal("analyse records --mode real"),
    Refusal("analyse records --stimulus blunt"),
    Refusal("analyse records --out analysis", damage),
    Refusal("power protocols/demo.yaml --out taken", other_output),
    Refusal("analyse answers.csv", bad_answers),
    Refusal("power protocols/demo.yaml -n 40:6"),
    Refusal("power protocols/demo.yaml --reps 0"),
    Refusal("power protocols/demo.yaml --questions z"),
    Refusal("fit protocols/demo.yaml nowhere"),
    Refusal("fit protocols/two_fields.yaml records"),
    Refusal("calibrate protocols/demo.yaml"),
    Refusal("calibrate protocols/demo.yaml --out protocols/threshold.yaml"),
    Refusal("identify nothing.csv"),
    Refusal("identify --points 15"),
    Refusal("fingers probe protocols/under_the_finger.yaml"),
    Refusal("validate protocols/demo.yaml --points 15"),
    Refusal("compare protocols/demo.yaml --averages 1"),
    Refusal("rig check TCPIP::127.0.0.1,9::inst0::INSTR"),
    Refusal("rig check nonsense"),
    Refusal("rig chek"),
)
"""Words that are wrong, files that are, records that are, and what is interrupted."""

MISPLACED = (spoil_protocol, overdrive, break_yaml, spoil_apparatus, spoil_texts, spoil_observer, bad_answers)
"""Faults in files, each of which is told with file, line and column."""
