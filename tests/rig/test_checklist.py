"""The checklist with instruments that differ in behaviour that no manual specifies."""

from __future__ import annotations

import json
import re
import threading
from typing import Any

import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig import checklist
from modaltouch.rig.checklist import check_rig
from modaltouch.rig.connection import Patience
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.common import Behaviour

PATIENCE = Patience(reply=0.3, copy=1.0, tries=2, pause=0.02)


@pytest.fixture(scope="module")
def usual(apparatus: Apparatus) -> list[dict[str, Any]]:
    """Return the rows for an instrument that behaves as assumed."""
    with Simulator(apparatus) as simulator:
        rows = check_rig(simulator.address, apparatus, patience=PATIENCE)
        assert simulator.outputs == (False, False)
        assert simulator.front_panel("DATA:CAT?") == '"EMEM"'
        return rows


@pytest.fixture(scope="module")
def odd(apparatus: Apparatus) -> list[dict[str, Any]]:
    """Return the rows for an instrument that differs wherever it can."""
    with Simulator(apparatus, behaviour=Behaviour(timer_digits=4, limit_violation="clip")) as simulator:
        simulator.faults.inject("slow_command", when="COPY USER4,EMEM;", value=0.2)
        simulator.front_panel("DATA:COPY USER4,EMEM")
        rows = check_rig(simulator.address, apparatus, patience=PATIENCE)
        assert simulator.outputs == (False, False)
        assert simulator.front_panel("DATA:COPY EMEM,USER4;:DATA:POIN? EMEM") == "1000"
        return rows


def test_every_question_is_asked(usual: list[dict[str, Any]]) -> None:
    """All questions for this model, each with an answer and advice."""
    assert [row["number"] for row in usual] == [0, 2, 3, 6, 7, 10, 13]
    assert all(row["question"] and row["answer"] and row["advice"] for row in usual)
    assert [row["number"] for row in usual if row["state"] == "person"] == [6, 10, 13]
    json.dumps(usual)


@pytest.mark.parametrize(
    ("number", "usually", "oddly"),
    [
        (0, "TEKTRONIX,AFG3022B", "TEKTRONIX,AFG3022B"),
        (2, "142.857143 ms set", r"142.9 ms set"),
        (3, r"\d+\.\d ms for 125000 points", r"\d{3,}\.\d ms for 1000 points"),
        (7, "refused with -222.*reads 0.1 Vpp", "cut without an error; the level reads 2 Vpp"),
    ],
)
def test_answers_depend_on_the_instrument(
    usual: list[dict[str, Any]], odd: list[dict[str, Any]], number: int, usually: str, oddly: str
) -> None:
    """Each question that software can answer distinguishes the two instruments."""
    for rows, said in ((usual, usually), (odd, oddly)):
        (row,) = (row for row in rows if row["number"] == number)
        assert re.search(said, row["answer"])


@pytest.mark.parametrize("fault", ["lost_reply", "wrong_reply"])
def test_a_fault_in_one_question_does_not_affect_the_others(apparatus: Apparatus, fault: Any) -> None:
    """Without a numeric reply a question is unanswered; the following ones are asked over a new link."""
    with Simulator(apparatus) as simulator:
        simulator.faults.inject(fault, when=r"^TRIG:TIM\?", value="about 140 ms")
        rows = check_rig(simulator.address, apparatus, patience=PATIENCE)
    assert [row["number"] for row in rows if row["state"] == "unanswered"] == [2]


def test_a_scope_measures_the_trigger_latency(apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch) -> None:
    """The proposed bounds include every latency of the twin, and are wider by no more than one query to the scope."""
    low, high = 4.0, 9.0
    monkeypatch.setattr(checklist, "QUESTIONS", [entry for entry in checklist.QUESTIONS if entry[0] == 13])
    facts = apparatus.model_dump(mode="json")
    facts["twin"]["generator"]["trigger_latency_ms"] = {"low": low, "high": high}
    with Simulator(Apparatus.model_validate(facts)) as simulator:
        (row,) = check_rig(simulator.address, apparatus, patience=PATIENCE, scope=simulator.scope())
    assert row["state"] == "found"
    found = re.search(r"trigger_latency_ms: \{low: ([\d.]+), high: ([\d.]+)\}", row["answer"])
    assert found
    least, most = float(found[1]), float(found[2])
    # The instrument accepts a trigger after it was sent and before the acknowledgement: the low bound holds exactly,
    # and the high one may be below the twin's by the transit time.
    assert low - 0.6 <= least <= low + 1.0
    assert most <= high + 0.6


def test_waits_for_one_cycle_at_each_trigger(apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the words of the table. After a reset it is five, and a trigger within a burst may be ignored."""
    monkeypatch.setattr(checklist, "QUESTIONS", [entry for entry in checklist.QUESTIONS if entry[0] == 13])
    with Simulator(apparatus) as simulator:
        heard: list[bytes] = []
        execute = simulator.server.device.execute
        monkeypatch.setattr(
            simulator.server.device, "execute", lambda message, link: heard.append(message) or execute(message, link)
        )
        check_rig(simulator.address, apparatus, patience=PATIENCE)
    assert any(b"SOUR2:BURS:NCYC 1" in message for message in heard)


def test_amplitudes_are_stepped_within_any_limit(apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to the one that the amplifier bears: 0.6 V behind a gain of 25 are 0.04 V peak to peak, in steps of 10 mV."""
    monkeypatch.setattr(checklist, "QUESTIONS", [entry for entry in checklist.QUESTIONS if entry[0] == 6])
    facts = apparatus.model_dump(mode="json")
    facts["amplifier"]["limit_V"] = 0.6
    low = Apparatus.model_validate(facts)
    with Simulator(low) as simulator:
        (row,) = check_rig(simulator.address, low, patience=PATIENCE)
    assert re.match(r"changes took 0\.04 Vpp [\d.]+ ms$", row["answer"])


def test_an_absent_instrument_is_an_error(apparatus: Apparatus) -> None:
    """The error is the one that every command gives."""
    with pytest.raises(RigError, match="no generator answers"):
        check_rig("TCPIP::127.0.0.1,1::inst0::INSTR", apparatus, patience=PATIENCE)


def test_an_instrument_of_another_model_is_not_switched_off(apparatus: Apparatus) -> None:
    """Its outputs may drive another experiment: neither the check nor its watchdog switches them off."""
    facts = apparatus.model_dump(mode="json")
    facts["generator"]["model"] = "AFG3022C"
    with Simulator(apparatus) as simulator:
        simulator.front_panel("OUTP1 ON;:OUTP2 ON")
        with pytest.raises(RigError, match="says it is .*; no output was switched on; .* name another .*`--apparatus`"):
            check_rig(simulator.address, Apparatus.model_validate(facts), patience=PATIENCE)
        for thread in threading.enumerate():
            if thread.name == "watchdog-reaper":
                thread.join()
        assert simulator.outputs == (True, True)
