"""What each level does under fingers: speeds, the level that the amplifier allows there, the pull on the contact."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.preflight.design_inputs import DesignInputs
from modaltouch.preflight.figures import by_name, finite, zone_centres
from modaltouch.protocol import Findings
from modaltouch.stimulus import Stimulus

FloatArray = NDArray[np.float64]

Design = tuple[DesignInputs, Stimulus]
"""A stimulus and what it was designed from."""

Figures = dict[str, Any]


def touched_figures(findings: Findings, designs: dict[str, Design]) -> list[dict[str, Figures]]:
    """Return what each level does under the fingers of each placement.

    Parameters
    ----------
    findings : Findings
        The files, with the fingers.
    designs : dict of str to Design
        The design of each placement, by its name; of the untouched beam one, without a name.

    Returns
    -------
    list of dict
        One to each level, by placement, such as ``A-C``: ``zone_at_focus_mm_s`` and ``zone_peak_mm_s``, by zone;
        ``attainable_mm_s``, the level under the finger at the amplifier's limit; ``below_1_kHz_mm_s``, the peak at the
        focus of what swings slower than that; and ``pull_N``, the force by which the contact would have to stick to
        the beam.
    """
    placements = {} if findings.placements is None else findings.placements.all()
    used = {name: _design_at(designs, name) for name in placements}
    beams = {name: used[name][1].touched(laid) for name, laid in placements.items()}
    return [
        {name: _figures(*used[name], beams[name], used[name][0].levels[key] * 1e-3) for name in placements}
        for key in next(iter(designs.values()))[0].levels
    ]


def _design_at(designs: dict[str, Design], placement: str) -> Design:
    """Return the design for a placement: of the same fingers, of the first on the same zones, or the only one."""
    zones = placement.split()[0]
    return designs.get(placement) or next(
        (each for name, each in designs.items() if name.split(" ")[0] == zones), next(iter(designs.values()))
    )


def _figures(inputs: DesignInputs, stimulus: Stimulus, beam: Any, velocity: float) -> Figures:
    zones, centres, unit = list(inputs.apparatus.ordered_zones), zone_centres(inputs), stimulus.volts_per_code(velocity)
    at_focus, peak = beam.velocity_at_focus(centres, unit) * 1e3, beam.peak_velocity(centres, unit) * 1e3
    attainable = at_focus[zones.index(inputs.section.focus)] * stimulus.amplifier.limit
    return {
        "zone_at_focus_mm_s": by_name(zones, at_focus),
        "zone_peak_mm_s": by_name(zones, peak),
        "attainable_mm_s": finite(float(attainable / stimulus.peak_drive(velocity).max())),
        "below_1_kHz_mm_s": finite(beam.peak_below(1e3, inputs.centre_mm * 1e-3, unit) * 1e3),
        "pull_N": finite(float(beam.pull(unit).max())),
    }


def untouched_warning(findings: Findings, inputs: DesignInputs, stimulus: Stimulus) -> str:
    """Return what typical fingers would make of the highest level of a stimulus for the untouched beam."""
    placements, level = findings.under("typical").placements, max(inputs.levels.values())
    unit = stimulus.volts_per_code(level * 1e-3)
    said = []
    for name, laid in ({} if placements is None else placements.all()).items():
        at_focus = stimulus.touched(laid).velocity_at_focus([inputs.centre_mm * 1e-3], unit)
        said.append(f"{at_focus[0] * 1e3:.0f} ({name})")
    return (
        f"untouched beam: with typical fingers the level at {inputs.section.focus} would be {', '.join(said)} mm/s "
        f"instead of {level:g}; `--fingers typical` shows all levels, `stimulus.fingers` designs for them"
    )


def drive_arrays(designs: dict[str, Design]) -> dict[str, FloatArray]:
    """Return what the beam gets at the highest level, for anybody's own model.

    Parameters
    ----------
    designs : dict of str to Design
        Every design of a protocol, by name.

    Returns
    -------
    dict of arrays
        ``time_s``, (n_samples,), the starts of the samples; and ``voltage_V``, (n_channels, n_samples), at the beam, as
        played. Of several designs the first, and each again under ``voltage_V_NAME``; one whose samples differ has
        a ``time_s_NAME``.
    """
    arrays: dict[str, FloatArray] = {}
    for name, (inputs, stimulus) in designs.items():
        voltage = stimulus.voltage_played(max(inputs.levels.values()) * 1e-3)
        time = np.arange(voltage.shape[1], dtype=float) * stimulus.timing.hold + stimulus.amplifier.delay
        if not arrays:
            arrays = {"time_s": time, "voltage_V": voltage}
        if len(designs) > 1:
            arrays[f"voltage_V_{name}"] = voltage
            if not np.array_equal(time, arrays["time_s"]):
                arrays[f"time_s_{name}"] = time
    return arrays
