"""What no manual says of a generator: found out where software can, told to a person where it cannot.

Nothing is played: the outputs are off whenever a burst starts, and the amplitude is the lowest there is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from modaltouch.protocol import Apparatus
from modaltouch.rig.connection import Connection, Patience
from modaltouch.rig.controls import Unconfirmed
from modaltouch.rig.link import Log
from modaltouch.rig.open_questions import QUESTIONS, Finding, QuestionedInstrument, State
from modaltouch.rig.transport import LinkError
from modaltouch.rig.watchdog_client import WatchdogClient


@dataclass(frozen=True)
class Row:
    """One question and what became of it.

    Attributes
    ----------
    number : int
        Of the question; 0 asks whether the instrument takes the driver's settings at all.
    question : str
        What is to be known.
    state : str
        ``found`` by software, for a ``person`` to see, or ``unanswered``.
    answer : str
        What was found.
    advice : str
        What to do, or what it means for a session.
    """

    number: int
    question: str
    state: State
    answer: str
    advice: str

    def as_dict(self) -> dict[str, Any]:
        """Return the row as plain values."""
        return asdict(self)

    def __str__(self) -> str:
        return f"{self.number:2d}  {self.question}\n    {self.answer}\n    -> {self.advice}"


def check_rig(
    address: str,
    apparatus: Apparatus,
    *,
    log: Log = lambda event, **facts: None,
    patience: Patience | None = None,
) -> list[Row]:
    """Return the answers to every open question about the generator at an address.

    Parameters
    ----------
    address : str
        VISA address, of an instrument or of a simulator.
    apparatus : Apparatus
        What is on the table.
    log : callable
        Takes every exchange.
    patience : Patience, optional
        How long to wait.

    Returns
    -------
    list of Row
        In the order of the questions.

    Raises
    ------
    RigError
        If there is no such instrument at the address, or its outputs cannot be switched off afterwards.
    """
    patience = patience or Patience()
    connection = Connection(
        address,
        apparatus,
        guard=WatchdogClient(address),
        log=log,
        patience=patience,
    )
    try:
        connection.open()
        bench = QuestionedInstrument(connection, patience)
        rows = [_ask(bench, *entry) for entry in QUESTIONS]
        connection.switch_off("the check", (), lambda: None)
    except BaseException:
        connection.close(clean=False)
        raise
    connection.close(clean=True)
    return rows


def _ask(
    bench: QuestionedInstrument, number: int, question: str, find: Callable[[QuestionedInstrument], Finding]
) -> Row:
    """Answer one question; whatever it breaks is mended before the next."""
    try:
        return Row(number, question, *find(bench))
    except (LinkError, Unconfirmed) as error:
        bench.connection.restore(f"question {number}", (), lambda: None)
        return Row(number, question, "unanswered", str(error), "ask again; if it stays so, look at the instrument")
