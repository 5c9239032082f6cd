"""The comparison: measurement of the beam, design of all drives, and their evaluation on the twin's true beam.

No method has access to the true values used for the evaluation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modaltouch.lab.common import FloatArray, low_pass
from modaltouch.lab.focusing_methods import MethodDrive, TrainingData, TransferFunctions, design_all
from modaltouch.lab.identification.excitation import LOWEST, IdentificationPlan, evenly, highest_needed
from modaltouch.lab.identification.joint_fit import identify
from modaltouch.lab.identification.modal_parameters import Identification
from modaltouch.lab.identification.responses import FrequencyResponses, responses_of
from modaltouch.lab.identification.verdict import check_modes, misfit_verdict, warnings
from modaltouch.lab.laboratory import SILENT_PROGRESS, MeasurementProgress, open_laboratory
from modaltouch.lab.validation.evidence import contrast, root_mean_square, spot_width
from modaltouch.preflight import Preflight, finite
from modaltouch.protocol import Apparatus
from modaltouch.rig import RigError, Simulator
from modaltouch.stimulus import ModalModel

POINTS = 201
"""Number of points along the beam at which a field is evaluated."""

PLACES = 41
"""Number of points along the beam at which the highest speed is evaluated."""


@dataclass(frozen=True, eq=False)
class DriveAssessment:
    """The effect of a drive."""

    # position, field, (POINTS,): the true field at the focusing instant [m, m/s]
    position: FloatArray
    field: FloatArray
    row: dict[str, Any]  # plain key figures by their names in the tables


def assess(rig: Simulator, preflight: Preflight, *, everywhere: bool = True) -> DriveAssessment:
    """Evaluate the effect of a generator's output on a beam, in the steady state of repeated bursts.

    The field is evaluated after the focusing instant by the amplifier's true delay and lag. These are unknown to all
    methods, delay all drives equally, and amount to imperceptible microseconds.

    Parameters
    ----------
    rig : Simulator
        True beam and amplifier, with the generator's output.
    preflight : Preflight
        The protocol, with the stimulus, zones and pairs used for the evaluation.
    everywhere : bool
        Whether to evaluate the highest speed along the whole beam, the slowest part.
    """
    twin, playbacks = rig.twin, rig.playbacks
    stimulus, target = preflight.stimulus, preflight.stimulus.target_field
    zones = {name: zone.centre_mm * 1e-3 for name, zone in preflight.experiment.apparatus.zones.items()}
    half = twin.beam.table.length / 2
    position = np.linspace(-half, half, POINTS)
    state = twin.true_state(playbacks, stimulus.timing.focusing_instant + true_delay(rig))
    velocity = np.concatenate([state.velocity, state.unlisted_velocity])
    field = velocity @ twin.beam.shapes(position)
    miss = field - target.velocity * target.profile(position)
    felt = twin.felt(playbacks, list(zones.values())) * 1e3
    zone_peak = dict(zip(zones, felt.tolist(), strict=True))
    places = np.linspace(-half, half, PLACES).tolist()
    pairs = preflight.experiment.protocol.conditions.pairs
    row = {
        "at_focus_mm_s": float(velocity @ twin.beam.shapes(target.centre)[:, 0]) * 1e3,
        "rms_error_mm_s": root_mean_square(miss) * 1e3,
        "max_error_mm_s": float(np.abs(miss).max()) * 1e3,
        "rms_from_selected_mm_s": root_mean_square(field - stimulus.projection.field(position)) * 1e3,
        "width_50_mm": finite(spot_width(position, field, target.centre, 0.5) * 1e3),
        "width_80_mm": finite(spot_width(position, field, target.centre, 0.8) * 1e3),
        "highest_at_focus_mm_s": zone_peak[preflight.experiment.protocol.stimulus.focus],
        "highest_mm_s": float(twin.felt(playbacks, places).max()) * 1e3 if everywhere else None,
        "zone_peak_mm_s": zone_peak,
        **{f"contrast_{a}_{b}": finite(contrast(zone_peak[a], zone_peak[b])) for a, b in pairs},
    }
    return DriveAssessment(position, field, row)


def true_delay(rig: Simulator) -> float:
    """Return the amplifier's total delay: its pure delay plus the lag of its pole [s]."""
    bandwidth = rig.twin.amplifier.bandwidth
    return rig.twin.amplifier.delay + (0.0 if bandwidth is None else 1 / (2 * math.pi * bandwidth))


VOLTAGE = 10.0
"""Peak of the excitation at the beam [V]."""


@dataclass(frozen=True, eq=False)
class Contest:
    """Results of the methods on one beam, and on others that differ from it."""

    preflight: Preflight  # the protocol
    known: TrainingData  # the data available to each method
    designed: tuple[MethodDrive, ...]  # drives of the methods
    verdicts: tuple[DriveAssessment, ...]  # effect of each drive on the measured beam
    # effect of each drive on every other beam, drawn at random around the measured one
    changed: tuple[tuple[DriveAssessment, ...], ...]


def training_data(preflight: Preflight, responses: FrequencyResponses) -> TrainingData:
    """Identify the modes from responses, and return what every method may know.

    Parameters
    ----------
    preflight : Preflight
        The protocol, examined.
    responses : FrequencyResponses
        Recordings, as returned by `learn`.

    Raises
    ------
    ValueError
        If a mode of the table was not found or fits badly; the values of the table are those of the true beam and must
        not be used instead.
    """
    apparatus, stimulus = preflight.experiment.apparatus, preflight.stimulus
    excited = responses.between(LOWEST, float(responses.frequency[-1]))
    identification = identify(excited, apparatus.beam.length_mm * 1e-3)
    check_modes(identification, apparatus.modal_model().label)
    return TrainingData(
        model=identified_model(identification, apparatus),
        responses=for_rivals(responses, identification.delay.value, apparatus),
        target_field=stimulus.target_field,
        timing=stimulus.timing,
        amplifier=stimulus.amplifier,
        release=stimulus.release,
        load_factor=stimulus.load_factor,
        delay=identification.delay.value,
        quality=(misfit_verdict(identification), *warnings(identification)),
    )


def contest(
    preflight: Preflight,
    known: TrainingData,
    *,
    n_beams: int,
    seed: int = 1,
    progress: MeasurementProgress = SILENT_PROGRESS,
) -> Contest:
    """Design a drive with every method, play it on the twin, and evaluate it on its beam and on others.

    Parameters
    ----------
    preflight : Preflight
        The protocol, examined.
    known : TrainingData
        The data available to each method.
    n_beams, seed : int
        Number of further beams on which the drives are played, and the seed of the first; the others have the following
        seeds.
    progress : MeasurementProgress, optional
        Reports progress and lets the user interrupt.

    Raises
    ------
    RigError
        If the twin's generator does not confirm a drive.
    """
    apparatus, stimulus = preflight.experiment.apparatus, preflight.stimulus
    centre = without_mismatch(apparatus)
    designed = design_all(known)
    sent = _play(centre, designed, stimulus.target_field.velocity, progress)
    verdicts = [assess(each.on_beam(centre, seed), preflight) for each in sent]
    changed: list[list[DriveAssessment]] = [[] for _ in designed]
    for number in range(n_beams):
        progress.check()
        for own, each in zip(changed, sent, strict=True):
            own.append(assess(each.on_beam(apparatus, seed + number), preflight, everywhere=False))
        progress.show("other beams", number + 1, n_beams)
    return Contest(preflight, known, tuple(designed), tuple(verdicts), tuple(map(tuple, changed)))


def without_mismatch(apparatus: Apparatus) -> Apparatus:
    """Return an apparatus whose twin has the parameters of the table, with everything else unchanged."""
    centred = apparatus.twin.model_copy(
        update={
            "natural_frequency_mismatch": 0.0,
            "damping_ratio_mismatch": 0.0,
            "gain_mismatch": 0.0,
            "generator_gain_mismatch": 0.0,
        }
    )
    return apparatus.model_copy(update={"twin": centred})


def learn(
    preflight: Preflight,
    *,
    n_points: int,
    n_records: int,
    progress: MeasurementProgress = SILENT_PROGRESS,
) -> FrequencyResponses:
    """Measure the responses used as training data by every method, with a multisine on each actuator set.

    The measured beam is the centre of the others: the apparatus without the mismatch of its ``twin``, but with its
    unlisted modes, amplifier, vibrometer and scope. Hence no method has an advantage on the other beams.

    Parameters
    ----------
    preflight : Preflight
        The protocol, examined.
    n_points, n_records : int
        Control points along the beam, and records at each.
    progress : MeasurementProgress, optional
        Reports progress and lets the user interrupt.
    """
    apparatus, source = without_mismatch(preflight.experiment.apparatus), preflight.experiment.sources.apparatus
    highest = highest_needed(apparatus)
    sets = tuple(sorted(apparatus.actuator_sets, key=lambda name: apparatus.actuator_sets[name].channel))
    places = tuple(round(place, 9) for place in evenly(apparatus.beam.length_mm * 1e-3, n_points, 0.0))
    campaign = IdentificationPlan(places, n_records, VOLTAGE, highest, sets)
    with open_laboratory(apparatus, progress=progress, repetition="continuous") as laboratory:
        corner = apparatus.acquisition.vibrometer_bandwidth_kHz
        return responses_of(campaign.scan(laboratory, source, None), None if corner is None else corner * 1e3)


def identified_model(found: Identification, apparatus: Apparatus) -> ModalModel:
    """Return the modes of the table with the identified values; all must have been found."""
    table = apparatus.modal_model()
    modes, gain = [found.by_label[label] for label in table.label], table.modal_gain.copy()
    channels = [apparatus.actuator_sets[name].channel - 1 for name in found.responses.sets]
    gain[:, channels] = [[estimate.value for estimate in mode.gain] for mode in modes]
    frequency, ratio = np.array([(mode.natural_frequency.value, mode.damping_ratio.value) for mode in modes]).T
    return replace(table, natural_frequency=frequency, damping_ratio=ratio, modal_gain=gain)


def band(frequency: FloatArray, lowest: float, highest: float) -> FloatArray:
    """Return a window over frequency with raised-cosine flanks [1].

    Parameters
    ----------
    frequency : array_like
        Frequencies [Hz].
    lowest, highest : float
        The window is 1 between them; it rises from half of `lowest`, and falls to 0 at 1.1 times `highest` [Hz].
    """
    f = np.asarray(frequency, dtype=float)
    rise = np.clip((f - lowest / 2) / (lowest / 2), 0, 1)
    fall = np.clip((1.1 * highest - f) / (0.1 * highest), 0, 1)
    return np.asarray((0.5 - 0.5 * np.cos(np.pi * rise)) * (0.5 - 0.5 * np.cos(np.pi * fall)))


def for_rivals(responses: FrequencyResponses, delay: float, apparatus: Apparatus) -> TransferFunctions:
    """Return the responses by generator output, in the band of the listed modes, without the vibrometer's delay.

    Its low-pass is removed too, if the apparatus lists it.
    """
    table = apparatus.modal_model()
    frequencies = table.natural_frequency
    window = band(responses.frequency, float(frequencies.min()) / 2, 1.1 * float(frequencies.max()))
    window = window * np.exp(2j * np.pi * responses.frequency * delay)
    window = window / low_pass(responses.frequency, responses.bandwidth)
    response = np.zeros((table.n_channels, responses.n_points, responses.frequency.size), dtype=complex)
    response[[apparatus.actuator_sets[name].channel - 1 for name in responses.sets]] = responses.response * window
    return TransferFunctions(responses.frequency, response, np.array(responses.places)[:, 0])


def _play(
    apparatus: Apparatus, designed: list[MethodDrive], velocity: float, progress: MeasurementProgress
) -> list[Simulator]:
    """Play every drive at the level through the driver, and return a twin with this output for each."""
    sent: list[Simulator] = []
    with open_laboratory(apparatus) as laboratory:
        if laboratory.simulator is None:
            raise RigError("a comparison needs the twin, since its true beam is the reference; the outputs are off")
        for number, each in enumerate(designed, 1):
            progress.check()
            laboratory.load(each.burst)
            firing = laboratory.rig.fire(velocity)
            if not firing.started:
                raise RigError(f"the generator does not confirm the drive of {each.method.name}: {firing.reason}")
            sent.append(laboratory.simulator.on_beam(apparatus))
            laboratory.rig.stop()
            progress.show("drives played", number, len(designed))
    return sent
