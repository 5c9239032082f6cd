"""Measurement of the fingers at each placement and design of the stimulus for them.

The procedure is the same for every pair of zones, so that it gives no cue.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from modaltouch.preflight import Preflight, delivered_figures, has_drifted, with_measured
from modaltouch.protocol import Trial
from modaltouch.record import SessionLog
from modaltouch.rig import Rig, RigError
from modaltouch.system import Clock
from modaltouch.window import AnswerWindow

if TYPE_CHECKING:
    from modaltouch.lab import Prober

ATTEMPTS = 3
"""Maximum number of attempts at a measurement."""

STILL = 1.0
"""Time between resting the hands and a measurement [s]."""

GAP = 2.0
"""Minimum time from a measurement to the first burst [s]."""


class Probing:
    """Measurement of the fingers in a session, with design and upload of the stimulus for them.

    Parameters
    ----------
    preflight : Preflight
        The experiment, designed for the expected fingers.
    prober : Prober
        Measures the fingers.
    rig, window, log, clock
        Those of the session.

    Attributes
    ----------
    preflight : Preflight
        The experiment, designed for the fingers measured at the latest placement.
    busy : float
        Time taken to evaluate the latest recorded burst, deducted from the pause after its trial [s].
    """

    busy = 0.0

    def __init__(
        self, preflight: Preflight, prober: Prober, rig: Rig, window: AnswerWindow, log: SessionLog, clock: Clock
    ) -> None:
        self.preflight = self._expected = preflight
        self._prober, self._rig, self._window, self._log, self._clock = prober, rig, window, log, clock
        self._settings = {"speed_mm_s": prober.speed * 1e3, "laser_mm": prober.laser * 1e3}
        self._block: int | None = None
        self._loaded: list[str] = []
        self._heard: dict[str, Any] = {}

    def which(self, trial: Trial) -> int:
        """Return the index of the loaded burst for a trial."""
        return self._loaded.index(self.preflight.design_of(trial.condition))

    def lift_hands(self, trial: Trial) -> None:
        """Measure the untouched beam, once per block and sitting.

        Raises
        ------
        RigError
            If the rig fails, or no measurement is reliable.
        """
        if trial.block == self._block:
            return
        self._window.announce("hands_off")
        self._log.append("hands_off", before_trial=trial.index)
        found = self._measured("the untouched beam", self._prober.hands_off, "hands_off")
        self._log.append("probe", hands="off", **self._settings, **found)
        self._block = trial.block

    def measure(self, trial: Trial, progress: tuple[int, int]) -> None:
        """Measure the fingers on the beam, and load the stimulus designed for them.

        Raises
        ------
        RigError
            If the rig fails, or no measurement is reliable.
        """
        condition, placements = trial.condition, self._expected.findings.placements
        if placements is None:
            return
        expected = placements.expected(condition.finger_condition, condition.zones, condition.placement)

        def hands_on() -> dict[str, Any]:
            self._window.settle(trial, progress)
            return self._prober.hands_on(expected)

        found = self._measured("the fingers", hands_on, "measure_again")
        ended = self._clock.now()
        self.preflight = preflight = with_measured(self._expected, trial, found)
        place = preflight.findings.placement(condition)
        designs = {" ".join(filter(None, (name, place))): part.placed[place] for name, part in preflight.parts.items()}
        self._loaded = list(designs)
        self._rig.load(*(design.stimulus.burst for design in designs.values()))
        levels = [
            {
                "design": name,
                "content_hash": design.stimulus.burst.content_hash,
                **self._prober.predict(*design.sound),
                "attainable_mm_s": design.attainable,
            }
            for name, design in designs.items()
        ]
        self._log.append("probe", hands="on", trial=trial.as_dict(), **self._settings, **found, levels=levels)
        self._window.show_measuring(max(GAP - (self._clock.now() - ended), 0.0))

    def listen(self, trial: Trial) -> None:
        """Arm the vibrometer for the first burst of a trial, except a catch trial."""
        condition, self.busy, self._heard = trial.condition, 0.0, {}
        if condition.is_catch:
            return
        try:
            inputs, stimulus = self.preflight.designs[self.preflight.design_of(condition)].sound
            self._prober.arm(inputs, stimulus, self.preflight.played(condition, condition.velocity_mm_s))
            self._heard = {"delivered": {}}
        except RigError as error:
            self._heard = {"delivered": {"refused": str(error)}}

    def delivered(self, trial: Trial) -> dict[str, Any]:
        """Return the speeds delivered to the fingers by the recorded burst, with their 95 % intervals.

        Fingers that have drifted are measured again at the next placement only. A scope fault does not end the session.
        """
        if self._heard != {"delivered": {}}:
            return self._heard
        began = self._clock.now()
        try:
            found = self._prober.delivered()
            widths, speeds = (
                found.pop("half_width_mm_s"),
                dict[str, Any](delivered_figures(self.preflight, trial, found)),
            )
            for side, zone in zip(trial.condition.sides, trial.condition.zones, strict=True):
                speed = speeds[f"speed_{side}_mm_s"]
                speeds[f"interval_{side}_mm_s"] = [round(speed + sign * widths[zone], 3) for sign in (-1, 1)]
            return {"delivered": {**speeds, "drifted": has_drifted(self.preflight, trial, speeds), **found}}
        except (ValueError, RigError) as error:
            return {"delivered": {"refused": str(error)}}
        finally:
            self.busy = self._clock.now() - began

    def _measured(self, what: str, measure: Callable[[], dict[str, Any]], once_more: str) -> dict[str, Any]:
        """Return a measurement; if it is rejected, ask the participant and try again."""
        for attempt in range(1, ATTEMPTS + 1):
            self._window.show_measuring(STILL)
            try:
                return measure()
            except ValueError as error:
                self._log.append("probe_refused", attempt=attempt, reason=str(error))
                refused = error
                if attempt < ATTEMPTS:
                    self._window.announce(once_more)
        raise RigError(
            f"{what} could not be measured, {ATTEMPTS} times in a row ({refused}); the outputs are off; continue with "
            "`modaltouch resume`, or write `stimulus.fingers: typical` in a protocol of another name"
        ) from refused
