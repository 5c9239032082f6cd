"""A session of a simulated participant on the simulated rig, through the same code as a person's."""

from __future__ import annotations

from pathlib import Path

from modaltouch.planning import Observer
from modaltouch.preflight import Preflight, examine
from modaltouch.record import Session
from modaltouch.session.setup import begin
from modaltouch.session.wiring import wire_run


def simulate_session(
    protocol: Path | str | Preflight,
    participant: str,
    results: Path | str = "results",
    *,
    seed: int = 1,
    observer: Observer | None = None,
) -> Session:
    """Return a session as it was recorded, answered by an observer model.

    Parameters
    ----------
    protocol : Path, str or Preflight
        The protocol's file, the name of a shipped one, or its preflight where several sessions share it.
    participant : str
        Participant id.
    results : Path or str
        Folder of results; the session is recorded in its simulated tree.
    seed : int
        Of the study.
    observer : Observer, optional
        Population from which the participant is drawn.

    Raises
    ------
    InputError
        With every fault of the protocol.
    RecordError
        If the session exists already, or cannot be written.
    """
    preflight = protocol if isinstance(protocol, Preflight) else examine(protocol)
    setup = wire_run(
        preflight.require(), participant, answers="simulated", seed=seed, results=Path(results), observer=observer
    )
    return begin(setup)
