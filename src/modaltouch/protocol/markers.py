"""The section ``markers``: what other devices are told while a session runs."""

from __future__ import annotations

from modaltouch.protocol.section import Section, described


class MarkersSection(Section):
    """What other devices are told while a session runs."""

    lsl: bool = described(
        "Whether each stimulus, question and answer is sent as a marker of the Lab Streaming Layer, in the stream "
        "`modaltouch` of type Markers; needs the extra `lsl`.",
        default=False,
    )
