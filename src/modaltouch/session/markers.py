"""Lab Streaming Layer markers of the stimulus, question and answer of each trial, for other devices."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from modaltouch.protocol import Trial
from modaltouch.system import Clock

_OWN_SETTINGS = ("lsl_api.cfg", "~/lsl_api/lsl_api.cfg", "/etc/lsl_api/lsl_api.cfg")
"""Paths where liblsl looks for local settings."""


class Markers:
    """An outlet of text markers, time-stamped by the LSL clock.

    Parameters
    ----------
    source : str
        Identifier of the stream, such as ``demo/p01/1``.
    clock : Clock
        Clock of the session.

    Raises
    ------
    ImportError, RuntimeError
        If pylsl or its library is not installed.
    """

    def __init__(self, source: str, clock: Clock) -> None:
        import pylsl
        from pylsl.lib import lib

        if not any(Path(place).expanduser().is_file() for place in (os.environ.get("LSLAPICFG", ""), *_OWN_SETTINGS)):
            # Keep liblsl from printing log messages to the console.
            lib.lsl_set_config_content(b"[log]\nlevel = -1\n")
        about = pylsl.StreamInfo("modaltouch", "Markers", 1, pylsl.IRREGULAR_RATE, "string", source)
        self._outlet = pylsl.StreamOutlet(about)
        self._source, self._library = source, pylsl.library_version()
        # Both clocks count from the boot of the machine at the same rate, so their difference is constant.
        self._offset = pylsl.local_clock() - clock.now()

    def describe(self) -> dict[str, Any]:
        """Return name and source of the stream, and the offset of its clock from the session's [s]."""
        stream = {"name": "modaltouch", "source_id": self._source, "clock_offset_s": round(self._offset, 6)}
        return {"lsl": {**stream, "library": self._library}}

    def send_question(self, trial: Trial, instant: float) -> None:
        """Send the marker of a trial's question at an instant [s]."""
        self._send("question", trial.as_dict(), instant)

    def follow(self, event: dict[str, Any]) -> None:
        """Send the markers for the stimulus, questions and answers in a log event, or for an interrupted trial."""
        if event["event"] == "fired":
            interval = f"interval_{event['interval']}" if "interval" in event else ""
            self._send("stimulus", event["trial"], event["confirmed"]["onset"], interval)
        elif event["event"] == "answered":
            instant = event["instants"]["answer"]
            middle = (instant["earliest_s"] + instant["latest_s"]) / 2
            self._send("answer", event["trial"], middle, _say(event["response"]))
        elif event["event"] == "trial":
            for name, further in event["response"].get("further", {}).items():
                if (after := further["question_after"]) is not None:
                    asked = event["confirmed"]["onset"] + after
                    self._send("question", event["trial"], asked, name)
                    self._send("answer", event["trial"], asked + further["reaction_time"], f"{name}/{_say(further)}")
        elif event["event"] == "trial_cut":
            self._send("cut", event["trial"], event["clock"])

    def _send(self, event: str, trial: dict[str, Any], instant: float, detail: str = "") -> None:
        """Send a marker such as ``answer/5/one_hand/AC/100/left``, at an instant of the session's clock [s]."""
        condition, practice = trial["condition"], "practice" if trial["practice"] else ""
        zones = condition["zone_left"] + condition.get("zone_between", "") + condition["zone_right"]
        level = f"{condition['velocity_mm_s']:g}"
        words = (event, practice, str(trial["index"]), condition["finger_condition"], zones, level, detail)
        self._outlet.push_sample(["/".join(filter(None, words))], instant + self._offset)


def _say(response: dict[str, Any]) -> str:
    """Return the text of an answer, or its number on a scale."""
    return f"{response['value']:g}" if "value" in response else str(response["answer"])
