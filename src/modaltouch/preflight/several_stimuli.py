"""Several stimuli in one protocol: each looked at as if it were alone, and all of them in the generator's memories."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from modaltouch.protocol import (
    Findings,
    Problem,
    calibration_alone,
    check_calibration,
    check_fit,
    check_protocol,
    in_calibration,
)
from modaltouch.stimulus import Burst

MEMORIES = 4
"""Records that an AFG3022B holds."""


def each_stimulus(findings: Findings) -> Iterator[tuple[str, Findings]]:
    """Yield the name of each stimulus, and the files as if it were the only one, with what is then wrong."""
    protocol, apparatus = findings.protocol, findings.apparatus
    if protocol is None or protocol.value is None or apparatus is None:
        return
    for name, variant in protocol.value.stimuli.items():
        value = protocol.value.with_stimulus(name)
        # The order is drawn and checked for all of them together.
        eased = value.schedule.model_copy(update={"catch_trials": 0, "max_same_pair_running": None})
        alone = replace(protocol, value=value.model_copy(update={"schedule": eased}))
        problems = [*check_protocol(alone), *check_fit(alone, apparatus)]
        if variant.field is not None and variant.field.file is not None:
            path, remedy = ("stimuli", name, "field", "file"), "write the points themselves"
            problems.append(protocol.problem(path, "a file of one of several stimuli", "points", remedy))
        calibration = findings.calibration
        if calibration is not None:
            calibration = calibration_alone(calibration, name)
            problems += check_calibration(calibration, alone, apparatus)
        yield name, replace(findings, protocol=alone, problems=tuple(problems), calibration=calibration)


def at_stimulus(findings: Findings, name: str, problems: Iterable[Problem]) -> Iterator[Problem]:
    """Yield the problems of a stimulus at its own key where it has one, and named after it elsewhere.

    Parameters
    ----------
    findings : Findings
        The files.
    name : str
        The stimulus.
    problems : iterable of Problem
        What is wrong with it.
    """
    reading, calibration = findings.protocol, findings.calibration
    named_alike = problems if calibration is None else in_calibration(calibration, name, problems)
    for problem in named_alike:
        section, _, key = problem.path.partition(".")
        path = ("stimuli", name, key.split(".")[0].split("[")[0])
        named = replace(problem, given=f"{problem.given} (stimulus {name})")
        if section == "stimulus" and reading is not None and reading.find(path) is not None:
            yield reading.problem(path, named.given, problem.allowed, problem.remedy)
        else:
            yield named


def check_memories(findings: Findings, bursts: Sequence[Burst]) -> Iterator[Problem]:
    """Yield more records than the generator has memories."""
    reading = findings.protocol
    if reading is None:
        return
    n_records = len({record.tobytes() for burst in bursts for record in burst.codes})
    if n_records > MEMORIES:
        given = f"{len(bursts)} stimuli with {n_records} different records"
        allowed = f"at most {MEMORIES}, as many as the generator has memories: two stimuli on two outputs"
        yield reading.problem(("stimuli",), given, allowed, "take fewer, or make protocols of them")
