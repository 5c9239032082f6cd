r"""Inverse filtering: the drives whose response, as recorded, is the wished one in the sense of least squares.

**Throughout.** At every frequency the responses of the M control points to the C outputs are a matrix H, the wished
velocities a vector U. The drives are those of Tikhonov's regularised inverse,

.. math:: V = (H^* H + \beta I)^{-1} H^* U,

brought back into time. What is wished is a pulse in the shape of the wished field at the focusing instant, and rest
at every other time. Between frequencies there is nothing to choose, so a few outputs are asked for more than they
can do, and the whole becomes a compromise.

**At one instant.** Only the field at the focusing instant is asked for. With R the recorded responses at that instant
to a volt in each step before it, the drive is

.. math:: v = R^T (R R^T + \beta I)^{-1} f,

the least energy that makes the wished field at the control points, but for what :math:`\beta` gives up. It is the
exact law without a model: the recorded noise takes the place of its modes, and what moves at that instant between
and beyond the points, or at rest with a displacement, is not asked for.

References
----------
L. Pantera, C. Hudin, "Sparse Actuator Array Combined with Inverse Filter for Multitouch Vibrotactile Stimulation",
IEEE World Haptics Conference, 2019; the same, "Multitouch Vibrotactile Feedback on a Tactile Screen by the Inverse
Filter Technique: Vibration Amplitude and Spatial Resolution", IEEE Trans. Haptics 13(3), 493-503, 2020; M. Tanter,
J.-L. Thomas, M. Fink, "Time reversal and the inverse filter", J. Acoust. Soc. Am. 108, 223, 2000; O. Kirkeby et al.,
"Fast deconvolution of multichannel systems using regularization", IEEE Trans. Speech Audio Process. 6(2), 1998.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.comparison.training_data import TrainingData

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

PULSES = (44e-6, 88e-6, 176e-6, 352e-6)
"""Widths of the wished pulse that are tried, raised cosines; 88 us stay above 90 % as long as the paper's focus [s]."""

STRENGTHS = 10.0 ** np.arange(-5.0, 0.01, 0.5)
"""Regularisations that are tried, over the largest squared singular value [1]."""

ABOVE_NOISE = 10.0
"""How many times the noise a direction must be to count in the inverse filter at one instant [1]."""

STRONGER = 8
"""How often that is raised tenfold at most."""

ENDS = 1e-3
"""Length of the taper at either end of a burst [s]."""


def inverse_filter(known: TrainingData) -> FloatArray:
    """Return the drives of the inverse filter at the level or the limit, (n_channels, n_samples) array at the beam [V].

    Of the pulses in `PULSES` and the regularisations in `STRENGTHS` those which come closest to the wished field at
    the focusing instant, by the recordings, among those within the voltage limit; where none are, those that need
    the least.
    """
    step, n_before = known.step, known.n_before
    n_after = (known.timing.n_samples - n_before * known.stride) // known.stride
    taper = _taper(n_before + n_after, round(ENDS / step))
    # The drive is linear in the spectrum of the pulse, which is the same for all control points.
    wished = np.broadcast_to(known.wished()[:, None], known.responses.response.shape[1:]).astype(complex)
    candidates = []
    for strength in STRENGTHS:
        unit = regularised_inverse(known.responses.response, wished, strength)
        for width in PULSES:
            spectrum = unit * _pulse(known.responses.frequency, width, known.timing.focusing_instant)
            drive = known.responses.in_time(spectrum, step / 2, step, n_before + n_after) * taper
            field = known.expected(drive[:, :n_before])
            if field[known.focus] <= 0:
                continue
            factor = known.wish.velocity / float(field[known.focus])
            missed = float(np.sqrt(np.mean((field * factor - known.wished()) ** 2)))
            needed = float(np.abs(drive).max()) * factor
            beyond = needed > known.amplifier.limit
            candidates.append((beyond, needed if beyond else missed, drive))
    if not candidates:
        raise ValueError("no inverse filter moves the focus: record a point that moves, or choose another focus")
    best = min(candidates, key=lambda each: each[:2])[2]
    return known.to_level(best[:, :n_before], best[:, n_before:])


def _pulse(frequency: FloatArray, width: float, instant: float) -> ComplexArray:
    """Return the spectrum of a raised cosine of height 1 and some width at an instant, (n_bins,) array [1/Hz]."""
    turns = frequency * width
    # Of a raised cosine: a sinc and its two neighbours.
    height = width / 2 * (np.sinc(turns) + 0.5 * np.sinc(turns - 1) + 0.5 * np.sinc(turns + 1))
    return np.asarray(height * np.exp(-2j * np.pi * frequency * instant))


def regularised_inverse(response: ComplexArray, wished: ComplexArray, strength: float) -> ComplexArray:
    r"""Return :math:`(H^* H + \beta I)^{-1} H^* U` at every frequency, (n_channels, n_bins) array.

    Parameters
    ----------
    response : (n_channels, n_points, n_bins) complex array
        H, transposed [m/s per V].
    wished : (n_points, n_bins) complex array
        U [m/s per Hz].
    strength : float
        :math:`\beta` over the largest eigenvalue of :math:`H^* H` at any frequency [1].
    """
    H = np.moveaxis(response, 2, 0).swapaxes(1, 2)
    adjoint = H.conj().swapaxes(1, 2)
    gram = adjoint @ H
    beta = strength * float(np.linalg.norm(gram, 2, axis=(1, 2)).max())
    right = (adjoint @ wished.T[:, :, None])[:, :, 0]
    if strength == 0:
        return np.asarray(np.linalg.solve(gram, right[:, :, None])[:, :, 0].T)
    return np.asarray(np.linalg.solve(gram + beta * np.eye(gram.shape[1]), right[:, :, None])[:, :, 0].T)


def inverse_filter_at_instant(known: TrainingData) -> FloatArray:
    r"""Return the drives of least energy that make the wished field at the focusing instant, at the level or the limit.

    Noise adds to :math:`R R^T` what is known of it from record to record, on the average on its diagonal alone: that
    is the regularisation. Directions that do not stand ABOVE_NOISE out of it are left out, since a drive that leans on
    them leans on noise; more are where it would pass the voltage limit.

    Returns
    -------
    (n_channels, n_samples) array
        Voltages of the whole burst at the beam; 0 after the focusing instant [V].
    """
    noise = float(known.responses.noise_towards(known.n_before * known.step, known.step).sum()) * known.n_before
    wished, towards = known.wished(), known.towards
    strength, direction = np.linalg.eigh(np.einsum("cmj,cnj->mn", towards, towards, optimize=True))
    for floor in noise * ABOVE_NOISE * 10.0 ** np.arange(STRONGER):
        # The strongest direction is kept whatever the noise.
        kept = direction[:, (strength > floor) | (strength == strength.max())]
        steps = least_energy(towards, wished, noise, kept)[:, ::-1]
        reached = float(known.expected(steps)[known.focus])
        if reached > 0 and float(np.abs(steps).max()) * known.wish.velocity / reached <= known.amplifier.limit:
            break
    return known.to_level(steps)


def least_energy(towards: FloatArray, wished: FloatArray, beta: float, kept: FloatArray | None = None) -> FloatArray:
    r"""Return :math:`R^T (R R^T + \beta I)^{-1} f`, (n_channels, n_steps) array [V].

    Parameters
    ----------
    towards : (n_channels, n_points, n_steps) array
        R [m/s per V].
    wished : (n_points,) array
        f [m/s].
    beta : float
        What is given up for energy [(m/s per V)^2].
    kept : (n_points, n_kept) array, optional
        Orthonormal directions in which the field is made; all, if not given [1].
    """
    kept = np.eye(wished.size) if kept is None else kept
    within = np.einsum("mk,cmj->ckj", kept, towards, optimize=True)
    gram = np.einsum("ckj,clj->kl", within, within, optimize=True)
    weight = np.linalg.lstsq(gram + beta * np.eye(gram.shape[0]), kept.T @ wished, rcond=None)[0]
    return np.asarray(np.einsum("ckj,k->cj", within, weight))


def _taper(n: int, n_end: int) -> FloatArray:
    """Return ones with raised-cosine ends, (n,) array [1]."""
    window = np.ones(n)
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(n_end) + 0.5) / max(1, n_end))
    window[:n_end], window[n - n_end :] = ramp, ramp[::-1]
    return window
