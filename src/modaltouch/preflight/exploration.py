"""Optional figures of a stimulus: fingers, sensitivity to the identified beam, contrast, samples."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.preflight.single_design import DesignInputs, by_name, finite, zone_centres
from modaltouch.protocol import Findings
from modaltouch.stimulus import Stimulus

Design = tuple[DesignInputs, Stimulus]
"""The inputs of a design, and the stimulus designed from them."""


ERRORS = {"natural_frequency": 0.001, "damping_ratio": 0.05, "modal_gain": 0.05}
"""Relative errors in the sensitivity table [1]."""

SPREAD: dict[str, Any] = {"natural_frequency": 0.001, "damping_ratio": 0.02, "modal_gain": 0.02}
"""Relative standard deviations of randomly drawn beams [1]."""


def sensitivity_figures(inputs: DesignInputs, stimulus: Stimulus) -> dict[str, Any]:
    """Return the sensitivity of the field at the focus to errors of the beam's parameters."""
    from modaltouch.stimulus import focus_sensitivity, scatter

    half = inputs.apparatus.beam.length_mm * 0.5e-3
    rows = focus_sensitivity(stimulus, np.linspace(-half, half, 201), **ERRORS)
    drawn, missed = scatter(stimulus, zone_centres(inputs), **SPREAD)
    return {
        "velocity_mm_s": stimulus.target_field.velocity * 1e3,
        "table": [
            {
                "parameter": row["parameter"],
                "mode": row["mode"],
                "error": row["error"],
                "field_mm_s": float(row["field"]) * 1e3,
                "displacement_mm_s": float(row["displacement"]) * 1e3,
            }
            for row in rows
        ],
        "drawn": {
            "n_draws": len(missed),
            "deviations": SPREAD,
            "zone_deviation_mm_s": dict(
                zip(inputs.apparatus.ordered_zones, (drawn.std(axis=0, ddof=1) * 1e3).tolist(), strict=True)
            ),
            "median_modal_error_mm_s": float(np.median(missed)) * 1e3,
            "p95_modal_error_mm_s": float(np.quantile(missed, 0.95)) * 1e3,
        },
    }


def contrast_figures(designs: dict[str, Design]) -> Iterator[dict[str, Any]]:
    """Yield the contrast between focus and other zone, as designed and at its maximum: two rows per placement.

    Contrast is the peak speed at the focus over that within 5 mm of the other zone's centre, over the whole burst.

    Parameters
    ----------
    designs : dict of str to (DesignInputs, Stimulus)
        Designs by placement, such as ``A-C``; only placements on two zones, one of them the focus, have a contrast.
    """
    known: dict[tuple[int, float], Any] = {}
    for place, (inputs, stimulus) in designs.items():
        focus, zones = inputs.section.focus, place.split(" ")[0].split("-")
        if focus not in zones or len(zones) != 2:
            continue
        centre = inputs.apparatus.zones[zones[zones[0] == focus]].centre_mm * 1e-3
        beam, level = stimulus.touched(stimulus.model.fingers), stimulus.target_field.velocity
        # With symmetric modes only, both halves of the beam move alike.
        key = id(stimulus), abs(centre) if all(label % 2 for label in stimulus.model.label) else centre
        if key not in known:
            known[key] = beam.highest_contrast(inputs.centre_mm * 1e-3, centre + np.linspace(-4e-3, 4e-3, 3), level)
        best, bound = known[key]
        places = [inputs.centre_mm * 1e-3, *(centre + np.linspace(-5e-3, 5e-3, 5))]
        unit = stimulus.volts_per_code(level)
        for name, played, volts, most in (
            ("designed", beam, unit, None),
            ("contrast", best, np.ones(unit.size), bound),
        ):
            peak, *others = played.peak_velocity(places, volts)
            slow, *slow_others = (played.peak_below(1e3, point, volts) for point in places)
            yield {
                "placement": place,
                "design": name,
                "contrast": float(peak / max(others)),
                "bound": most,
                "contrast_below_1_kHz": slow / max(slow_others),
                "focus_below_1_kHz_mm_s": slow * 1e3,
                "peak_drive_V": float((np.abs(played.codes).max(axis=1) * volts).max()),
            }


def sample_figures(inputs: DesignInputs, stimulus: Stimulus, tolerance: float) -> dict[str, Any]:
    """Return the fewest samples that keep the field around the focus within a tolerance.

    Parameters
    ----------
    inputs : DesignInputs
        Inputs of the design.
    stimulus : Stimulus
        The stimulus with the protocol's number of samples.
    tolerance : float
        Allowed change of the field at the zones within 1 ms of the focusing instant, relative to the level [1].

    Raises
    ------
    ValueError
        If the tolerance is not above zero.
    """
    from modaltouch.stimulus import cheapest_samples

    found = cheapest_samples(stimulus, tolerance, zone_centres(inputs))
    return {
        "tolerance": tolerance,
        "n_samples": found.n_samples,
        "error": found.error,
        "tried": [{"n_samples": n, "error": error} for n, error in found.tried],
        "said": str(found),
    }


def touched_figures(findings: Findings, designs: dict[str, Design]) -> list[dict[str, dict[str, Any]]]:
    """Return the predicted figures of each level under the fingers of each placement.

    Parameters
    ----------
    findings : Findings
        The files, with the fingers.
    designs : dict of str to Design
        The design of each placement, by name; a single one with an empty name for the untouched beam.

    Returns
    -------
    list of dict
        For each level, by placement such as ``A-C``: ``zone_at_focus_mm_s`` and ``zone_peak_mm_s``, by zone;
        ``attainable_mm_s``, the level under the finger at the amplifier's limit, 0 if the focus moves in the opposite
        direction; ``below_1_kHz_mm_s``, the peak velocity at the focus below 1 kHz; and ``pull_N``, the adhesive
        force with which the skin would have to stick to the beam.
    """
    placements = {} if findings.placements is None else findings.placements.all()
    # Use the design for the same fingers, else the first for the same zones, else the only one.
    by_zones = {name.split(" ")[0]: each for name, each in reversed(designs.items())}
    used = {
        name: designs.get(name) or by_zones.get(name.split()[0]) or designs[next(iter(designs))] for name in placements
    }
    beams = {name: used[name][1].touched(laid) for name, laid in placements.items()}
    return [
        {name: _figures(*used[name], beams[name], used[name][0].levels[key] * 1e-3) for name in placements}
        for key in next(iter(designs.values()))[0].levels
    ]


def _figures(inputs: DesignInputs, stimulus: Stimulus, beam: Any, velocity: float) -> dict[str, Any]:
    zones, centres, unit = list(inputs.apparatus.ordered_zones), zone_centres(inputs), stimulus.volts_per_code(velocity)
    at_focus, peak = beam.velocity_at_focus(centres, unit) * 1e3, beam.peak_velocity(centres, unit) * 1e3
    attainable = at_focus[zones.index(inputs.section.focus)] * stimulus.amplifier.limit
    return {
        "zone_at_focus_mm_s": by_name(zones, at_focus),
        "zone_peak_mm_s": by_name(zones, peak),
        "attainable_mm_s": finite(max(float(attainable / stimulus.peak_drive(velocity).max()), 0.0)),
        "below_1_kHz_mm_s": finite(beam.peak_below(1e3, inputs.centre_mm * 1e-3, unit) * 1e3),
        "pull_N": finite(float(beam.pull(unit).max())),
    }


def untouched_warning(findings: Findings, inputs: DesignInputs, stimulus: Stimulus) -> str:
    """Return a warning with the highest level under typical fingers, for a stimulus for the untouched beam."""
    placements, level = findings.under("typical").placements, max(inputs.levels.values())
    unit, focus = stimulus.volts_per_code(level * 1e-3), [inputs.centre_mm * 1e-3]
    levels = [
        f"{stimulus.touched(laid).velocity_at_focus(focus, unit)[0] * 1e3:.0f} ({name})"
        for name, laid in ({} if placements is None else placements.all()).items()
    ]
    return (
        f"untouched beam: with typical fingers the level at {inputs.section.focus} would be {', '.join(levels)} mm/s "
        f"instead of {level:g}; `--fingers typical` shows all levels, `stimulus.fingers` designs for them"
    )


def drive_arrays(designs: dict[str, Design]) -> dict[str, NDArray[np.float64]]:
    """Return the drive voltage at the beam at the highest level, for use in other models.

    Parameters
    ----------
    designs : dict of str to Design
        The designs of a protocol, by name.

    Returns
    -------
    dict of arrays
        ``time_s``, (n_samples,), start of each sample at the beam, on the generator's clock; and ``voltage_V``,
        (n_channels, n_samples), played voltage, held until the next sample, before the pole of the amplifier if its
        bandwidth is known. With several designs, these belong to the first, and ``voltage_V_NAME`` holds each design,
        with ``time_s_NAME`` if its samples differ.
    """
    arrays: dict[str, NDArray[np.float64]] = {}
    for name, (inputs, stimulus) in designs.items():
        voltage = stimulus.voltage_played(max(inputs.levels.values()) * 1e-3)
        time = np.arange(voltage.shape[1], dtype=float) * stimulus.timing.hold + stimulus.amplifier.delay
        if stimulus.timing.clock_error is not None:
            time += stimulus.timing.clock_error[:-1]
        if not arrays:
            arrays = {"time_s": time, "voltage_V": voltage}
        if len(designs) > 1:
            arrays[f"voltage_V_{name}"] = voltage
            if not np.array_equal(time, arrays["time_s"]):
                arrays[f"time_s_{name}"] = time
    return arrays
