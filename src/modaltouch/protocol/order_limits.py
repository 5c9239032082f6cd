"""Keys that limit the sequence of trials in shuffled orders, and the error raised if no order keeps them."""

from __future__ import annotations

from collections.abc import Sequence

LIMITS = (
    "max_same_pair_running",
    "max_same_level_running",
    "max_same_stimulus_running",
    "max_same_side_running",
    "min_same_cell_distance",
)
"""Keys of the section schedule that limit the sequence of trials in shuffled orders."""


class NoOrderError(ValueError):
    """Raised if no order keeps a limit, or if such orders are too rare to find.

    Parameters
    ----------
    key : str
        Key of the limit in the section schedule.
    given, allowed, remedy : str
        As in `Problem`.
    """

    def __init__(self, key: str, given: str, allowed: str, remedy: str) -> None:
        super().__init__(f"schedule.{key}: given {given}; {allowed or remedy}")
        self.key, self.said = key, (given, allowed, remedy)


def refuse_runs(counts: Sequence[int], limit: int, key: str, n_others: int = 0) -> None:
    """Raise NoOrderError if no order keeps a limit on runs.

    Parameters
    ----------
    counts : sequence of int
        Number of trials of each kind.
    limit : int
        Maximum number of times in a row.
    key : str
        Key of the limit, one of `LIMITS`.
    n_others : int
        Number of trials without a kind, which may be anywhere.
    """
    least = least_limit([*counts, *[1] * n_others])
    if limit < least:
        n_trials, noun = sum(counts) + n_others, key.split("_")[2]
        given = f"{limit}, but {max(counts)} of the {n_trials} trials of a block have the same {noun}"
        raise NoOrderError(key, given, f"at least {least}, or null for no limit", "raise or remove it")


def least_limit(counts: Sequence[int]) -> int:
    """Return the smallest limit on runs that the counts allow.

    The trials of the most frequent kind must fit into the gaps before, between and after all others.

    >>> least_limit([4, 4, 4]), least_limit([12]), least_limit([9, 2])
    (1, 12, 3)
    """
    most = max(counts)
    return -(-most // (sum(counts) - most + 1))
