"""The driver with the simulator: what it sends, what it confirms, and when its outputs are off."""

from __future__ import annotations

import json
import math
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modaltouch.protocol import InputError
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import FingerSection, FingerSpread, Latency
from modaltouch.rig.generator import Generator
from modaltouch.rig.instrument import Setting
from modaltouch.rig.interface import Bursts, RigError
from modaltouch.rig.pacing import HELD_UP, Report
from modaltouch.rig.player import RELAYS_SETTLE
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.session_files import FollowedSession
from modaltouch.stimulus.burst import Burst
from modaltouch.stimulus.fingers import Finger
from modaltouch.system.clock import VirtualClock

LEVELS = (0.08, 0.1, 0.15, 0.2)


def test_outputs_are_off_after_opening(simulator: Simulator, open_generator: Callable[..., Generator]) -> None:
    """Outputs that were left on are switched off when the driver opens the instrument."""
    simulator.front_panel("OUTP1 ON;:OUTP2 ON")
    open_generator()
    assert simulator.outputs == (False, False)


def test_a_firing_is_confirmed_and_moves_the_beam(loaded: Generator, simulator: Simulator) -> None:
    """Outputs are on and the beam moves between fire and stop, and not before or after."""
    assert simulator.felt_velocity(["A", "C"]).tolist() == [0, 0]
    firing = loaded.fire(0.2)
    assert firing.started
    assert not firing.confirmed
    assert firing.confirmed_amplitude == firing.commanded_amplitude == (12.0, 8.0)
    assert simulator.outputs == (True, True)
    assert (simulator.felt_velocity(["A", "C"]) > 0).all()
    loaded.stop()
    assert simulator.outputs == (False, False)
    assert simulator.felt_velocity(["A", "C"]).tolist() == [0, 0]
    assert loaded.firing is not None
    assert loaded.firing.confirmed


def test_a_catch_trial_sets_and_confirms_everything_but_plays_nothing(loaded: Generator, simulator: Simulator) -> None:
    """Amplitudes set, relays on, all confirmed, and no motion, even directly after a trial with a stimulus."""
    loaded.fire(0.1)
    loaded.stop()
    firing = loaded.fire(0.08, silent=True)
    assert firing.started
    assert firing.confirmed_amplitude == firing.commanded_amplitude != (0, 0)
    assert firing.bursts == Bursts(0, 0, 0, 0)
    assert simulator.outputs == (True, True)
    assert simulator.felt_velocity(["A", "C"]).tolist() == [0, 0]
    loaded.stop()
    assert simulator.outputs == (False, False)
    assert loaded.firing is not None
    assert loaded.firing.confirmed
    assert loaded.fire(0.08).started
    assert (simulator.felt_velocity(["A", "C"]) > 0).all()


def test_a_catch_trial_has_the_same_commands_and_duration(loaded: Generator, heard: Any, clock: VirtualClock) -> None:
    """Neither relays nor delays reveal a catch trial: only the triggers are omitted."""
    sent, took = [], []
    for silent in (False, True):
        heard.clear()
        began = clock.now()
        loaded.fire(0.08, silent=silent)
        took.append(clock.now() - began)
        loaded.stop()
        sent.append(heard.sent)
    assert sent[0] == sent[1]
    assert took[0] == pytest.approx(took[1], abs=1e-6)


@pytest.mark.parametrize("silent", [False, True])
@pytest.mark.parametrize("ahead", [0.0, 0.03, 0.2, 0.7])
def test_the_first_burst_is_triggered_when_it_is_due(
    loaded: Generator, clock: VirtualClock, ahead: float, silent: bool
) -> None:
    """Settings are made and read back beforehand; never before the relays have settled."""
    called = clock.now()
    firing = loaded.fire(0.1, due=called + ahead, silent=silent)
    assert firing.started
    assert firing.onset == pytest.approx(called + max(ahead, RELAYS_SETTLE), abs=2e-3)


def test_the_lead_adapts_to_the_speed_of_the_instrument(loaded: Generator, clock: VirtualClock, heard: Any) -> None:
    """Twice the preparation time in addition to the relays, bounded; shorter when the instrument is faster again."""
    assert loaded.lead == pytest.approx(0.05)
    prepare = loaded._player.prepare

    def slowly(*given: Any, **options: Any) -> tuple[str, ...]:
        clock.sleep(delay)
        return prepare(*given, **options)

    loaded._player.prepare = slowly  # type: ignore[method-assign]
    delay = 0.1
    loaded.fire(0.1)
    loaded.stop()
    assert loaded.lead == pytest.approx(0.25, abs=1e-3)
    delay = 5.0
    loaded.fire(0.1)
    loaded.stop()
    assert loaded.lead == pytest.approx(0.3)
    delay = 0.0
    for _ in range(30):
        loaded.fire(0.1)
        loaded.stop()
    assert loaded.lead == pytest.approx(0.05, abs=2e-3)


@pytest.mark.parametrize("repetition", ["continuous", "wired"])
def test_catch_trials_need_triggered_bursts(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst, repetition: str
) -> None:
    """An untriggered record plays as soon as the outputs are on: a catch trial is refused, and the outputs stay off."""
    generator = open_generator(repetition=repetition)
    generator.load(burst)
    with pytest.raises(RigError, match="needs the repetition `single`"):
        generator.fire(0.1, silent=True)
    assert simulator.outputs == (False, False)


@pytest.mark.parametrize("n_bursts", [1, 2, 14])
def test_whole_bursts_are_played_and_counted(loaded: Generator, clock: VirtualClock, heard: Any, n_bursts: int) -> None:
    """The requested number of triggers, one period apart, none after the last; all bursts complete."""
    loaded.fire(0.1, n_bursts=n_bursts)
    for _ in range(30):
        clock.sleep(0.1)
        loaded.heartbeat()
    loaded.stop()
    assert loaded.firing is not None
    assert loaded.firing.confirmed
    bursts = loaded.firing.bursts
    assert (bursts.asked, bursts.played, bursts.whole, bursts.dropped) == (n_bursts, n_bursts, n_bursts, 0)


@pytest.mark.parametrize(("n_dropped", "exactly", "confirmed"), [(1, False, True), (1, True, False), (3, False, False)])
def test_dropped_bursts_may_prevent_confirmation(
    loaded: Generator, guard: Any, clock: VirtualClock, n_dropped: int, exactly: bool, confirmed: bool
) -> None:
    """None of a fixed number may be missing, otherwise one may, and is recorded; more count as a stall, not a fault."""
    loaded.fire(0.1, n_bursts=14, exactly=exactly)
    clock.sleep(0.01)
    clock._due, due = [], clock._due
    clock.sleep(n_dropped / 7)
    clock._due = due
    loaded.heartbeat()
    clock.sleep(0.8)
    loaded.heartbeat()
    loaded.stop()
    assert loaded.firing is not None
    assert loaded.firing.bursts.dropped == n_dropped
    assert loaded.firing.confirmed is confirmed
    assert loaded.firing.stalled is not confirmed


@pytest.mark.parametrize(("held_up", "stalled"), [(0.0, False), (HELD_UP, False), (HELD_UP + 0.01, True)])
@pytest.mark.parametrize("place", ["start", "stop"])
def test_a_fault_during_a_delay_of_this_computer_counts_as_a_stall(
    loaded: Generator,
    simulator: Simulator,
    guard: Any,
    monkeypatch: pytest.MonkeyPatch,
    place: str,
    held_up: float,
    stalled: bool,
) -> None:
    """Beyond 50 ms: not confirmed and marked as stalled; the next stimulus is confirmed."""
    monkeypatch.setattr(guard, "held_up", lambda: held_up)
    simulator.faults.inject("lost_reply", when="OUTP1 ON" if place == "start" else r"OUTP1\?;:OUTP2\?")
    loaded.fire(0.1)
    loaded.stop()
    assert loaded.firing is not None
    assert not loaded.firing.confirmed
    assert loaded.firing.reason
    assert loaded.firing.stalled is stalled
    assert loaded.fire(0.1).started
    loaded.stop()
    assert loaded.firing.confirmed
    assert not loaded.firing.stalled


@pytest.mark.parametrize(
    ("report", "stalled", "reason"),
    [
        (Report(due=1, ended="failed", reason="the trigger was refused"), False, "the trigger was refused"),
        (Report(due=3, dropped=3, ended="stalled"), True, "this computer was held up: no burst could be played in"),
        (Report(due=5, dropped=5), True, "this computer was held up: no burst could be played in time"),
    ],
)
def test_a_first_burst_that_is_not_played_starts_no_stimulus(
    loaded: Generator, simulator: Simulator, guard: Any, heard: Any, monkeypatch: pytest.MonkeyPatch,
    report: Report, stalled: bool, reason: str,
) -> None:  # fmt: skip
    """Refused by the instrument, or not sent in time for five periods: told apart, the outputs off either way."""
    with monkeypatch.context() as patch:
        patch.setattr(guard, "play", lambda order: report)
        firing = loaded.fire(0.1)
    assert not firing.started
    assert firing.stalled is stalled
    assert firing.reason.startswith(reason)
    assert [facts["reason"] for facts in heard.of("unconfirmed")] == [firing.reason]
    assert simulator.outputs == (False, False)
    assert loaded.fire(0.1).started


@pytest.mark.parametrize(("held_up", "stalled"), [(0.0, False), (HELD_UP + 0.01, True)])
def test_an_output_found_off_is_a_stall_only_where_this_computer_was_held_up(
    loaded: Generator, simulator: Simulator, guard: Any, monkeypatch: pytest.MonkeyPatch, held_up: float, stalled: bool
) -> None:
    """Else somebody switched it off; either way the stimulus is not confirmed, and its bursts are not counted."""
    monkeypatch.setattr(guard, "held_up", lambda: held_up)
    loaded.fire(0.1)
    simulator.front_panel("OUTP1 OFF")
    loaded.stop()
    assert loaded.firing is not None
    assert not loaded.firing.confirmed
    assert loaded.firing.stalled is stalled
    assert ("this computer was held up" in loaded.firing.reason) is stalled
    assert (loaded.firing.bursts.played, loaded.firing.bursts.whole) == (None, None)


def test_outputs_go_on_a_tenth_of_a_second_before_a_burst(loaded: Generator, clock: VirtualClock) -> None:
    """All else is set at once; the relays have twice the time that they need."""
    apply, went_on = loaded._connection.controls.apply, list[float]()

    def note(settings: Sequence[Setting]) -> tuple[str, ...]:
        went_on.extend(clock.now() for setting in settings if setting.command == "OUTP1 ON")
        return apply(settings)

    loaded._connection.controls.apply = note  # type: ignore[method-assign]
    due = clock.now() + 0.7
    assert loaded.fire(0.1, due=due).started
    assert went_on == pytest.approx([due - 2 * RELAYS_SETTLE], abs=1e-3)


def test_both_channels_of_a_continuous_record_begin_together(
    open_generator: Callable[..., Generator], burst: Burst, heard: Any
) -> None:
    """Their phases are aligned before the outputs go on; bursts need none."""
    for repetition, n_aligned in (("continuous", 1), ("single", 0)):
        with open_generator(repetition=repetition) as rig:
            rig.load(burst)
            heard.clear()
            assert rig.fire(0.1).started
            before = heard.sent[: next(n for n, sent in enumerate(heard.sent) if "OUTP1 ON" in sent)]
            assert sum("SOUR1:PHAS:INIT" in sent for sent in before) == n_aligned


def test_what_is_loaded_while_a_stimulus_plays_ends_it_first(
    loaded: Generator, simulator: Simulator, clock: VirtualClock, make: Callable[..., Burst]
) -> None:
    """Confirmed as it was played, the outputs off before the next record is sent."""
    loaded.fire(0.1, n_bursts=1)
    clock.sleep(0.1)
    loaded.load(make(seed=1))
    assert simulator.outputs == (False, False)
    assert loaded.firing is not None
    assert (loaded.firing.confirmed, loaded.firing.bursts.whole) == (True, 1)


def test_a_trigger_that_fails_later_spoils_the_stimulus(
    loaded: Generator, clock: VirtualClock, guard: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the reason that the pacer gives; how many bursts were whole is not known."""
    loaded.fire(0.1)
    failed = Report(due=3, played=2, first=(100.0, 100.0), ended="failed", reason="the trigger was refused")
    with monkeypatch.context() as patch:
        patch.setattr(guard, "report", lambda *, wait: failed)
        loaded.stop()
    assert loaded.firing is not None
    assert (loaded.firing.confirmed, loaded.firing.reason) == (
        False,
        "the trigger was refused when the stimulus ended",
    )
    assert (loaded.firing.bursts.asked, loaded.firing.bursts.played, loaded.firing.bursts.whole) == (3, None, None)


def test_no_burst_follows_the_end(loaded: Generator, clock: VirtualClock) -> None:
    """Ended 10 ms into the first burst: a second later it is still the only one, and whole."""
    loaded.fire(0.1)
    clock.sleep(0.01)
    loaded.end()
    for _ in range(10):
        clock.sleep(0.1)
        loaded.heartbeat()
    loaded.stop()
    assert loaded.firing is not None
    assert loaded.firing.confirmed
    assert (loaded.firing.bursts.asked, loaded.firing.bursts.played, loaded.firing.bursts.whole) == (1, 1, 1)


def test_stimulus_ends_between_bursts(loaded: Generator, clock: VirtualClock, simulator: Simulator) -> None:
    """Stopped 10 ms into the third burst: that one comes to its end, 40 ms later, and no other follows."""
    firing = loaded.fire(0.1)
    clock.sleep(2 / 7 + 0.01 - (clock.now() - firing.onset))
    loaded.end()
    stopped = clock.now()
    loaded.stop()
    assert clock.now() - stopped == pytest.approx(0.04, abs=2e-3)
    assert loaded.firing is not None
    assert (loaded.firing.bursts.played, loaded.firing.bursts.whole) == (3, 3)


def test_an_emergency_stop_interrupts_the_current_burst(loaded: Generator, clock: VirtualClock) -> None:
    """Outputs off immediately, 10 ms into the first burst, which is counted as played but not as complete."""
    loaded.fire(0.1)
    clock.sleep(0.01)
    stopped = clock.now()
    loaded.stop(at_once=True)
    assert clock.now() == pytest.approx(stopped, abs=1e-6)
    assert loaded.firing is not None
    assert (loaded.firing.bursts.played, loaded.firing.bursts.whole) == (1, 0)


def test_velocity_is_proportional_to_the_level(loaded: Generator, simulator: Simulator) -> None:
    """The beam is linear: velocities are in the ratio of the levels, 0.4 to 0.5 to 0.75 to 1."""
    felt = []
    for level in LEVELS:
        loaded.fire(level)
        felt.append(simulator.felt_velocity(["B", "D"]))
        loaded.stop()
    assert np.allclose(np.array(felt) / felt[-1], np.array(LEVELS)[:, None] / 0.2, rtol=1e-9)


def test_the_instrument_has_the_settings_of_the_burst(loaded: Generator, simulator: Simulator) -> None:
    """While it fires: 20 Hz, one cycle per trigger, 12 and 8 Vpp, no offset."""
    loaded.fire(0.2)
    for channel, memory, amplitude in zip(simulator.afg.channels.values(), ("USER1", "USER2"), (12, 8), strict=True):
        assert channel.function == memory
        assert (channel.frequency, channel.n_cycles, channel.burst, channel.burst_mode) == (20, 1, True, "TRIG")
        assert (channel.offset, channel.delay, channel.polarity) == (0, 0, "NORM")
        assert math.isinf(channel.load)
        assert channel.amplitude == pytest.approx(amplitude)
    assert simulator.afg.trigger_source == "EXT"


def test_the_timer_runs_at_the_repetition_rate(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst
) -> None:
    """`timer`, as in the paper: source TIM at 1/7 s; the onset is uncertain by one period, bursts are not counted."""
    rig = open_generator(repetition="timer")
    rig.load(burst)
    firing = rig.fire(0.2)
    assert simulator.afg.trigger_source == "TIM"
    assert simulator.afg.timer == pytest.approx(1 / 7, rel=1e-8)
    assert 2 * firing.onset_uncertainty == pytest.approx(1 / 7, rel=1e-6)
    rig.stop()
    assert rig.firing is not None
    assert rig.firing.confirmed
    assert rig.firing.bursts.played is None


@pytest.mark.parametrize("pulses", [7.0, 5.0])
def test_wired_bursts_are_counted_by_their_source(
    apparatus: Apparatus, guard: Any, burst: Burst, heard: Any, clock: VirtualClock, tmp_path: Path, pulses: float
) -> None:
    """`wired`: pulses at the trigger input play bursts while outputs are on; the driver sends and counts none."""
    twin = apparatus.twin.generator.model_copy(update={"external_pulses_Hz": pulses})
    update = {
        "twin": apparatus.twin.model_copy(update={"generator": twin}),
        "generator": apparatus.generator.model_copy(update={"repetition": "wired"}),
    }
    wired, played = apparatus.model_copy(update=update), tmp_path / "played.jsonl"
    with Simulator(wired, clock=clock, played=played) as simulator:
        rig = Generator(simulator.address, wired, log=heard, start_guard=guard, clock=clock)
        with rig:
            rig.load(burst)
            heard.clear()
            assert rig.fire(0.2, n_bursts=3).started
            assert simulator.outputs == (True, True)
            assert simulator.afg.trigger_source == "EXT"
            for _ in range(30):
                clock.sleep(0.1)
                rig.heartbeat()
            assert (simulator.felt_velocity(["A", "C"]) > 0).all()
            rig.stop()
    lines = [json.loads(line) for line in played.read_text(encoding="utf-8").splitlines()]
    assert len(lines) == pytest.approx(3 * pulses, abs=1)
    assert {line["link"] for line in lines} == {None}
    assert not any("TRG" in sent or "TRIG:SEQ" in sent for sent in heard.sent)
    assert rig.firing is not None
    assert (rig.firing.confirmed, rig.firing.reason, rig.firing.repetition) == (True, "", "wired")
    assert rig.firing.bursts == Bursts()


def test_fingers_follow_the_placements_of_a_session_log(
    apparatus: Apparatus, guard: Any, burst: Burst, heard: Any, clock: VirtualClock, tmp_path: Path
) -> None:
    """The log of another process, first half written: each burst meets the fingers of its own placement."""
    heavy = FingerSection(mass_g=0.2, damping_N_s_per_m=1.0)
    touched = apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update={"fingers": heavy})})
    log, played = tmp_path / "session.jsonl", tmp_path / "played.jsonl"
    lines = [
        f'{{"n":{n},"event":"placement","zone_left":"{left}","zone_right":"{right}"}}\n'
        for n, (left, right) in enumerate(("AC", "BD"))
    ]
    with Simulator(touched, clock=clock, played=played, follow=log) as simulator:
        expected = []
        with Generator(simulator.address, touched, log=heard, start_guard=guard, clock=clock) as rig:
            rig.load(burst)
            for n, text in enumerate((None, lines[0][:30], lines[0][30:], lines[1])):
                if text is not None:
                    with log.open("a", encoding="utf-8") as growing:
                        growing.write(text)
                rig.fire(0.2, n_bursts=1)
                clock.sleep(0.2)
                expected.append(simulator.felt_velocity(("", "", "AC", "BD")[n]) * 1e3)
                rig.stop()
                while not played.exists() or len(played.read_text(encoding="utf-8").splitlines()) <= n:
                    time.sleep(1e-3)
    told = [json.loads(line)["finger_peak_mm_s"] for line in played.read_text(encoding="utf-8").splitlines()]
    assert [list(each) for each in told] == [[], [], ["A", "C"], ["B", "D"]]
    for fingers, speeds in zip(told, expected, strict=True):
        # The twin reports one burst from rest, the log one after many.
        assert list(fingers.values()) == pytest.approx(speeds, rel=1e-3)


def test_a_followed_log_can_be_read_by_several_threads(apparatus: Apparatus, tmp_path: Path) -> None:
    """Every placement is noticed while other threads read, with switches between any two instructions."""
    log, over, interval = tmp_path / "session.jsonl", threading.Event(), sys.getswitchinterval()
    log.touch()
    followed = FollowedSession(log, apparatus)

    def read() -> None:
        while not over.is_set():
            followed.fingers()

    readers = [threading.Thread(target=read) for _ in range(3)]
    sys.setswitchinterval(1e-6)
    try:
        for reader in readers:
            reader.start()
        for left, right in ("AC", "BD", "CE") * 20:
            with log.open("a", encoding="utf-8") as growing:
                growing.write(f'{{"event":"placement","zone_left":"{left}","zone_right":"{right}"}}\n')
            assert list(followed.fingers()) == [left, right]
    finally:
        over.set()
        sys.setswitchinterval(interval)
        for reader in readers:
            reader.join()


def test_a_truncated_line_in_a_followed_log_is_skipped(apparatus: Apparatus, tmp_path: Path) -> None:
    """It remains in the log of a resumed session (`modaltouch.record.chain`); its trial is presented again."""
    log = tmp_path / "session.jsonl"
    placed = '{"event":"placement","zone_left":"A","zone_right":"C"}\n'
    log.write_text(f'{placed}{{"event":"trial","answ\n{placed.replace("A", "B")}', encoding="utf-8")
    assert list(FollowedSession(log, apparatus).fingers()) == ["B", "C"]


def test_following_a_folder_is_refused(apparatus: Apparatus, tmp_path: Path) -> None:
    """Otherwise the error would occur during a burst and break the driver's connection."""
    with pytest.raises(InputError, match="given a folder; allowed: the log of a session.*give its session.jsonl"):
        Simulator(apparatus, follow=tmp_path)


def test_fingers_differ_between_the_placements_of_a_followed_session(apparatus: Apparatus, tmp_path: Path) -> None:
    """With the twin's spread, drawn from the session's seed: none with hands off, the same when read again."""
    spread = {"mass": 0.2, "damping": 0.2, "stiffness": 0.2, "offset_mm": 2.0}
    own = {
        "fingers": FingerSection(mass_g=0.1, damping_N_s_per_m=0.5, stiffness_N_per_mm=0.5),
        "finger_spread": FingerSpread.model_validate(spread),
    }
    touched = apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update=own)})
    log = tmp_path / "session.jsonl"
    place = '{"event":"placement","zone_left":"A","zone_right":"C"}\n'
    lines = ['{"event":"start","seed":1,"participant":"p01","session":1}\n', place, '{"event":"hands_off"}\n', place]

    def read() -> list[list[Finger]]:
        log.write_text("", encoding="utf-8")
        found = []
        with Simulator(touched, follow=log) as simulator:
            for line in lines:
                with log.open("a", encoding="utf-8") as growing:
                    growing.write(line)
                found.append(list(simulator.touched.values()))
        return found

    nobody, first, off, second = read()
    assert nobody == off == []
    assert [nobody, first, off, second] == read()
    for values in zip(*([f.position, f.mass, f.damping, f.stiffness] for f in (*first, *second)), strict=True):
        assert len(set(values)) == 4
    assert all(abs(f.position - centre) < 8e-3 for f, centre in zip(second, (-0.04, 0.0), strict=True))


def test_fingers_differ_between_the_trials_of_a_placement(apparatus: Apparatus, tmp_path: Path) -> None:
    """Drawn again after each trial, around the values of the placement."""
    own = {
        "fingers": FingerSection(mass_g=0.1, damping_N_s_per_m=0.5),
        "finger_trial_spread": FingerSpread.model_validate({"mass": 0.02, "offset_mm": 0.1}),
    }
    log, twin = tmp_path / "session.jsonl", apparatus.twin.model_copy(update=own)
    followed, masses = FollowedSession(log, apparatus.model_copy(update={"twin": twin})), []
    given = []
    start = '{"event":"start","seed":1,"participant":"p01","session":1}\n'
    for line in (start + '{"event":"placement","zone_left":"A","zone_right":"C"}\n', *['{"event":"trial"}\n'] * 30):
        with log.open("a", encoding="utf-8") as growing:
            growing.write(line)
        given.append(followed.fingers())
        masses += [finger.mass for finger in given[-1].values()]
    assert len(set(masses)) == 62
    # The fingers returned for a burst are unchanged when the burst is listed.
    assert [finger.mass for fingers in given for finger in fingers.values()] == masses
    assert np.std(np.log(masses)) == pytest.approx(0.02, rel=0.3)
    assert np.mean(masses) == pytest.approx(1e-4, rel=0.01)


def test_a_burst_may_override_the_repetition(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst
) -> None:
    """A burst for a measurement plays continuously, without triggers; the next one loaded is triggered as usual."""
    rig = open_generator()
    rig.load(burst, repetition="continuous")
    rig.fire(0.1)
    assert rig.firing is not None
    assert (rig.firing.repetition, simulator.afg.channels[1].output) == ("continuous", True)
    rig.stop()
    rig.load(burst)
    rig.fire(0.1, n_bursts=1)
    rig.stop()
    assert (rig.firing.repetition, rig.firing.confirmed) == ("single", True)
    assert rig.firing.bursts.asked == 1


def test_a_wired_firing_is_confirmed_by_its_settings(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst
) -> None:
    """Without a pulse nothing plays, which cannot be detected; a changed trigger source or output is."""
    rig = open_generator(repetition="wired")
    rig.load(burst)
    for command, confirmed in (("*WAI", True), ("TRIG:SOUR TIM", False), ("OUTP2 OFF", False)):
        rig.fire(0.1)
        simulator.front_panel(command)
        rig.stop()
        assert rig.firing is not None
        assert rig.firing.confirmed is confirmed


def test_every_setting_is_followed_by_an_error_query(loaded: Generator, heard: Any) -> None:
    """Each message that sets something ends with SYST:ERR?."""
    loaded.fire(0.1)
    loaded.stop()
    sets = [m for m in heard.sent if any(" " in unit.strip() and "?" not in unit for unit in m.split(";"))]
    assert sets
    assert all(message.endswith("SYST:ERR?") for message in sets)


def test_a_level_change_sends_no_record(loaded: Generator, heard: Any) -> None:
    """Over all levels, no message except lock and length queries concerns the memories."""
    for level in LEVELS:
        loaded.fire(level)
        loaded.stop()
    assert not any("DATA" in message.replace("DATA:LOCK:STAT?", "").replace("DATA:POIN?", "") for message in heard.sent)


def test_levels_are_set_while_the_trigger_is_stopped(loaded: Generator, simulator: Simulator) -> None:
    """No burst plays between the settings of the two channels: the source is external and both outputs are off."""
    seen = []
    change = simulator.afg.change

    def watch(number: int, **levels: float) -> None:
        seen.append((simulator.afg.trigger_source, simulator.outputs))
        change(number, **levels)

    simulator.afg.change = watch
    loaded.fire(0.1)
    loaded.fire(0.2)
    assert seen == [("EXT", (False, False))] * 4


def test_a_channel_without_drive_plays_zero_volts(generator: Generator, simulator: Simulator, burst: Burst) -> None:
    """It has a low amplitude and a record of zero volts."""
    codes = burst.codes.copy()
    codes[1] = 8191
    generator.load(replace(burst, codes=codes, amplitude=(12.0, 0.0)))
    firing = generator.fire(0.2)
    assert firing.started
    assert firing.commanded_amplitude == (12.0, 0.1)


def test_another_model_is_refused(simulator: Simulator, apparatus: Apparatus, guard: Any) -> None:
    """An instrument that differs from the apparatus file is not touched, and the message gives both models."""
    other = apparatus.model_copy(update={"generator": apparatus.generator.model_copy(update={"model": "AFG31022"})})
    simulator.front_panel("OUTP1 ON")
    with pytest.raises(RigError, match=r"says it is 'TEKTRONIX,AFG3022B.*names AFG31022; no output was switched on"):
        Generator(simulator.address, other, start_guard=guard)
    assert guard.told == ["clean"]
    assert simulator.outputs == (True, False)


def test_firing_again_stops_the_current_stimulus_first(loaded: Generator, simulator: Simulator) -> None:
    """A second fire changes the level with the outputs off in between, and is confirmed."""
    loaded.fire(0.1)
    assert loaded.fire(0.2).started
    assert simulator.outputs == (True, True)


def test_the_onset_is_after_the_relays_have_settled(loaded: Generator, clock: VirtualClock) -> None:
    """The first trigger is 50 ms after the outputs are on; if the latency is unmeasured, 1 ms is uncertain."""
    before = clock.now()
    firing = loaded.fire(0.1)
    assert firing.onset - firing.onset_uncertainty == pytest.approx(before + 0.05, abs=1e-6)
    assert firing.onset_uncertainty == pytest.approx(1e-3)
    assert firing.trigger_latency == "unknown"


def test_a_first_trigger_that_was_not_understood_leaves_no_instant(loaded: Generator, simulator: Simulator) -> None:
    """A trigger garbled on its way is accepted by the link: the error found at the end leaves the onset unknown."""
    simulator.faults.inject("truncated_upload", when="TRIG:SEQ:IMM")
    loaded.fire(0.1, n_bursts=3)
    loaded.stop()
    assert loaded.firing is not None
    assert not loaded.firing.confirmed
    assert "the generator reports -113" in loaded.firing.reason
    counted = loaded.firing.bursts
    assert (counted.played, counted.first_s, counted.uncertainty_s) == (None, None, None)


def test_a_late_acknowledgement_does_not_bound_the_first_sample(loaded: Generator) -> None:
    """With a trigger acknowledged after 2.1 ms, the first sample may be up to a millisecond later than that."""
    assert loaded._sample_left((5.0, 5.0021)) == pytest.approx((5.0, 5.0031))
    assert loaded._sample_left((5.0, 5.0)) == pytest.approx((5.0, 5.002)), "an immediate one says nothing"


def test_a_measured_latency_gives_the_time_of_the_first_sample(
    simulator: Simulator, apparatus: Apparatus, guard: Any, burst: Burst, clock: VirtualClock
) -> None:
    """`generator.trigger_latency_ms`: the interval of the trigger is shifted by the bounds."""
    own = apparatus.generator.model_copy(update={"trigger_latency_ms": Latency(low=3.0, high=3.4)})
    measured = apparatus.model_copy(update={"generator": own})
    with Generator(simulator.address, measured, start_guard=guard, clock=clock) as rig:
        rig.load(burst)
        before = clock.now()
        firing = rig.fire(0.1)
        assert rig._sample_left((5.0, 5.5)) == pytest.approx((5.003, 5.5034)), "sent then, accepted by then"
    assert firing.onset == pytest.approx(before + 0.05 + 3.2e-3, abs=1e-6)
    assert firing.onset_uncertainty == pytest.approx(0.2e-3, abs=1e-6)
    assert firing.trigger_latency == "measured"


def test_the_repetition_follows_the_apparatus_file(
    simulator: Simulator, apparatus: Apparatus, guard: Any, burst: Burst
) -> None:
    """With `generator.repetition: continuous` the driver plays one record of 1/7 s, without a trigger."""
    lasting = apparatus.generator.model_copy(update={"repetition": "continuous"})
    with Generator(simulator.address, apparatus.model_copy(update={"generator": lasting}), start_guard=guard) as rig:
        rig.load(burst)
        assert rig.fire(0.1).started
        assert not simulator.afg.channels[1].burst
        assert simulator.afg.channels[1].frequency == pytest.approx(7)


def test_a_continuous_record_repeats_without_a_trigger(
    open_generator: Callable[..., Generator], simulator: Simulator, make: Callable[..., Burst]
) -> None:
    """Without burst mode one record of 1/7 s holds burst and silence; what is felt differs by under 2 %.

    It begins with the command, so that its first burst is known to within what that takes.
    """
    burst = make(n_samples=125_000)
    felt = []
    for repetition in ("single", "continuous"):
        with open_generator(repetition=repetition) as rig:
            rig.load(burst)
            firing = rig.fire(0.2)
            assert firing.started
            assert firing.onset_uncertainty < 2e-3
            felt.append(simulator.felt_velocity(["A", "C", "E"]))
            rig.stop()
            assert rig.firing is not None
            assert rig.firing.confirmed
    assert simulator.afg.channels[1].frequency == pytest.approx(7)
    assert felt[1] == pytest.approx(felt[0], rel=0.02)
