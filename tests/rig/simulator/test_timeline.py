"""Playback over time with a virtual clock: phases, latencies, relays, and what ends a burst."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from modaltouch.rig.simulator.afg import afg_twin
from modaltouch.rig.simulator.common import Behaviour
from modaltouch.rig.simulator.timeline import FINEST, Delays, PlayedBurst
from modaltouch.system.clock import VirtualClock

RELAY = 4e-3
LENGTH = 0.05
AT_ONCE = Delays(latency=(0.0, 0.0), relay=RELAY)
SETTINGS = "FUNC USER1;:SOUR{n}:FREQ 20;:SOUR{n}:BURS:STAT ON;NCYC 1"


class Stage:
    """A generator that records what it plays, with bursts of 50 ms set up on both outputs, which are off."""

    def __init__(self, delays: Delays = AT_ONCE, behaviour: Behaviour | None = None, seed: int = 0) -> None:
        self.clock = VirtualClock(1000.0)
        self.afg, self.afg.table = afg_twin("AFG3022B", behaviour, delays=delays, seed=seed, clock=self.clock)
        self.played: list[PlayedBurst] = []
        self.afg.timeline.on_burst = self.played.append
        self.tell("DATA:DEF EMEM,1000;:DATA:DATA:LINE EMEM,1,0,1000,9990;:DATA:COPY USER1", "TRIG:SOUR EXT")
        for n in (1, 2):
            self.tell(f"SOUR{n}:{SETTINGS.format(n=n)}")

    def tell(self, *messages: str, link: int = 7) -> None:
        """Send messages, none of which may cause an error."""
        for message in messages:
            self.afg.execute(message.encode(), link)
            assert self.afg.next_error() == '0,"No error"'

    def on(self) -> None:
        """Switch the outputs on, and wait for the relays."""
        self.tell("OUTP1 ON;:OUTP2 ON")
        self.wait(2 * RELAY)

    def wait(self, seconds: float) -> None:
        """Let time pass, and bursts end."""
        self.clock.sleep(seconds)
        self.afg.settle()


@pytest.fixture
def stage() -> Stage:
    """Return a generator without latency, with no wire at its trigger input."""
    return Stage()


def test_a_triggered_burst_is_whole_and_has_the_number_of_its_link(stage: Stage) -> None:
    """Relays close before it and open after it: it is reported after it has ended, not before."""
    stage.on()
    begun = stage.clock.now()
    stage.tell("TRIG:SEQ:IMM")
    stage.wait(LENGTH - 1e-6)
    assert stage.played == []
    stage.tell("OUTP1 OFF;:OUTP2 OFF")
    stage.wait(2e-6)
    (burst,) = stage.played
    assert (burst.start, burst.end) == pytest.approx((begun, begun + LENGTH), abs=1e-9)
    assert (burst.whole, burst.link) == (True, 7)


def test_nothing_is_played_with_the_outputs_off(stage: Stage) -> None:
    """A trigger is accepted, and nothing is played."""
    stage.tell("*TRG")
    stage.wait(1.0)
    assert stage.played == []


def test_latency_is_uniform_between_its_bounds() -> None:
    """The Kolmogorov-Smirnov test does not reject it for 400 triggers."""
    stage = Stage(Delays(latency=(1e-4, 3e-4), relay=RELAY))
    stage.on()
    sent = []
    for _ in range(400):
        sent.append(stage.clock.now())
        stage.tell("*TRG")
        stage.wait(0.1)
    late = np.array([burst.start for burst in stage.played]) - sent
    assert late.min() >= 1e-4
    assert late.max() <= 3e-4
    assert kstest((late - 1e-4) / 2e-4, "uniform").pvalue > 0.01


def test_the_timer_is_free_running(rng: np.random.Generator) -> None:
    """Armed at random instants, the first burst is anywhere within a period; the phase does not change."""
    stage = Stage()
    stage.tell("TRIG:TIM 0.142857143")
    stage.on()
    waits, phases = [], []
    for _ in range(300):
        stage.wait(rng.uniform(1, 2))
        stage.played.clear()
        armed = stage.clock.now()
        stage.tell("TRIG:SOUR TIM")
        stage.wait(0.3)
        stage.tell("TRIG:SOUR EXT")
        waits.append((stage.played[0].start - armed) / 0.142857143)
        phases.append(stage.played[0].start / 0.142857143 % 1)
        assert stage.played[0].link is None
    assert kstest(waits, "uniform").pvalue > 0.01
    assert np.ptp(phases) < 1e-6


def test_timers_of_different_seeds_have_different_phases() -> None:
    """Their phases at one instant after outputs on are uniform over 200 twins."""
    waits = []
    for seed in range(200):
        stage = Stage(seed=seed)
        stage.tell("TRIG:TIM 0.2;SOUR TIM")
        stage.on()
        stage.wait(0.5)
        waits.append(stage.played[-1].start / 0.2 % 1)
    assert kstest(waits, "uniform").pvalue > 0.01


def test_a_relay_that_closes_late_cuts_the_beginning(stage: Stage) -> None:
    """The part before it has closed does not reach the beam."""
    stage.tell("OUTP1 ON;:OUTP2 ON", "*TRG")
    begun = stage.clock.now()
    stage.wait(0.1)
    (burst,) = stage.played
    assert not burst.whole
    assert (burst.start, burst.end) == pytest.approx((begun + RELAY, begun + LENGTH))
    assert burst.passed == (pytest.approx((RELAY, LENGTH)),) * 2


def test_a_relay_that_opens_early_cuts_the_end(stage: Stage) -> None:
    """The relay takes its time; the burst is reported when it has opened."""
    stage.on()
    stage.tell("*TRG")
    begun = stage.clock.now()
    stage.wait(0.02)
    stage.tell("OUTP1 OFF;:OUTP2 OFF")
    stage.wait(RELAY + 1e-6)
    (burst,) = stage.played
    assert not burst.whole
    assert (burst.start, burst.end) == pytest.approx((begun, begun + 0.02 + RELAY))
    stage.wait(1.0)
    assert len(stage.played) == 1


def test_an_output_that_is_off_does_not_count_but_a_late_one_does(stage: Stage) -> None:
    """A burst of one output alone is whole; one of both is not while the second relay is still open."""
    stage.tell("OUTP1 ON")
    stage.wait(0.1)
    stage.tell("*TRG")
    stage.wait(0.1)
    for wait in (0.01, LENGTH - RELAY / 2):
        stage.tell("*TRG")
        stage.wait(wait)
        stage.tell("OUTP2 ON")
        stage.wait(0.1)
        stage.tell("OUTP2 OFF")
        stage.wait(0.1)
    assert [burst.whole for burst in stage.played] == [True, False, False]
    assert [burst.sent[1] is None for burst in stage.played] == [True, False, True]


def test_a_trigger_during_a_burst_is_ignored() -> None:
    """As far as is known of an AFG3022B."""
    stage = Stage()
    stage.on()
    begun = stage.clock.now()
    stage.tell("*TRG")
    stage.wait(0.03)
    stage.tell("*TRG")
    stage.wait(1.0)
    assert [burst.start - begun for burst in stage.played] == pytest.approx([0.0])
    assert stage.played[0].whole


@pytest.mark.parametrize(
    "message",
    [
        "SOUR2:VOLT 0.5VPP",
        "SOUR1:FREQ 30",
        "SOUR1:BURS:STAT OFF",
        "SOUR1:FUNC SIN",
        "OUTP2:POL INV",
        "SOUR1:VOLT:OFFS 0.1V",
        "DATA:DEF EMEM,1000;:DATA:COPY USER1",
        "SOUR1:BURS:NCYC 2",
        "*RST",
        "ABOR",
    ],
)
def test_a_burst_ends_when_it_is_changed(stage: Stage, message: str) -> None:
    """20 ms after its first sample, immediately, independent of the relays; it is not whole."""
    stage.on()
    begun = stage.clock.now()
    stage.tell("*TRG")
    stage.wait(0.02)
    stage.tell(message)
    cut = stage.played[0]
    assert (cut.start, cut.whole) == (pytest.approx(begun), False)
    assert cut.end == pytest.approx(stage.clock.now(), abs=1e-8)


def test_a_power_failure_ends_a_burst_immediately(stage: Stage) -> None:
    """Without the delay of a relay, and without a further burst."""
    stage.on()
    stage.tell("*TRG")
    stage.wait(0.02)
    stage.afg.power_on()
    assert [(burst.whole, burst.end) for burst in stage.played] == [(False, pytest.approx(stage.clock.now()))]
    stage.wait(1.0)
    assert len(stage.played) == 1


@pytest.mark.parametrize("message", ["SOUR1:VOLT 1VPP", "TRIG:SOUR TIM", "TRIG:TIM 0.3", "SYST:ERR?", "SOUR1:FREQ 20"])
def test_other_messages_do_not_end_a_burst(stage: Stage, message: str) -> None:
    """An unchanged setting, settings of the trigger, queries."""
    stage.tell("SOUR1:VOLT 1VPP")
    stage.on()
    stage.tell("*TRG")
    stage.wait(0.02)
    stage.afg.execute(message.encode())
    stage.wait(0.04)
    assert [burst.whole for burst in stage.played[:1]] == [True]


def test_external_pulses_count_only_while_they_are_the_source() -> None:
    """7 Hz; with the timer as source they trigger nothing."""
    stage = Stage(replace(AT_ONCE, pulses=7.0))
    stage.on()
    stage.wait(10.0)
    assert len(stage.played) == pytest.approx(70, abs=1)
    assert np.diff([burst.start for burst in stage.played]) == pytest.approx(1 / 7)
    assert all(burst.whole and burst.link is None for burst in stage.played)
    stage.tell("TRIG:TIM 500;SOUR TIM")
    stage.wait(0.1)
    n_pulses = len(stage.played)
    stage.wait(10.0)
    assert len(stage.played) == n_pulses


def test_continuous_playback_is_reported_cycle_by_cycle(stage: Stage) -> None:
    """The first is cut by the relay that closes during it, the last by the one that opens."""
    stage.tell("SOUR1:BURS:STAT OFF;:SOUR2:BURS:STAT OFF", "OUTP1 ON;:OUTP2 ON")
    stage.wait(1.0)
    stage.tell("OUTP1 OFF;:OUTP2 OFF")
    stage.wait(1.0)
    assert [burst.whole for burst in stage.played] == [False, *[True] * 19, False]
    assert stage.played[0].end - stage.played[0].start == pytest.approx(LENGTH - RELAY)
    for before, after in zip(stage.played, stage.played[1:], strict=False):
        assert after.start == pytest.approx(before.end)


def test_very_fast_bursts_are_reported_once_a_millisecond(stage: Stage) -> None:
    """A timer of 1 us would otherwise give a million lines per second."""
    stage.tell("SOUR1:FREQ 2E6;:SOUR2:FREQ 2E6", "TRIG:TIM 1E-6;SOUR TIM")
    stage.on()
    stage.played.clear()
    stage.wait(1.0)
    assert len(stage.played) == pytest.approx(1 / FINEST, abs=1)


def test_a_day_with_the_outputs_off_is_skipped(stage: Stage) -> None:
    """605,000 ticks without playback; the timer keeps its phase."""
    stage.tell("TRIG:TIM 0.142857;SOUR TIM")
    starts = []
    for night in (0.0, 86_400.0):
        stage.wait(night)
        stage.on()
        stage.wait(1.0)
        starts.append(stage.played[-1].start)
        stage.tell("OUTP1 OFF;:OUTP2 OFF")
        stage.wait(1.0)
    periods = (starts[1] - starts[0]) / 0.142857
    assert periods == pytest.approx(round(periods), abs=1e-6)


def test_reports_do_not_depend_on_how_often_they_are_read(rng: np.random.Generator) -> None:
    """Updated after every millisecond or only at commands, the bursts are the same."""
    course: list[tuple[float, str]] = [
        (w, m)
        for w, m in zip(
            rng.uniform(0, 0.06, 200),
            rng.choice(
                [
                    "*TRG",
                    "OUTP1 ON",
                    "OUTP2 ON",
                    "OUTP1 OFF",
                    "OUTP2 OFF",
                    "ABOR",
                    "SOUR1:VOLT 1VPP",
                    "SOUR1:VOLT 2VPP",
                    "TRIG:SOUR TIM",
                    "TRIG:SOUR EXT",
                ],
                200,
            ),
            strict=True,
        )
    ]
    told = []
    for look in (False, True):
        stage = Stage(Delays(), seed=3)
        stage.tell("TRIG:TIM 0.07")
        for wait, message in course:
            end = stage.clock.now() + wait
            while look and stage.clock.now() + 1e-3 < end:
                stage.wait(1e-3)
            stage.clock.sleep(end - stage.clock.now())
            stage.tell(str(message))
        stage.wait(1.0)
        told.append([(round(b.start, 7), round(b.end, 7), b.whole, b.link) for b in stage.played])
    assert told[0] == told[1]
    assert {whole for _, _, whole, _ in told[0]} == {True, False}
