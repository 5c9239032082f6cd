"""When things happened in a trial, each as the earliest and the latest instant that what was measured allows."""

from __future__ import annotations

Interval = dict[str, float]
"""``earliest_s`` and ``latest_s`` on the session's clock (`time.perf_counter`, the record's ``clock``) [s]."""


def describe_instants(
    *,
    onset: float,
    onset_uncertainty: float,
    answered: float,
    answer_uncertainty: float,
    question: float | None,
    question_uncertainty: float,
    undated: bool = False,
) -> dict[str, Interval | None]:
    """Return the instants of one trial for its record.

    A picture is on the screen between the call that flips it and the call's return; a
    monitor's own latency, which no program can see, comes on top. A press is stamped when it is read, at most one
    poll after it happened.

    Parameters
    ----------
    onset, onset_uncertainty : float
        When the first burst began, and how far from then it can have been, either way [s].
    answered, answer_uncertainty : float
        When the answer was read, and how long it can have waited by then [s].
    question, question_uncertainty : float or None, float
        When the question was on the screen, and how long the flip took [s]; None without a screen.
    undated : bool
        Whether there is no first burst that this program knows of: in a catch trial, and with a wired pulse source.
    """
    return {
        "first_burst": None if undated else _between(onset - onset_uncertainty, onset + onset_uncertainty),
        "question": None if question is None else _between(question - question_uncertainty, question),
        "answer": _between(answered - answer_uncertainty, answered),
    }


def _between(earliest: float, latest: float) -> Interval:
    return {"earliest_s": round(earliest, 6), "latest_s": round(latest, 6)}
