"""Section ``people``: questions asked once of each participant, before the first session, and their answers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError, create_model, model_validator

from modaltouch.protocol.reading import Reading
from modaltouch.protocol.section import Number, Section, Text, described
from modaltouch.protocol.source import Problem, fault


class PersonField(Section):
    """One question about the participant; its key is the column of participants.tsv."""

    kind: Literal["number", "choice", "text", "consent"] = described(
        "number; choice: one of the choices; text: some words; consent: yes or no. Without a yes to a required "
        "consent, the session does not begin and nothing is stored."
    )
    question: Text = described("The question, in the participant's language.")
    choices: tuple[Text, ...] = described(
        "Possible answers, for a choice.", default=(), json_schema_extra={"uniqueItems": True}
    )
    lowest: Number | None = described("Smallest number that is accepted; null for any.", default=None)
    highest: Number | None = described("Largest number that is accepted; null for any.", default=None)
    unit: Text = described("Unit of the number, for the description of its column.", default="")
    required: bool = Field(strict=True, default=True, description="Whether the question must be answered.")
    identifies: bool = Field(
        strict=True, default=False, description="Whether the answer may identify a person: names, addresses, birthdays."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        n_choices, low, high = len(set(self.choices)), self.lowest, self.highest
        if (n_choices < 2 or n_choices < len(self.choices)) if self.kind == "choice" else n_choices:
            raise fault(
                f"{len(self.choices)} choice{'s' * (len(self.choices) != 1)} for a {self.kind}",
                "at least two different choices, and only for `choice`",
                "change the choices or the kind",
            )
        if (low, high) != (None, None) and (
            self.kind != "number" or (low is not None and high is not None and low > high)
        ):
            ends = " to ".join("any" if each is None else f"{each:g}" for each in (low, high))
            raise fault(
                f"bounds for a {self.kind}, {ends}",
                "only for a number, with lowest below highest",
                "change the bounds or the kind",
            )
        return self

    @property
    def answer(self) -> Any:
        """Type of the answers."""
        known: dict[str, Any] = {
            "number": Annotated[float, Field(ge=self.lowest, le=self.highest, allow_inf_nan=False)],
            "choice": Literal[self.choices],
            "text": Annotated[str, Field(min_length=1)],
            "consent": Literal["yes", "no"],
        }
        return known[self.kind] if self.required else known[self.kind] | None

    @property
    def allowed(self) -> str:
        """Description of the allowed answers."""
        from modaltouch.protocol.wording import describe

        return describe(model_of({"answer": self}), ("answer",)).replace("null", "nothing")

    def read(self, words: str) -> float | str | None:
        """Parse a typed answer; None if the question was skipped."""
        given = " ".join(words.split())
        given = given.replace(",", ".") if self.kind == "number" else given
        offered = {"choice": self.choices, "consent": ("yes", "no")}
        meant = next((each for each in offered.get(self.kind, ()) if each.casefold() == given.casefold()), given)
        try:
            answer: float | str | None = TypeAdapter(self.answer).validate_python(meant or None)
        except ValidationError:
            raise ValueError(f"given {given or 'nothing'}; allowed: {self.allowed}") from None
        return answer

    def draw(self, rng: np.random.Generator) -> float | str | None:
        """Draw the answer of a simulated participant, uniform over the allowed answers; consent is always given."""
        if self.kind == "number":
            high = max(65.0, self.lowest or 0.0) if self.highest is None else self.highest
            low = min(18.0, high) if self.lowest is None else self.lowest
            return min(max(round(float(rng.uniform(low, high))), low), high)
        return str(rng.choice({"choice": self.choices, "text": ("simulated",), "consent": ("yes",)}[self.kind]))


def model_of(fields: Mapping[str, PersonField]) -> type[Section]:
    """Return the pydantic model of a file of answers."""
    answers: dict[str, Any] = {name: (each.answer, ... if each.required else None) for name, each in fields.items()}
    return create_model("People", __base__=Section, **answers)


IDENTIFYING = re.compile(
    "(first|last|sur|fore|full|nick)?names?|initials|born|birth.*|dob|e?mail|(tele)?phone|mobile|address|street|postcode|"
    "zip|passport|ssn|matriculation"
)
"""Words in the names of fields that would identify a person."""


def check_people(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield fields that would identify a person, or that have the name of a fixed column of participants.tsv."""
    for name, asked in reading.items("people"):
        if not asked.identifies and any(map(IDENTIFYING.fullmatch, re.split(r"[_-]", name.casefold()))):
            yield reading.problem(
                ("people", name),
                f"{name}, which identifies a person",
                "fields that identify nobody, since data are stored only under a code",
                "leave it out, ask for the age instead of a birthday, or write `identifies: true`",
                at_key=True,
            )
        if name in ("participant_id", "HED"):
            given = f"{name}, to which BIDS gives another meaning"
            yield reading.problem(("people", name), given, "any other name", "choose another", at_key=True)
