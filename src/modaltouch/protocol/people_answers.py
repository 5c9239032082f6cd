"""Checks of the section ``people`` and of the file that answers its questions; most protocols have neither."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from modaltouch.protocol.people import PersonField, model_of
from modaltouch.protocol.problems import Problem
from modaltouch.protocol.reading import Reading, read
from modaltouch.protocol.source import Source

IDENTIFYING = re.compile(
    "(first|last|sur|fore|full|nick)?names?|initials|born|birth.*|dob|e?mail|(tele)?phone|mobile|address|street|postcode|"
    "zip|passport|ssn|matriculation"
)
"""Words in the names of fields that would identify a person."""


def check_people(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield fields that would identify a person, or that have the name of a fixed column of participants.tsv."""
    for name, asked in reading.items("people"):
        if not asked.identifies and any(map(IDENTIFYING.fullmatch, re.split(r"[_-]", name.casefold()))):
            given, allowed = (
                f"{name}, which identifies a person",
                "fields that identify nobody, since data are stored only under a code",
            )
            remedy = "leave it out, ask for the age instead of a birthday, or write `identifies: true`"
            yield reading.problem(("people", name), given, allowed, remedy, at_key=True)
        if name == "participant_id":
            yield reading.problem(("people", name), f"{name}, which is already a column", "any other name", at_key=True)


def read_people(fields: Mapping[str, PersonField], path: Path) -> dict[str, float | str | None]:
    """Read the answers from a YAML file, one line per field."""
    return read(Source.load(path), model_of(fields)).require().model_dump()
