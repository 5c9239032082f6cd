"""Excitation of an identification, one scan of the beam per actuator set, and the averaged spectra that are kept.

Two excitations are available, with the same period and the same flat spectrum. A *multisine* with random phases excites
all modes at once; a *chirp*, used in the paper, sweeps through them one after the other. This matters with an eight-bit
scope: while the chirp passes a weak mode, one converter step may exceed the whole motion, and averaging cannot recover
it, because all periods are quantised identically. In a multisine the strong modes act as dither for the weak ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.common import ComplexArray, FloatArray
from modaltouch.lab.laboratory import Laboratory
from modaltouch.lab.scan import DESCRIPTION, Scan, ScanPlan, read_facts, row_name, take_scan
from modaltouch.protocol import Apparatus, Source
from modaltouch.rig import Acquisition, Recording, RigError, instrument_of
from modaltouch.stimulus import Burst

N_SAMPLES = 131_072
"""Samples per period of the excitation: the entire memory of the generator."""

RATE = 500e3
"""Sampling rate of the generator [Hz]; the period of 0.262 s gives five bins across a mode 20 Hz wide."""

OVERSAMPLING = 6.25
"""Scope samples per generator sample. The spectral images of the held samples, at multiples of their rate, alias. With
an integer ratio they fold onto the drive itself, where they beat as the two clocks drift (0.013 rad and 0.5 % at 88 kHz
for a ratio of 5 and 5 ppm); a quarter off, they fold onto other bins, with a phase that changes from bin to bin."""

LOWEST = 40.0
"""Lower end of the excitation's band [Hz]."""

HIGHEST = 120e3
"""Highest allowed upper end of the band: about four generator samples per cycle [Hz]."""

N_DRAWS = 30
"""Sets of random phases tried for a multisine; the one with the lowest peak is kept."""

LEVEL = 0.1
"""Nominal level of the excitation as a burst, which is never presented to participants [m/s]."""

Excitation = Literal["multisine", "chirp"]

CLOCK_TOLERANCE = 20e-6
"""Largest relative difference between the clocks of scope and generator, from their data sheets [1]."""

HEADROOM = 1.5
"""Input range of the vibrometer relative to the peak measured at the end of the beam or predicted for a probe [1]."""


def excite(apparatus: Apparatus, set_name: str, voltage: float, highest: float, kind: Excitation = "chirp") -> Burst:
    """Return a periodic excitation of one actuator set, with the other channel at zero.

    Parameters
    ----------
    apparatus, set_name
        Amplifier and actuator sets, and the set that is driven.
    voltage, highest : float
        Peak at the beam [V], and upper end of the spectrum [Hz].
    kind : str
        ``chirp`` (linear) or ``multisine`` (random phases with a fixed seed).

    Raises
    ------
    ValueError
        If the voltage or the frequency is out of bounds.
    """
    limit = apparatus.amplifier.limit_V
    if not 0 < voltage <= limit:
        raise ValueError(
            f"an excitation of {voltage:g} V was requested: allowed above 0 and up to {limit:g} V at the beam"
        )
    if not 10 * LOWEST < highest <= HIGHEST:
        raise ValueError(
            f"an excitation up to {highest * 1e-3:g} kHz was requested: allowed {LOWEST / 100:g} to {HIGHEST / 1e3:g} "
            "kHz"
        )
    duration = N_SAMPLES / RATE
    wave = chirp(highest) if kind == "chirp" else multisine(highest)
    given = np.zeros((2, N_SAMPLES))
    given[apparatus.actuator_sets[set_name].channel - 1] = voltage * wave
    level = min(LEVEL, apparatus.safety.velocity_limit_mm_s * 1e-3)
    converter = instrument_of(apparatus).converter
    return Burst.holding(given, apparatus.to_beam, level, converter, duration, 1 / duration)


def chirp(highest: float) -> NDArray[np.float64]:
    """Return a linear chirp of peak 1 with equal initial and final phase, (N_SAMPLES,) array."""
    duration = N_SAMPLES / RATE
    cycles = round((LOWEST + highest) / 2 * duration)
    last = 2 * cycles / duration - LOWEST
    time = np.arange(N_SAMPLES) / RATE
    return np.asarray(np.sin(2 * np.pi * (LOWEST * time + (last - LOWEST) * time**2 / (2 * duration))))


def multisine(highest: float) -> NDArray[np.float64]:
    """Return equal sines at all multiples of 1/period within the band, with a total peak of 1, (N_SAMPLES,) array."""
    line = np.arange(N_SAMPLES // 2 + 1) * RATE / N_SAMPLES
    lines = (line >= LOWEST) & (line <= highest)
    rng = np.random.default_rng(0)
    drawn = (np.fft.irfft(lines * np.exp(2j * np.pi * rng.random(line.size)), N_SAMPLES) for _ in range(N_DRAWS))
    # All candidates have the same power.
    best = min(drawn, key=lambda wave: float(np.abs(wave).max()))
    return np.asarray(best / np.abs(best).max())


@lru_cache(maxsize=1)
def _turns(n_samples: int, n_lines: int) -> ComplexArray:
    """Return the factors of `low_lines`, (n_lines, r) array; the records of a scan have the same length everywhere."""
    n_parts = next(r for r in (8, 4, 2, 1) if n_samples % r == 0 and (r == 1 or n_samples >= 2 * r * n_lines))
    turns = np.outer(np.arange(1, n_lines + 1) / n_samples, np.arange(n_parts))
    return np.asarray(np.exp(-2j * np.pi * turns).astype(np.complex64))


def low_lines(record: FloatArray, n_lines: int) -> ComplexArray:
    r"""Return the lowest lines of a Fourier transform, from the first one above 0 Hz, by decimation in time.

    With :math:`Y_s` the transform of every r-th sample from s on, :math:`X_k = \sum_s e^{-2\pi i k s/n} Y_s(k)`. The r
    short transforms fit into the cache and take a quarter of the time of the full one, of which few lines are needed.
    Rounding to single precision adds a millionth of the converter's noise.
    """
    from scipy.fft import rfft

    turns = _turns(record.size, n_lines)
    parts = rfft(record.astype(np.float32).reshape(-1, turns.shape[1]), axis=0)[1 : n_lines + 1]
    return np.asarray(np.einsum("kr,kr->k", parts, turns), dtype=complex)


class Spectra:
    """Reduction of a recording of a periodic excitation to auto- and cross-spectra, averaged over its records.

    Parameters
    ----------
    highest : float
        Highest frequency kept [Hz].
    """

    __name__ = "spectra"

    def __init__(self, highest: float) -> None:
        self.highest = highest

    def __call__(self, recording: Recording) -> Mapping[str, NDArray[Any]]:
        """Return the averaged spectra of the velocity and the first drive."""
        n = recording.time.size
        frequency = np.fft.rfftfreq(n, 1 / recording.sampling_rate)
        frequency = frequency[1 : int(np.searchsorted(frequency, self.highest, side="right"))]
        # Process one record at a time: all together would take a hundred megabytes.
        velocity, drive = (
            np.array([low_lines(record, frequency.size) for record in records]) / n
            for records in (recording.velocity, recording.drive[:, 0])
        )
        return {
            "frequency": frequency,
            "drive_power": (np.abs(drive) ** 2).mean(axis=0),
            "velocity_power": (np.abs(velocity) ** 2).mean(axis=0),
            "cross_power": (np.conj(drive) * velocity).mean(axis=0),
            "n_records": np.array(recording.velocity.shape[0]),
        }


@dataclass(frozen=True)
class IdentificationPlan:
    """Measurement plan of an identification."""

    positions: tuple[float, ...]  # positions along the beam, origin at mid-beam [m]
    averages: int  # records at each position
    voltage: float  # peak of the excitation at the beam [V]
    highest: float  # upper end of the excitation's band [Hz]
    sets: tuple[str, ...]  # actuator sets, one after the other
    excitation: Excitation = "multisine"  # ``multisine`` or ``chirp``
    across: float = 0.0  # offset of the row of positions from the beam's mid-line [m]

    def scan(self, laboratory: Laboratory, source: Source, folder: Path | None) -> dict[str, Scan]:
        """Take the scans of all sets, resuming interrupted ones.

        Parameters
        ----------
        laboratory : Laboratory
            Opened with ``repetition="continuous"``.
        source : Source
            The apparatus file.
        folder : Path or None
            Parent folder with one folder per set; None to write nothing.

        Raises
        ------
        RigError
            If the rig fails, a drive does not reach its set, or an input was overloaded.
        RecordError
            If a folder holds another scan.
        """
        scans: dict[str, Scan] = {}
        for name in self.sets:
            place = None if folder is None else folder / row_name(f"scan_{name}", self.across)
            plan, reduction = self._plan(laboratory, name, place), Spectra(self.highest)
            step = row_name(f"points, {name}", self.across)
            scans[name] = take_scan(laboratory, plan, place, source=source, reduction=reduction, step=step)
        return scans

    def _plan(self, laboratory: Laboratory, name: str, place: Path | None) -> ScanPlan:
        apparatus = laboratory.apparatus
        burst = excite(apparatus, name, self.voltage, self.highest, self.excitation)
        channel = apparatus.actuator_sets[name].channel
        asked = Acquisition(
            sampling_rate=OVERSAMPLING * RATE,
            n_samples=int(OVERSAMPLING * N_SAMPLES),
            n_records=self.averages,
            drives=(channel,),
            drive_range=1.25 * self.voltage,
        )
        about = {
            "stimulus": f"periodic {self.excitation}",
            "actuator_set": name,
            "voltage_V": self.voltage,
            "highest_Hz": self.highest,
        }
        plan = ScanPlan(burst, burst.velocity, self.positions, asked, about, self.across)
        if place is not None and (place / DESCRIPTION).exists():
            # A resumed scan keeps its original range.
            recorded = read_facts(place)["settings"]["acquisition"]["velocity_range"]
            return replace(plan, acquisition=replace(asked, velocity_range=recorded))
        return replace(plan, acquisition=_with_range(laboratory, plan, name, self.voltage))


def _with_range(laboratory: Laboratory, plan: ScanPlan, name: str, voltage: float) -> Acquisition:
    """Check that the drive reaches its set, and return the acquisition with the range needed at the end of the beam."""
    asked = plan.acquisition
    laboratory.load(plan.burst)
    end = max(plan.positions, key=abs)
    seen = laboratory.record(end, plan.velocity, replace(asked, n_records=1), plan.across)
    wave = plan.burst.converter.signed(plan.burst.codes) / plan.burst.converter.mid_code
    measured = float(np.sqrt((seen.drive**2).mean() / (wave**2).sum(axis=0).mean()))
    if not 0.5 * voltage <= measured <= 2 * voltage:
        raise RigError(
            f"the drive of the actuator set {name} measures {measured:.3g} V peak, but {voltage:g} V were played; the "
            "outputs are off; check the amplifier, the probe on this set's drive and its attenuation in the "
            "apparatus file"
        )
    limit = laboratory.apparatus.safety.velocity_limit_mm_s * 1e-3
    highest = float(np.abs(seen.velocity).max())
    if highest > limit:
        raise RigError(
            f"the excitation moves the end of the beam at {highest * 1e3:.0f} mm/s, but the safety limit is "
            f"{limit * 1e3:g}; the outputs are off; lower --drive-V"
        )
    if seen.overloaded:
        raise RigError(
            f"{', '.join(seen.overloaded)} was overloaded at {end * 1e3:g} mm, so its peak is unknown; measure with a "
            "wider range or a lower drive"
        )
    # Overload is checked in every record, so the vibrometer's full range is always sufficient.
    widest = laboratory.apparatus.acquisition.range_mm_s * 1e-3
    return replace(asked, velocity_range=min(HEADROOM * highest, widest) if highest > 0 else None)


def evenly(length: float, n_points: int, margin: float) -> tuple[float, ...]:
    """Return evenly spaced positions along a beam, with a margin at both ends [m]."""
    if not 0 <= margin < length / 4:
        raise ValueError(f"a margin of {margin * 1e3:g} mm was given: allowed 0 to {length * 250:g} mm")
    return tuple(float(each) for each in np.linspace(-length / 2 + margin, length / 2 - margin, n_points))


def highest_needed(apparatus: Apparatus) -> float:
    """Return the upper end of the excitation: a quarter above the highest mode of the table, within its bounds [Hz]."""
    above = 1.25 * max(mode.natural_frequency_Hz for mode in apparatus.modes)
    return float(min(HIGHEST, max(above, 20 * LOWEST)))
