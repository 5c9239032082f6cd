"""What a protocol can say that no single key can: doubles, instants outside the burst, keys that clash."""

from __future__ import annotations

from collections.abc import Iterator

from modaltouch.protocol.adaptive_checks import check_adaptive, check_sensation_levels, is_adaptive
from modaltouch.protocol.document import Problem, Reading, suggest
from modaltouch.protocol.field_points import check_wished
from modaltouch.protocol.keys import END_KEY, KEY_ALIASES, KEY_NAMES, RESERVED_KEYS
from modaltouch.protocol.sections import AnswersSection, Protocol

TRIAL_LIMIT = 10_000
"""Most trials of a session: a day of them."""

CLOCK_RATE = 250e6
"""Sampling rate of the generator [Hz]."""


def check_protocol(reading: Reading[Protocol]) -> list[Problem]:
    """Return the faults between the keys of a protocol, as far as its sound parts show them."""
    return [
        *_check_stimulus(reading),
        *check_wished(reading),
        *_check_doubles(reading),
        *_check_schedule(reading),
        *check_adaptive(reading),
        *check_sensation_levels(reading),
        *_check_keys(reading),
        *_check_times(reading),
    ]


def check_settling(reading: Reading[Protocol]) -> Iterator[Problem]:
    """Return the fault of a written pause in which a hand that presses cannot come back to the beam.

    For fresh files alone: a record that was begun with such a pause goes on, with `AnswersSection.settling_s`.
    """
    answers = reading.sound("answers")
    if not isinstance(answers, AnswersSection) or reading.find(("answers", "pause_s")) is None:
        return
    settling = [fingers for _, fingers in reading.items("conditions", "finger_conditions") if answers.settles(fingers)]
    if settling and answers.pause_s < answers.settling_s:
        given = f"{answers.pause_s:g} s, but in {settling[0]} a hand or finger of those on the beam answers"
        allowed = f"at least {answers.settling_s:g} s (answers.settling_s), for it to come back and rest"
        remedy = "leave it out, or have a foot_switch or the experimenter answer (answers.ways)"
        yield reading.problem(("answers", "pause_s"), given, allowed, remedy)


def _check_stimulus(reading: Reading[Protocol]) -> Iterator[Problem]:
    section = ("stimulus",)
    duration = reading.sound(*section, "duration_ms")
    instant = reading.sound(*section, "focusing_instant_ms")
    rate = reading.sound(*section, "repetition_rate_Hz")
    n_samples = reading.sound(*section, "n_samples")
    if duration is not None and rate is not None and duration * rate > 1e3:
        given = f"{duration:g} ms at {rate:g} bursts per second"
        allowed = f"at most {1e3 / rate:g} ms, the time from one burst to the next"
        yield reading.problem((*section, "duration_ms"), given, allowed, "shorten the burst or repeat it less often")
    if duration is not None and instant is not None and instant >= duration:
        given = f"{instant:g} ms, which is not within the burst of {duration:g} ms"
        yield reading.problem((*section, "focusing_instant_ms"), given, f"below {duration:g} ms", "move one of them")
    if duration is not None and n_samples is not None:
        sampling_rate = n_samples / duration * 1e3
        if sampling_rate > CLOCK_RATE * (1 + 1e-12):
            given = f"{n_samples} samples in {duration:g} ms, which is {sampling_rate:.4g} Hz"
            allowed = f"at most {int(duration * 1e-3 * CLOCK_RATE)} samples, at the generator's 250 MHz"
            yield reading.problem((*section, "n_samples"), given, allowed, "take fewer")
        if instant is not None and instant < duration / n_samples:
            given = f"{instant:g} ms, before the second sample"
            yield reading.problem(
                (*section, "focusing_instant_ms"),
                given,
                f"at least {duration / n_samples:g} ms",
                "move it later",
            )
    design = reading.sound(*section, "design")
    if reading.sound(*section, "law") == "paper" and design not in (None, "least_energy"):
        given = f"{design}, which the paper's law does not know"
        yield reading.problem((*section, "design"), given, "least_energy, or the law exact", "leave it out")
    yield from _doubled(reading, (*section, "selected_modes"), "mode")
    n_decomposed = reading.sound(*section, "decomposed_modes")
    for index, label in reading.items(*section, "selected_modes"):
        if n_decomposed is not None and label > n_decomposed:
            given = f"{label}, which is beyond the {n_decomposed} decomposed modes"
            remedy = "raise decomposed_modes or leave it out"
            yield reading.problem((*section, "selected_modes", index), given, f"1 to {n_decomposed}", remedy)
    n_selected = reading.sound(*section, "selected_modes")
    if n_decomposed is not None and isinstance(n_selected, int) and n_selected > n_decomposed:
        given = f"{n_selected}, more than the {n_decomposed} decomposed modes"
        remedy = "raise decomposed_modes or select fewer"
        yield reading.problem((*section, "selected_modes"), given, f"1 to {n_decomposed}", remedy)


def _check_doubles(reading: Reading[Protocol]) -> Iterator[Problem]:
    yield from _doubled(reading, ("conditions", "finger_conditions"), "finger condition")
    yield from _doubled(reading, ("conditions", "peak_velocities_mm_s"), "peak velocity")
    yield from _doubled(reading, ("conditions", "placements"), "placement")
    seen: dict[frozenset[str], int] = {}
    for index, pair in reading.items("conditions", "zone_pairs"):
        path, zones = ("conditions", "zone_pairs", index), frozenset(pair)
        if len(zones) == 1:
            given = f"[{pair[0]}, {pair[1]}], the same zone for both fingers"
            yield reading.problem(path, given, "two different zones")
        elif zones in seen:
            given = f"[{pair[0]}, {pair[1]}], the pair of zone_pairs[{seen[zones]}] again"
            yield reading.problem(path, given, "each pair once", "remove it; for more trials raise repetitions")
        seen.setdefault(zones, index)


def _doubled(reading: Reading[Protocol], path: tuple[str, ...], noun: str) -> Iterator[Problem]:
    seen: dict[object, int] = {}
    for index, value in reading.items(*path):
        if value in seen:
            word = f"{value:g}" if isinstance(value, float) else value
            given = f"{word}, the {noun} of {path[-1]}[{seen[value]}] again"
            yield reading.problem((*path, index), given, f"each {noun} once", "remove it")
        seen.setdefault(value, index)


def _check_schedule(reading: Reading[Protocol]) -> Iterator[Problem]:
    own = ("sensation_levels", "multiples") if reading.sound("conditions", "sensation_levels") else None
    n_pairs, n_levels = (
        len(reading.items("conditions", *keys)) for keys in (("zone_pairs",), own or ("peak_velocities_mm_s",))
    )
    n_blocks = len(reading.items("conditions", "finger_conditions"))
    repetitions = reading.sound("schedule", "repetitions")
    running = reading.sound("schedule", "max_same_pair_running")
    if repetitions is None or not n_pairs or not n_levels:
        return
    n_in_run = reading.sound("adaptive", "trials") if is_adaptive(reading) else None
    n_stimuli = len(reading.sound("stimuli") or ()) or 1
    n_each = n_in_run if is_adaptive(reading) else n_levels * repetitions
    if n_each is None:
        return
    n_driven = n_pairs * n_each * n_stimuli
    n_catch = reading.sound("schedule", "catch_trials") or 0
    if n_catch > n_driven:
        given = f"{n_catch} where {n_driven} trials of a finger condition have a stimulus"
        remedy = "take fewer: each follows a trial with a stimulus"
        yield reading.problem(("schedule", "catch_trials"), given, f"at most {n_driven}", remedy)
    n_trials = (n_driven + n_catch) * max(n_blocks, 1)
    if n_trials > TRIAL_LIMIT:
        given = f"{repetitions}, which makes {n_trials} trials"
        yield reading.problem(("schedule", "repetitions"), given, f"at most {TRIAL_LIMIT} trials", "repeat less often")
    order = reading.sound("schedule", "order")
    if running is not None and order not in ("shuffled", None):
        given = f"{running} with the order {order}"
        path = ("schedule", "max_same_pair_running")
        yield reading.problem(path, given, "null, or the order shuffled", "remove the limit or shuffle")
        return
    faulty = any(problem.path.startswith("conditions.zone_pairs") for problem in reading.problems)
    if running is not None and n_pairs == 1 and not faulty and n_driven > running:
        given = f"{running} where every trial has the same pair"
        allowed = f"at least {n_driven}, or null for no limit"
        path = ("schedule", "max_same_pair_running")
        yield reading.problem(path, given, allowed, "add a pair of zones or lift the limit")


def _check_keys(reading: Reading[Protocol]) -> Iterator[Problem]:
    keys = reading.find(("answers", "keys"))
    given_answers = list(keys.content) if keys is not None and isinstance(keys.content, dict) else None
    for answer in ("left", "both", "right"):
        if given_answers is not None and answer not in given_answers:
            path = ("answers", "keys", answer)
            yield reading.problem(path, "nothing", "a list of keys", f"add the missing key `{answer}`")
    taken: dict[str, str] = {}
    places: dict[str, tuple[str | int, ...]] = {}
    paths = [("answers", "keys", answer) for answer in ("left", "both", "right", "none")]
    for path in paths:
        for index, name in reading.items(*path):
            yield from _check_key(reading, (*path, index), name)
            if name in taken:
                given = f"'{name}', which answers {taken[name]} already"
                yield reading.problem((*path, index), given, "each key for one answer", "remove one of them")
            taken.setdefault(name, path[-1])
            places.setdefault(name, (*path, index))
    for index, name in reading.items("answers", "continue_keys"):
        yield from _check_key(reading, ("answers", "continue_keys", index), name)
        taken.setdefault(name, "to go on")
        places.setdefault(name, ("answers", "continue_keys", index))
    is_written = reading.find(("answers", "emergency_keys")) is not None
    for index, name in reading.items("answers", "emergency_keys"):
        path = ("answers", "emergency_keys", index)
        yield from _check_key(reading, path, name)
        if name in places and not is_written:
            # The fault belongs where somebody wrote it, not at a key that is not in the file.
            given = f"'{name}', which switches the outputs off in an emergency where `emergency_keys` names no other"
            remedy = "choose another, or name another key under `answers.emergency_keys`"
            yield reading.problem(places[name], given, "a key with no other meaning", remedy)
        elif name in taken or name == END_KEY:
            given = f"'{name}', which is needed otherwise"
            yield reading.problem(path, given, "a key with no other meaning, such as f12", "choose another")


def _check_key(reading: Reading[Protocol], path: tuple[str | int, ...], name: str) -> Iterator[Problem]:
    if name in RESERVED_KEYS:
        yield reading.problem(path, f"'{name}', which pauses the session", "any other key", "choose another")
    elif name not in KEY_NAMES:
        meant = KEY_ALIASES.get(name.casefold()) or suggest(name, KEY_NAMES)
        allowed = "left, right, up, down, space, enter, letters, digits, num_0 to num_9, f1 to f20 and the like"
        remedy = f"did you mean '{meant}'?" if meant else "write it in small letters"
        yield reading.problem(path, f"'{name}', which is no key's name", allowed, remedy)


def _check_times(reading: Reading[Protocol]) -> Iterator[Problem]:
    for key in ("presentation_s", "longest_presentation_s", "question_delay_s", "pause_s", "settling_s"):
        value = reading.sound("answers", key)
        if value is not None and value > 600:
            yield reading.problem(("answers", key), f"{value:g} s", "at most 600 s", "shorten it")
