"""Markers of a session for other devices (Lab Streaming Layer)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from modaltouch.system import Clock


class Markers:
    """Outlet of Lab Streaming Layer markers of stimulus, question and answer, time-stamped by the LSL clock.

    `source` identifies the stream, such as ``demo/p01/1``. Raises ImportError or RuntimeError without pylsl.
    """

    def __init__(self, source: str, clock: Clock) -> None:
        import pylsl
        from pylsl.lib import lib

        places = os.environ.get("LSLAPICFG", ""), "lsl_api.cfg", "~/lsl_api/lsl_api.cfg", "/etc/lsl_api/lsl_api.cfg"
        if not any(Path(place).expanduser().is_file() for place in places):
            # Without settings of the lab, keep liblsl from printing log messages to the console.
            lib.lsl_set_config_content(b"[log]\nlevel = -1\n")
        about = pylsl.StreamInfo("modaltouch", "Markers", 1, pylsl.IRREGULAR_RATE, "string", source)
        self._outlet = pylsl.StreamOutlet(about)
        self._source, self._library = source, pylsl.library_version()
        # Both clocks count from the boot of the machine at the same rate, so their difference is constant.
        self._offset = pylsl.local_clock() - clock.now()
        self._asked: dict[str, Any] = {}

    def describe(self) -> dict[str, Any]:
        """Return name and source of the stream, and the offset of its clock from the session's [s]."""
        return {
            "lsl": {
                "name": "modaltouch",
                "source_id": self._source,
                "clock_offset_s": round(self._offset, 6),
                "library": self._library,
            }
        }

    def send_question(self, instant: float) -> None:
        """Send the marker of the question on the latest stimulus at an instant [s]."""
        self._send("question", self._asked, instant)

    def follow(self, event: dict[str, Any]) -> None:
        """Send the markers for the stimulus, questions and answers in a log event, or for an interrupted trial."""
        match event["event"]:
            case "fired":
                # The window asks about the interval it presented last, which may be the standard.
                self._asked = event["trial"]
                interval = f"interval_{event['interval']}" if "interval" in event else ""
                self._send("stimulus", event["trial"], event["confirmed"]["onset"], interval)
            case "answered":
                instant = event["instants"]["answer"]
                middle = (instant["earliest_s"] + instant["latest_s"]) / 2
                self._send("answer", event["trial"], middle, _say(event["response"]))
            case "trial":
                # Questions are timed from the onset of the last interval; the line itself describes the comparison.
                onset = (event.get("intervals") or [event])[-1]["confirmed"]["onset"]
                for name, further in event["response"].get("further", {}).items():
                    if (after := further["question_after"]) is not None:
                        asked, answer = onset + after, f"{name}/{_say(further)}"
                        self._send("question", event["trial"], asked, name)
                        self._send("answer", event["trial"], asked + further["reaction_time"], answer)
            case "trial_cut":
                self._send("cut", event["trial"], event["clock"])

    def _send(self, event: str, trial: dict[str, Any], instant: float, detail: str = "") -> None:
        """Send a marker such as ``answer/5/one_hand/AC/100/left``, at an instant of the session's clock [s]."""
        condition, practice = trial["condition"], "practice" if trial["practice"] else ""
        zones = condition["zone_left"] + condition.get("zone_between", "") + condition["zone_right"]
        level = f"{condition['velocity_mm_s']:g}"
        words = (event, practice, str(trial["index"]), condition["finger_condition"], zones, level, detail)
        self._outlet.push_sample(["/".join(filter(None, words))], instant + self._offset)


def _say(response: dict[str, Any]) -> str:
    return f"{response['value']:.10g}" if "value" in response else str(response["answer"])
