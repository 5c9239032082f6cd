"""The experiment of a record, made again from the texts that its start record keeps."""

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

UNTOLD = (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError, RigError)
"""What a line raises that does not say what is asked of it."""


class RestoredExperiment:
    """What depends on the texts of a record alone: all sessions of a study share it.

    Parameters
    ----------
    sources : Sources
        The texts.
    occasion : (str, str)
        The group and the kind of session.

    Raises
    ------
    InputError
        With every fault of them.
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
        """Stimulus, level, commanded and read back amplitudes that were found to agree."""
        self._amplitudes: dict[tuple[str, float], tuple[float, ...]] = {}

    def measured(self, trial: Trial, found: dict[str, Any], levels_mm_s: tuple[float, ...]) -> Self:
        """Return the same with a trial's placement designed for the fingers that were measured there.

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
        """What decides the levels of an adaptive run."""
        from modaltouch.protocol import Levels

        return Levels(self.protocol)

    def fields(self, own_levels_mm_s: tuple[float, ...]) -> list[dict[str, Any]]:
        """Return the predicted field of each stimulus at the highest level of the protocol, or of own levels [mm/s]."""
        if own_levels_mm_s not in self._fields:
            own = self.preflight.with_levels(own_levels_mm_s) if own_levels_mm_s else self.preflight
            self._fields[own_levels_mm_s] = own.fields
        return self._fields[own_levels_mm_s]

    def amplitudes(self, trial: Trial, level_mm_s: float) -> tuple[float, ...]:
        """Return the amplitude of each channel for the design of a trial at a level [V peak to peak].

        Parameters
        ----------
        trial : Trial
            In a catch trial, which has no stimulus, the first is set.
        level_mm_s : float
            Peak velocity at the focus [mm/s].

        Raises
        ------
        RigError
            If the level is beyond a limit.
        """
        name = self.preflight.design_of(trial.condition)
        key = name, level_mm_s
        if key not in self._amplitudes:
            burst = self.preflight.designs[name].stimulus.burst
            self._amplitudes[key] = self._limits.amplitudes(burst, level_mm_s * 1e-3)
        return self._amplitudes[key]


@dataclass(frozen=True)
class TrialExpectation:
    """What a trial is checked against.

    Attributes
    ----------
    restored : RestoredExperiment
        What the record's texts give.
    protocol : Protocol
        The protocol at the participant's own levels, where there are such.
    schema : int
        Format of the log.
    """

    restored: RestoredExperiment
    protocol: Protocol
    schema: int


@lru_cache(maxsize=4)
def restore(sources: Sources, occasion: tuple[str, str] = ("", "")) -> RestoredExperiment:
    """Return the experiment of a record; that of the latest few is kept.

    Raises
    ------
    InputError
        With every fault of the texts.
    """
    return RestoredExperiment(sources, occasion)
