"""The section ``people``: what each participant is asked once, before the first session."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import Field, model_validator

from modaltouch.protocol.problems import InputError, Problem, fault
from modaltouch.protocol.reading import Reading
from modaltouch.protocol.section import Number, Section, Text, described
from modaltouch.protocol.source import Source
from modaltouch.protocol.tree import parse_tree

if TYPE_CHECKING:
    import numpy as np

IDENTIFYING = re.compile(
    "(first|last|sur|fore|full|nick)?names?|initials|born|birth.*|dob|e?mail|(tele)?phone|mobile|address|street|postcode|"
    "zip|passport|ssn|matriculation"
)
"""A word in the name of a field that identifies a person."""


class PersonField(Section):
    """One question about the participant; its key is the column of participants.tsv."""

    kind: Literal["number", "choice", "text", "consent"] = described(
        "number; choice: one of the choices; text: some words; consent: yes or no, and without a yes to one that is "
        "required the session does not begin and nothing is stored."
    )
    question: Text = described("What is asked, in the participant's language.")
    choices: tuple[Text, ...] = described(
        "What may be chosen, of a choice.", default=(), json_schema_extra={"uniqueItems": True}
    )
    lowest: Number | None = described("Smallest number that is taken; null for any.", default=None)
    highest: Number | None = described("Largest number that is taken; null for any.", default=None)
    unit: Text = described("Unit of a number, for the description of its column.", default="")
    required: bool = Field(strict=True, default=True, description="Whether the question must be answered.")
    identifies: bool = Field(
        strict=True, default=False, description="Whether the answer may identify a person: names, addresses, birthdays."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        n_choices, low, high = len(set(self.choices)), self.lowest, self.highest
        if (n_choices < 2 or n_choices < len(self.choices)) if self.kind == "choice" else n_choices:
            given, allowed = f"{len(self.choices)} choices of a {self.kind}", "two or more different ones of a choice"
            raise fault(given, allowed, "change the choices or the kind")
        if (low, high) != (None, None) and (
            self.kind != "number" or (low is not None and high is not None and low > high)
        ):
            given, allowed = f"bounds of a {self.kind}, {low} to {high}", "of a number, lowest below highest"
            raise fault(given, allowed, "change the bounds or the kind")
        return self

    @property
    def allowed(self) -> str:
        """What may be answered, in words."""
        ends = (("at least", self.lowest), ("at most", self.highest))
        bounds = " and ".join(f"{words} {end:g}" for words, end in ends if end is not None)
        said = {
            "number": f"a number {bounds}".strip(),
            "choice": ", ".join(self.choices),
            "text": "some words",
            "consent": "yes, no",
        }
        return said[self.kind] + ("" if self.required else "; or nothing")

    def read(self, words: str) -> float | str | None:
        """Answer that words stand for; None where the question is left out.

        Parameters
        ----------
        words : str
            As they were typed.

        Raises
        ------
        ValueError
            If they are no answer.
        """
        given = " ".join(words.split())
        if self.kind == "number" and re.fullmatch(r"[-+]?\d{1,9}([.,]\d{1,9})?", given):
            value = float(given.replace(",", "."))
            low, high = -math.inf if self.lowest is None else self.lowest, self.highest
            if low <= value <= (math.inf if high is None else high):
                return int(value) if value.is_integer() else value
        elif given and self.kind != "number":
            offered = {"choice": self.choices, "text": (given,), "consent": ("yes", "no")}[self.kind]
            for each in (each for each in offered if each.casefold() == given.casefold()):
                return each
        elif not given and not self.required:
            return None
        raise ValueError(f"given {given or 'nothing'}; allowed: {self.allowed}")

    def draw(self, rng: np.random.Generator) -> float | str | None:
        """Answer of a simulated participant: of what is allowed, each as likely.

        Parameters
        ----------
        rng : numpy.random.Generator
            Draws it.
        """
        if self.kind == "number":
            high = max(65.0, self.lowest or 0.0) if self.highest is None else self.highest
            low = min(18.0, high) if self.lowest is None else self.lowest
            return min(max(round(float(rng.uniform(low, high))), low), high)
        words = {"choice": self.choices, "text": ("simulated",), "consent": ("yes",)}[self.kind]
        return str(rng.choice(words))


def check_people(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield the fields that nobody should be asked, and the one that participants.tsv has anyway."""
    for name, asked in reading.items("people"):
        if not asked.identifies and any(map(IDENTIFYING.fullmatch, re.split(r"[_-]", name.casefold()))):
            given, allowed = f"{name}, which identifies a person", "what does not, as data are kept under a code alone"
            remedy = "leave it out, ask for the age instead of a birthday, or write `identifies: true`"
            yield reading.problem(("people", name), given, allowed, remedy, at_key=True)
        if name == "participant_id":
            yield reading.problem(("people", name), f"{name}, a column of its own", "any other name", at_key=True)


def read_people(fields: Mapping[str, PersonField], path: Path) -> dict[str, float | str | None]:
    """Return the answers in a YAML file, a line to each field.

    Parameters
    ----------
    fields : mapping of str to PersonField
        What is asked.
    path : Path
        The file.

    Raises
    ------
    InputError
        With every fault of the file and its place.
    """
    root, problems = parse_tree(Source.load(path))
    given = {} if root is None or not isinstance(root.content, dict) else root.content
    answers: dict[str, float | str | None] = {}
    for name in dict.fromkeys((*fields, *given)):
        words = given[name].text if name in given and given[name].content is not None else ""
        try:
            answers[name] = fields[name].read(words)
        except (KeyError, ValueError):
            line, column = root.keys.get(name, (1, 1)) if root is not None else (1, 1)
            allowed = fields[name].allowed if name in fields else f"what is asked: {', '.join(fields)}"
            problems.append(Problem(str(path), line, column, name, repr(words) if words else "nothing", allowed))
    if problems:
        raise InputError(problems)
    return answers
