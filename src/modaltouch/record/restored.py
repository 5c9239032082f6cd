"""The experiment of a session, restored from the texts of its files in the start record."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Self

from modaltouch.preflight import examine_findings
from modaltouch.protocol import Findings, Protocol, Sources, Trial
from modaltouch.rig import RigError, instrument_of

if TYPE_CHECKING:
    from modaltouch.protocol import Levels

MALFORMED = (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError, RigError)
"""Errors raised by evaluating a line that lacks required members or has wrong ones."""


class RestoredExperiment:
    """The part of an experiment that depends only on the texts of its files, and which all sessions of a study share.

    Parameters
    ----------
    sources : Sources
        The texts.
    occasion : (str, str)
        The group and the kind of session.

    Raises
    ------
    InputError
        With every fault in the texts.
    """

    def __init__(self, sources: Sources, occasion: tuple[str, str]) -> None:
        self.preflight = examine_findings(Findings.restored(sources, occasion)).require()
        self.protocol = self.preflight.experiment.protocol
        apparatus = self.preflight.experiment.apparatus
        self.instrument = instrument_of(apparatus)
        self._limits = self.instrument.limits(apparatus)
        self._fields: dict[tuple[float, ...], list[dict[str, Any]]] = {}
        self._forget()

    def _forget(self) -> None:
        self.agreed: set[tuple[str, float, tuple[float, ...], tuple[float, ...]]] = set()
        """Stimulus, level, and amplitudes commanded and read back, that were found to agree."""
        self._amplitudes: dict[tuple[str, float], tuple[float, ...]] = {}

    def measured(self, trial: Trial, found: dict[str, Any], levels_mm_s: tuple[float, ...]) -> Self:
        """Return a copy in which the stimuli of a trial's placement are designed for the fingers measured there.

        Parameters
        ----------
        trial, found
            As for `modaltouch.preflight.with_measured`.
        levels_mm_s : tuple of float
            The participant's levels [mm/s].
        """
        from modaltouch.preflight import with_measured

        other = copy.copy(self)
        other.preflight = with_measured(self.preflight.with_levels(levels_mm_s), trial, found)
        other._forget()
        return other

    @cached_property
    def levels(self) -> Levels:
        """Computation of the levels of an adaptive run."""
        from modaltouch.protocol import Levels

        return Levels(self.protocol)

    def fields(self, own_levels_mm_s: tuple[float, ...]) -> list[dict[str, Any]]:
        """Return the predicted field of each stimulus at the highest level, of the protocol or of own levels [mm/s]."""
        if own_levels_mm_s not in self._fields:
            own = self.preflight.with_levels(own_levels_mm_s) if own_levels_mm_s else self.preflight
            self._fields[own_levels_mm_s] = own.fields
        return self._fields[own_levels_mm_s]

    def amplitudes(self, trial: Trial, level_mm_s: float) -> tuple[float, ...]:
        """Return the amplitude of each channel for the design of a trial at a level [V peak to peak].

        Parameters
        ----------
        trial : Trial
            The trial; for a catch trial, which has no stimulus, the first one is taken.
        level_mm_s : float
            Peak velocity at the focus [mm/s].

        Raises
        ------
        RigError
            If the level exceeds a limit.
        """
        name = self.preflight.design_of(trial.condition)
        key = name, level_mm_s
        if key not in self._amplitudes:
            burst = self.preflight.designs[name].stimulus.burst
            self._amplitudes[key] = self._limits.amplitudes(burst, level_mm_s * 1e-3)
        return self._amplitudes[key]


@dataclass(frozen=True)
class TrialExpectation:
    """The values against which a trial is checked.

    Attributes
    ----------
    restored : RestoredExperiment
        The experiment restored from the start record.
    protocol : Protocol
        The protocol, with the participant's own levels if there are any.
    schema : int
        Version of the log format.
    """

    restored: RestoredExperiment
    protocol: Protocol
    schema: int


@lru_cache(maxsize=4)
def restore(sources: Sources, occasion: tuple[str, str] = ("", "")) -> RestoredExperiment:
    """Return the experiment restored from its texts; the latest few are cached.

    Raises
    ------
    InputError
        With every fault in the texts.
    """
    return RestoredExperiment(sources, occasion)
