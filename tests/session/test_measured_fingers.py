"""Sessions that measure the fingers at each placement: presented, recorded, verified, resumed, refused."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from modaltouch import analyse
from modaltouch.lab import Prober
from modaltouch.preflight import Preflight, delivered_figures, examine, has_drifted, with_measured
from modaltouch.protocol import Trial
from modaltouch.protocol.source import Source
from modaltouch.record.audit import audit_session
from modaltouch.record.chain import GENESIS, encode_line, read_chain
from modaltouch.record.session import Session
from modaltouch.rig import RigError, Simulator
from modaltouch.session import survey_results
from modaltouch.session.resumption import resume, wire_resume
from modaltouch.session.setup import begin
from modaltouch.session.wiring import simulate_session, wire_run

LEVEL = 60
"""More than the amplifier allows under some fingers on A and C [mm/s]."""


def protocol_in(folder: Path, **changes: Any) -> Path:
    """Return a protocol of one hand on three pairs, for a beam with even modes."""
    yaml, shipped = YAML(), Source.find("protocol", "under_the_finger").path
    apparatus = yaml.load(Source.find("apparatus", "beam_100x6x2").path.read_text(encoding="utf-8"))
    unlisted = apparatus["twin"].pop("unlisted_modes")
    apparatus["modes"] += [mode for mode in unlisted if mode.get("family") != "torsion"]
    apparatus["twin"]["unlisted_modes"] = [mode for mode in unlisted if mode.get("family") == "torsion"]
    yaml.dump(apparatus, folder / "beam.yaml")
    values = yaml.load(shipped.read_text(encoding="utf-8"))
    values |= {"apparatus": "beam.yaml", "texts": str(shipped.parent / "texts" / "english.yaml")}
    values["stimulus"]["fingers"] = "measured"
    values["conditions"] |= {"finger_conditions": ["one_hand"], "peak_velocities_mm_s": [LEVEL]}
    values["schedule"] |= {"practice_trials": 0, "max_same_pair_running": None}
    for section, own in changes.items():
        values[section] |= own
    yaml.dump(values, folder / "protocol.yaml")
    return folder / "protocol.yaml"


@pytest.fixture(scope="module")
def preflight(tmp_path_factory: pytest.TempPathFactory) -> Preflight:
    """The protocol with one trial per pair, examined."""
    return examine(protocol_in(tmp_path_factory.mktemp("measured"))).require()


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, preflight: Preflight) -> Session:
    """A session of it, with the bursts really played by the twin in `played.jsonl`."""
    results = tmp_path_factory.mktemp("results")
    began = Simulator.__init__

    def tell(self: Simulator, *given: Any, **named: Any) -> None:
        began(self, *given, **named, played=results / "played.jsonl")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Simulator, "__init__", tell)
        return begin(wire_run(preflight, "p04", answers="simulated", results=results))


def events(session: Session, name: str) -> list[dict[str, Any]]:
    """Return the events of a name."""
    return [event for event in session.events if event["event"] == name]


def placements(session: Session) -> list[dict[str, Any]]:
    """Return the measurements with hands on."""
    return [event for event in events(session, "probe") if event["hands"] == "on"]


def test_the_level_is_that_under_the_fingers(session: Session) -> None:
    """The speed at each finger of the twin in the first burst is within 0.5 % of the recorded prediction."""
    lines = (session.path.parents[5] / "played.jsonl").read_text(encoding="utf-8").splitlines()
    bursts = [json.loads(line) for line in lines]
    assert len(session.trials) == len(placements(session)) == 3
    for event in session.trials:
        onset = event["confirmed"]["onset"]
        felt = min(bursts, key=lambda burst: abs(burst["start_s"] - onset))["finger_peak_mm_s"]
        condition, planned = event["trial"]["condition"], event["planned"]
        speeds = felt[condition["zone_left"]], felt[condition["zone_right"]]
        assert speeds == pytest.approx((planned["speed_left_mm_s"], planned["speed_right_mm_s"]), rel=0.005)


def test_the_record_has_the_delivered_speeds(session: Session) -> None:
    """The true speed at each finger is within twice the 95 % interval, which is a few per cent wide."""
    lines = (session.path.parents[5] / "played.jsonl").read_text(encoding="utf-8").splitlines()
    bursts = [json.loads(line) for line in lines]
    for event in session.trials:
        onset = event["confirmed"]["onset"]
        felt = min(bursts, key=lambda burst: abs(burst["start_s"] - onset))["finger_peak_mm_s"]
        condition, delivered = event["trial"]["condition"], event["delivered"]
        for side in ("left", "right"):
            speed, (low, high) = delivered[f"speed_{side}_mm_s"], delivered[f"interval_{side}_mm_s"]
            assert abs(felt[condition[f"zone_{side}"]] - speed) < high - low < 0.06 * speed
            assert speed == round(speed, 3), "to a thousandth of a mm/s"
            assert (low + high) / 2 == pytest.approx(speed, abs=1.5e-3)
        assert not delivered["drifted"]
        assert 0.5 < delivered["misfit"] < 2


def test_drifted_fingers_are_marked(session: Session, preflight: Preflight) -> None:
    """If the whole interval is over 5 % off the prediction, as with 1.5 times the mass."""
    probe, event = placements(session)[0], session.trials[0]
    trial = Trial.from_dict(event["trial"])
    placed, found = with_measured(preflight, trial, probe), event["delivered"]
    heavier = {name: {**own, "mass_g": 1.5 * own["mass_g"]} for name, own in found["fingers"].items()}
    as_found = delivered_figures(placed, trial, found)
    assert as_found == {name: found[name] for name in as_found}
    loaded = delivered_figures(placed, trial, {**found, "fingers": heavier})
    assert max(abs(loaded[name] / speed - 1) for name, speed in as_found.items()) > 0.05
    speed = event["planned"]["speed_left_mm_s"]
    for low, high, is_off in ((1.06, 1.08, True), (1.03, 1.09, False), (0.92, 0.94, True), (0.92, 0.96, False)):
        left = {"interval_left_mm_s": [low * speed, high * speed]}
        assert has_drifted(placed, trial, found | left) is is_off


def test_levels_may_be_defined_by_delivered_speeds(session: Session, tmp_path: Path) -> None:
    """By the faster finger, averaged over the level's trials; the report shows them beside the nominal levels."""
    analysis = analyse(session.path, tmp_path, speed="delivered")
    faster = [max(event["delivered"][f"speed_{side}_mm_s"] for side in ("left", "right")) for event in session.trials]
    assert analysis.answers.levels == pytest.approx([sum(faster) / 3], abs=1e-3)
    assert analysis.answers.scale.quantity == "delivered peak speed under the faster finger [mm/s]"
    assert "speeds delivered under the faster finger" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_the_level_is_met_if_attainable(session: Session, preflight: Preflight) -> None:
    """60 mm/s at C if the design for these fingers attains them, else what it attains."""
    played = {}
    for measured, event in zip(placements(session), session.trials, strict=True):
        (level,) = measured["levels"]
        assert level["level_mm_s"] == pytest.approx(LEVEL, rel=1e-4)
        low, high = level["interval_mm_s"]
        assert low < LEVEL < high < low * 1.02
        zones, planned = event["trial"]["condition"], event["planned"]
        sides = {zones[f"zone_{side}"]: planned[f"speed_{side}_mm_s"] for side in ("left", "right")}
        played[level["design"]] = min(LEVEL, level["attainable_mm_s"])
        trial = Trial.from_dict(event["trial"])
        drive = with_measured(preflight, trial, measured).played(trial.condition, LEVEL)
        assert drive == pytest.approx(played[level["design"]], rel=1e-3)
        # The highest speed of all may come at another time than the focus.
        assert sides.get("C", math.inf) > played[level["design"]] * 0.999
    assert played["A-C"] < LEVEL == played["B-D"]


def test_the_record_has_the_measured_fingers(session: Session) -> None:
    """Hands off once per block; each finger with its zone, covariance, misfit, speed and laser position."""
    told = [event["event"] for event in session.events if event["event"] in ("hands_off", "placement", "probe")]
    assert told[:4] == ["hands_off", "probe", "placement", "probe"]
    assert len(events(session, "hands_off")) == 1
    for measured in placements(session):
        condition = measured["trial"]["condition"]
        zones = [finger["zone"] for finger in measured["fingers"].values()]
        assert zones == [condition["zone_left"], condition["zone_right"]]
        assert list(measured["fingers"]) == ["right index", "right middle"]
        assert len(measured["covariance"]) >= 8
        assert 0.5 < measured["misfit"] < 5
        assert (measured["speed_mm_s"], measured["laser_mm"]) == (15, 49)
    offsets = [finger["offset_mm"] for measured in placements(session) for finger in measured["fingers"].values()]
    assert max(map(abs, offsets)) > 0.5


def test_the_measurement_is_no_cue(session: Session) -> None:
    """It is the same at every placement, and ends two seconds before the first burst."""
    for measured in placements(session):
        burst = next(event for event in session.events[measured["n"] :] if event["event"] == "fired")
        assert burst["confirmed"]["onset"] - measured["clock"] > 1.9


def test_every_drive_is_recomputed(session: Session) -> None:
    """Codes, amplitudes and speeds, from the recorded fingers."""
    audit = audit_session(Session.find(session.path))
    assert audit.problems == ()
    assert f"drives for the fingers of {len(placements(session))} placements recomputed: identical codes" in audit.lines


def forged(session: Session, tmp_path: Path, lie: Callable[[list[dict[str, Any]]], object]) -> tuple[str, ...]:
    """Return what the audit finds in a copy with a lie, where every check of the log was made to fit."""
    copied = Path(shutil.copytree(session.path.parents[5], tmp_path / "copy"))
    log = copied / session.path.relative_to(session.path.parents[5])
    told = list(read_chain(log).events)
    lie(told)
    check, lines = GENESIS, []
    for event in told:
        line, check = encode_line(event, check)
        lines.append(line)
    log.write_bytes(b"".join(lines))
    return audit_session(Session.find(log)).problems


def test_other_levels_in_the_record_are_noticed(session: Session, tmp_path: Path) -> None:
    """That of the design and the highest that it attains, each by itself, and fingers that are said to have drifted."""

    def lie(told: list[dict[str, Any]]) -> None:
        first, second, _ = (
            event["levels"][0] for event in told if event["event"] == "probe" and event["hands"] == "on"
        )
        first["level_mm_s"] += 0.01
        second["attainable_mm_s"] += 0.01
        next(event for event in told if event["event"] == "trial")["delivered"]["drifted"] = True

    problems = forged(session, tmp_path, lie)
    for place in [each["levels"][0]["design"] for each in placements(session)][:2]:
        assert any(f"under the fingers that were measured ({place}) the level is " in each for each in problems)
    assert any("give a delivered drifted of False, not True" in each for each in problems)
    (found,) = survey_results(tmp_path / "copy")
    assert [row["excluded"] for row in found["sessions"]] == [f"damaged: {problems[0]}"], "as the analysis, and verify"


def test_other_fingers_in_the_record_are_noticed(session: Session, tmp_path: Path) -> None:
    """In its measurement, and in what a burst delivered."""

    def lie(told: list[dict[str, Any]]) -> None:
        for event in told:
            if event["event"] == "probe" and event["hands"] == "on":
                event["fingers"]["right index"]["mass_g"] *= 1.01
            if event["event"] == "trial":
                event["delivered"]["fingers"]["right index"]["mass_g"] *= 1.1

    problems = forged(session, tmp_path, lie)
    assert any(
        "the drive for the fingers that were measured (A-C) is not the one recorded" in each for each in problems
    )
    assert any("Vpp were commanded" in each for each in problems)
    assert any("the fingers found in its burst give a delivered speed_left_mm_s of" in each for each in problems)


def test_a_resumed_session_measures_again(session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Interrupted before its last answer: hands off again, the fingers measured again, a valid record.

    A scope that fails then is recorded and does not end the session.
    """

    def lost(self: Prober, *_: Any) -> None:
        raise RigError("the PicoScope refuses RunBlock")

    monkeypatch.setattr(Prober, "arm", lost)
    copied = Path(shutil.copytree(session.path.parents[5], tmp_path / "copy"))
    log = copied / session.path.relative_to(session.path.parents[5])
    log.write_bytes(b"".join(log.read_bytes().splitlines(keepends=True)[: session.trials[-2]["n"]]))
    for view in log.parent.glob("*_beh.*"):
        view.unlink()
    done = resume(wire_resume(log))
    assert done.complete
    assert len(events(done, "hands_off")) == 2
    assert done.trials[-1]["delivered"] == {"refused": "the PicoScope refuses RunBlock"}
    assert audit_session(Session.find(done.path)).problems == ()


def test_refused_measurements_end_the_session(
    preflight: Preflight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After three attempts, each recorded with its cause; the session can be resumed."""

    def moved(self: Prober) -> dict[str, Any]:
        raise ValueError("something moved; keep the fingers still")

    monkeypatch.setattr(Prober, "hands_off", moved)
    with pytest.raises(
        RigError,
        match=r"the untouched beam could not be measured, 3 times in a row \(something moved.*`modaltouch resume`",
    ):
        simulate_session(preflight, "p02", tmp_path)
    (log,) = tmp_path.rglob("session.jsonl")
    told = Session.find(log)
    assert [event["reason"] for event in events(told, "probe_refused")] == [
        "something moved; keep the fingers still"
    ] * 3
    assert told.events[-1]["reason"] == "rig fault"


@pytest.mark.parametrize(
    ("without", "words"),
    [
        ("acquisition", "measured, but the apparatus has no section acquisition"),
        ("even modes", "measured, but the table lacks modes 2, 4, "),
    ],
)
def test_check_refuses_measured_fingers_without_the_means(tmp_path: Path, without: str, words: str) -> None:
    """At the key, with `fingers: typical` as the remedy."""
    protocol, yaml = protocol_in(tmp_path), YAML()
    apparatus = yaml.load((tmp_path / "beam.yaml").read_text(encoding="utf-8"))
    if without == "acquisition":
        del apparatus["acquisition"]
    else:
        apparatus["modes"] = [mode for mode in apparatus["modes"] if mode["label"] % 2]
    yaml.dump(apparatus, tmp_path / "beam.yaml")
    (problem,) = examine(protocol).problems
    assert problem.path == "stimulus.fingers"
    assert words in problem.given
    assert "write `fingers: typical`" in problem.remedy
