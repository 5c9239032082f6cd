"""Tests of generator properties that the manuals do not specify; those that software cannot test are left to the user.

Nothing is played: the outputs are off whenever a burst starts, and the amplitude is low whenever they are on.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from timeit import timeit
from typing import Any, Literal

import numpy as np

from modaltouch.protocol import Apparatus
from modaltouch.rig import instrument_of
from modaltouch.rig.connection import Connection, Patience
from modaltouch.rig.controls import split_reply
from modaltouch.rig.interface import LinkError, Rig, Unconfirmed
from modaltouch.rig.scope import Scope
from modaltouch.rig.watchdog_client import WatchdogClient
from modaltouch.stimulus import Burst
from modaltouch.system import SYSTEM_CLOCK

REPETITION_PERIOD = 1 / 7
N_POINTS = 125_000
STEPS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
N_CHANGES = 3
N_TRIGGERS, TRIGGER_PERIOD = 50, 0.05

State = Literal["found", "person", "unanswered"]


Finding = tuple[State, str, str]
"""State, answer and advice for one question."""


def _settings(connection: Connection) -> Finding:
    return (
        "found",
        f"{connection.identity}; outputs off; accepts its settings and reads them back",
        "its settings are suitable for a session",
    )


SKEW: Finding = (
    "person",
    "cannot be seen over the bus",
    "play the same record on both channels and measure the time between their edges on an oscilloscope; a skew below "
    "0.1 us shifts the phase of the fastest mode, 88 kHz, by less than 4 degrees",
)


def _timer(connection: Connection) -> Finding:
    connection.controls.ask(f":TRIG:TIM {REPETITION_PERIOD:.12g}S;:TRIG:TIM?")
    period = float(connection.controls.ask("TRIG:TIM?"))
    off = period / REPETITION_PERIOD - 1
    return (
        "found",
        f"142.857142857 ms requested, {period * 1e3:.9g} ms set ({off * 1e6:+.2g} ppm)",
        "bursts come at this period" if abs(off) < 5e-4 else "the driver will refuse it: the timer is too coarse",
    )


def _copy_time(connection: Connection) -> Finding:
    controls = connection.controls
    kept = "USER4" in controls.ask("DATA:CAT?")
    controls.complete("DATA:COPY EMEM,USER4" if kept else f"DATA:DEF EMEM,{N_POINTS}")
    n_points = controls.ask("DATA:POIN? EMEM")
    try:
        took = timeit(lambda: controls.complete("DATA:COPY USER4,EMEM"), number=1)
    except Unconfirmed as error:
        return "unanswered", str(error), "unlock USER4 at the instrument (Edit menu) and check again"
    if not kept:
        controls.complete("DATA:DEL USER4")
    enough = took < connection.patience.copy / 2
    return (
        "found",
        f"{took * 1e3:.1f} ms for {n_points} points into USER4 (whose content was kept)",
        f"{'well' if enough else 'BARELY'} within the {connection.patience.copy:g} s that the driver waits",
    )


def _ranges(connection: Connection) -> Finding:
    limits = connection.limits
    allowed = [each for each in STEPS if each / 2 <= limits.level] or [limits.quiet_amplitude]
    took = {each: min(_time_of_change(connection, each) for _ in range(N_CHANGES)) for each in allowed}
    connection.controls.apply([connection.instrument.level(1, limits.quiet_amplitude)])
    steps = ", ".join(f"{amplitude:g} Vpp {seconds * 1e3:.1f} ms" for amplitude, seconds in took.items())
    return (
        "person",
        f"changes took {steps}",
        "listen while the level steps through all of these: a clicking relay reveals the level to the participant; the "
        "masking noise must cover it",
    )


def _time_of_change(connection: Connection, amplitude: float) -> float:
    """Return the duration of a change from the lowest amplitude to another [s]."""
    connection.controls.apply([connection.instrument.level(1, connection.instrument.lowest_amplitude)])
    return timeit(lambda: connection.controls.apply([connection.instrument.level(1, amplitude)]), number=1)


def _limits(connection: Connection) -> Finding:
    controls, limits = connection.controls, connection.limits
    controls.apply_each(replace(limits, level=1.0).quiet_settings(1))
    controls.clear_errors()
    above = connection.instrument.level(1, 4.0)
    reply = float(split_reply(controls.ask(f":{above.command};:{above.query}"))[-1])
    errors = controls.pending_errors()
    controls.apply_each(limits.quiet_settings(1))
    if reply > 2.001:
        return "found", f"4 Vpp is accepted above a limit of 1 V (reads {reply:g})", "DO NOT rely on the voltage limits"
    how = f"refused with {', '.join(errors)}" if errors else "cut without an error"
    return "found", f"4 Vpp above a limit of 1 V is {how}; the level reads {reply:g} Vpp", "the limit holds"


def _trigger(connection: Connection, scope: Scope | None = None) -> Finding:
    instrument, controls = connection.instrument, connection.controls
    # Both channels wait, at the standby amplitude, for commands that trigger one cycle of their waveform.
    controls.apply(instrument.on_all(instrument.commands.stopped))
    for channel in instrument.channels:
        controls.apply_each(connection.limits.quiet_settings(channel))
        controls.apply_each([entry.filled(channel=channel) for entry in instrument.commands.triggered])
    controls.apply_each(instrument.commands.pulses if scope is not None else ())
    command = instrument.commands.trigger
    sent, began, taken = np.empty(N_TRIGGERS), np.full((N_TRIGGERS, 2), np.nan), np.empty(N_TRIGGERS)

    def send() -> None:
        sent[n] = SYSTEM_CLOCK.now()
        # As the pacer does.
        connection.guard.exchange(command.encode() + b"\n", timeout=connection.patience.trigger, reply=False)
        taken[n] = SYSTEM_CLOCK.now()

    for n in range(N_TRIGGERS):
        if scope is None:
            send()
        else:
            began[n] = scope.time_trigger(send)
        SYSTEM_CLOCK.sleep(TRIGGER_PERIOD)
    took = (taken - sent) * 1e3
    answer = f"{command} is accepted after {np.median(took):.2f} ms, {took.max():.2f} ms at most"
    if scope is None:
        return (
            "person",
            f"{answer}; the bus does not show when the first sample leaves",
            "wire the generator's trigger output (Keysight: Ext Trig) to the EXT input of a PicoScope and check again "
            "with --scope, which measures generator.trigger_latency_ms; without it, no instant is claimed to better "
            "than a millisecond",
        )
    # The lower bound is measured from sending the trigger, the upper bound from its acceptance by the instrument.
    low, high = (began[:, 0] - sent).min() * 1e3, (began[:, 1] - taken).max() * 1e3
    apart = np.median(np.diff(began, axis=1)) * 1e3
    low, high = max(0.0, math.floor(low * 10) / 10), max(0.1, math.ceil(high * 10) / 10)
    return (
        "found",
        f"{answer}; by a scope polled every {apart:.2f} ms, the first sample of {N_TRIGGERS} bursts left at least "
        "`low` after its trigger was sent and at most `high` after it was accepted: trigger_latency_ms: "
        f"{{low: {low:.1f}, high: {high:.1f}}}",
        "write this under generator: in the apparatus file; reaction times are then counted from these bounds",
    )


def _amplitude(connection: Connection) -> Finding:
    instrument, controls = connection.instrument, connection.controls
    zero, most = instrument.converter.mid_code, 2 * instrument.highest_output
    codes = np.full((1, 64), zero, dtype=np.uint16)
    codes[0, 16:32], codes[0, 32:48] = zero + zero // 2, zero - zero // 2
    (memory,) = controls.store([(1, codes[0])])
    half = Burst(codes, 0.05, 1 / REPETITION_PERIOD, 0.1, (1.0,), instrument.converter)
    controls.apply_each(instrument.burst_settings(1, memory, half, continuous=False))
    reached = float(connection.controls.ask(f"{connection.instrument.level(1, 1.0).query} MAX"))
    controls.reset()
    answer = f"a record that uses half the codes reaches {reached:.4g} Vpp, one that uses all codes {most:g} Vpp"
    if not math.isclose(reached, most * float(half.shares[0]), rel_tol=0.01):
        return "found", answer, "the driver assumes otherwise: EVERY LEVEL WOULD BE WRONG; do not play"
    meant = "the record, from its lowest code to its highest" if reached < 0.75 * most else "all codes"
    return "found", answer, f"an amplitude refers to {meant}, as the driver assumes"


QUESTIONS: tuple[tuple[int, str, Callable[[Connection], Finding]], ...] = (
    (0, "Does it accept the driver's settings?", _settings),
    (2, "How exactly does the trigger timer set 1/7 s?", _timer),
    (3, "How long does storing a record take?", _copy_time),
    (6, "Does a change of amplitude click or glitch?", _ranges),
    (7, "Is a level above the voltage limits refused or cut?", _limits),
    (10, "How far apart do the channels start?", lambda connection: SKEW),
    (13, "How soon after its command does a burst begin?", _trigger),
    (14, "Does an amplitude refer to all codes or to the record?", _amplitude),
)


def check_rig(
    address: str, apparatus: Apparatus, *, patience: Patience | None = None, scope: Scope | None = None
) -> list[dict[str, Any]]:
    """Answer the open questions about a generator listed in its `Instrument`.

    Parameters
    ----------
    address : str
        VISA address of an instrument or a simulator.
    apparatus : Apparatus
        The apparatus to which the generator belongs.
    patience : Patience, optional
        Timeouts and retries.
    scope : Scope, optional
        Scope at the generator's trigger output; without one, the trigger latency must be measured by hand.

    Returns
    -------
    list of dict
        In the order of the questions, each with its ``number`` (0: does the instrument accept the driver's settings at
        all), ``question``, ``state`` (``found`` by software, left to a ``person``, or ``unanswered``), ``answer``, and
        ``advice`` (recommended action, or the consequence for a session).

    Raises
    ------
    RigError
        If there is no such instrument at the address, or its outputs cannot be switched off afterwards.
    """
    connection = Connection(
        address,
        apparatus,
        guard=WatchdogClient(address, instrument_of(apparatus).off),
        log=lambda event, **facts: None,
        patience=patience or Patience(),
    )
    connection.open()
    try:
        rows = [
            _ask(connection, number, question, partial(_trigger, scope=scope) if find is _trigger else find)
            for number, question, find in QUESTIONS
            if number in connection.instrument.questions
        ]
        connection.switch_off("the check", (), lambda: None)
    except BaseException:
        connection.guard.release(clean=False)
        raise
    connection.guard.release(clean=True)
    return rows


def _ask(connection: Connection, number: int, question: str, find: Callable[[Connection], Finding]) -> dict[str, Any]:
    """Answer one question, then restore any connection or setting that it disturbed."""
    try:
        state, answer, advice = find(connection)
    except (LinkError, Unconfirmed, ValueError) as error:  # some replies are converted to numbers
        connection.restore(f"question {number}", (), lambda: None)
        state, answer = "unanswered", str(error)
        advice = "check again; if it persists, look at the instrument"
    return {"number": number, "question": question, "state": state, "answer": answer, "advice": advice}


_AMPLITUDES = (0.02, 0.03)
"""Low amplitudes, set in turn [V peak to peak]."""
_PROMPT_MS = 10.0
"""Time within which a level is set, read back and confirmed on a healthy connection [ms]."""
_SLOW_MS = 50.0
"""Time from an answer to the next burst due to the program itself; a slower instrument is noticeable [ms]."""


def measure_latency(
    rig: Rig, set_levels: Callable[[tuple[float, ...]], object], opened: float, *, n: int
) -> tuple[dict[str, Any], str]:
    """Measure the response times of a generator to commands, and assess them for an experiment.

    Parameters
    ----------
    rig : Rig
        The generator, its outputs off.
    set_levels : callable
        Sets both amplitudes and confirms them.
    opened : float
        Time taken to open it [s].
    n : int
        Number of commands of each kind.

    Returns
    -------
    figures : dict
        ``address``, ``identity`` and ``n``; ``open_ms``, the time to reach a known state, including the start of the
        watchdog; median, 95th percentile and maximum (``level_median_ms``, ``off_p95_ms``, ...) of the times for
        ``level`` (both amplitudes set and read back, error queue read) and ``off`` (both outputs switched off and
        confirmed).
    verdict : str
        Consequences for an experiment and recommended action.
    """
    amplitudes = itertools.cycle(_AMPLITUDES)
    commands: dict[str, Callable[[], object]] = {"level": lambda: set_levels((next(amplitudes),) * 2), "off": rig.stop}
    figures = {"address": rig.address, "identity": rig.identity, "n": n, "open_ms": round(opened * 1e3, 3)}
    for name, command in commands.items():
        taken = np.empty(n)
        for k in range(n):
            taken[k] = timeit(command, number=1) * 1e3
            rig.heartbeat()
        median, p95, longest = np.quantile(taken, (0.5, 0.95, 1.0)).round(3).tolist()
        figures |= {f"{name}_median_ms": median, f"{name}_p95_ms": p95, f"{name}_max_ms": longest}
    return figures, assess_latency(figures)


def assess_latency(figures: Mapping[str, Any]) -> str:
    """Return the consequences of a generator's latencies for an experiment, and the recommended action."""
    level, off = figures["level_p95_ms"], figures["off_p95_ms"]
    advice = "good"
    if level > _SLOW_MS:
        advice = (
            "too slow. Connect the generator directly or through one switch, not over a radio link or a busy "
            "network, and measure again"
        )
    elif level > _PROMPT_MS:
        advice = "each trial begins that much later; a dedicated cable to the generator is faster"
    taken = f"A level is set and confirmed within {level:.1f} ms, both outputs are off within {off:.1f} ms (95 %)"
    return f"{taken}: {advice}."
