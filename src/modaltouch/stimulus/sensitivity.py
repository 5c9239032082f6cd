r"""How well a lab must identify its beam: what an error of each parameter does to the field at the focus.

The voltages stay as they were designed; the beam differs. Open loop is limited by identification, not by the
codes: their 1e-13 means nothing without this table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.quantities import ComplexArray, FloatArray
from modaltouch.stimulus.stimulus import Stimulus


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of the state at the focus by relative changes of the parameters, at the reference level.

    A mode depends on its own parameters alone. Each array holds velocities first, then displacements times
    angular frequency.

    Attributes
    ----------
    label : tuple of int
        Label of each mode.
    natural_frequency : (2, n_modes) array
        Per relative change of the natural frequency [m/s].
    damping_ratio : (2, n_modes) array
        Per relative change of the damping ratio [m/s].
    modal_gain : (2, n_modes, n_channels) array
        Per relative change of each channel's gain [m/s].
    """

    label: tuple[int, ...]
    natural_frequency: FloatArray
    damping_ratio: FloatArray
    modal_gain: FloatArray

    def table(
        self,
        shapes: FloatArray,
        *,
        natural_frequency: float = 0.001,
        damping_ratio: float = 0.05,
        modal_gain: float = 0.05,
    ) -> list[dict[str, float | int | str]]:
        """Return what given relative errors do, one row to each parameter of each mode, the worst first.

        Parameters
        ----------
        shapes : (n_modes, n_points) array
            Mode shapes where the field is looked at [1].
        natural_frequency, damping_ratio, modal_gain : float
            Relative errors [1]; the gain's is common to all channels.

        Returns
        -------
        list of dict
            ``parameter``, ``mode``, ``error`` [1], ``field`` (largest change of the velocity at the points
            [m/s]) and ``displacement`` (change of w eta [m/s]).
        """
        highest = np.abs(shapes).max(axis=1)
        effects = {
            "natural_frequency": (natural_frequency, self.natural_frequency),
            "damping_ratio": (damping_ratio, self.damping_ratio),
            "modal_gain": (modal_gain, self.modal_gain.sum(axis=2)),
        }
        rows: list[dict[str, float | int | str]] = [
            {
                "parameter": name,
                "mode": label,
                "error": error,
                "field": float(abs(effect[0, k]) * error * highest[k]),
                "displacement": float(abs(effect[1, k]) * error),
            }
            for name, (error, effect) in effects.items()
            for k, label in enumerate(self.label)
        ]
        return sorted(rows, key=lambda row: -float(row["field"]))


def focus_sensitivity(stimulus: Stimulus) -> Sensitivity:
    r"""Return the derivatives of the state at the focusing instant, in closed form, on the clock as it is.

    With :math:`z = \sum_c G_c [\frac{p}{p+s} r_c(s) - \frac{u_c}{p+s}]`, r the response to the voltages' steps and u
    the amplifier's state, the derivatives follow by the chain rule from ds/dw and ds/dxi.

    Parameters
    ----------
    stimulus : Stimulus
        The design.
    """
    timing, model, s = stimulus.timing, stimulus.model, stimulus.model.exponent
    n_before, remainder = timing.samples_until(timing.focusing_instant - stimulus.amplifier.delay)
    n_begun = min(n_before + (remainder > 0), timing.n_samples)
    ago: FloatArray = np.asarray(remainder + timing.hold * (n_before - np.arange(n_begun)))
    if timing.clock_error is not None:
        ago = np.maximum(ago - timing.clock_error[:n_begun], 0.0)
    step = np.diff(stimulus.voltage[:, :n_begun], axis=1, prepend=0.0)
    reached, slope = _response_to_steps(step, ago, s)
    if stimulus.amplifier.bandwidth is not None:
        pole = 2 * np.pi * stimulus.amplifier.bandwidth
        lagging, _ = _response_to_steps(step, ago, np.array([-pole], dtype=complex))
        left = pole * lagging[0].real
        share = (1 / (pole + s))[:, None]
        slope = pole * share * slope - pole * share**2 * reached + share**2 * left
        reached = pole * share * reached - share * left
    by_channel, slope = model.modal_gain * reached, (model.modal_gain * slope).sum(axis=1)
    ratio = model.damping_ratio
    damped = np.sqrt((1 - ratio) * (1 + ratio))
    read = np.stack([1 + 1j * ratio / damped, -1j / damped])
    read_slope = np.stack([1j / damped**3, -1j * ratio / damped**3])
    along_ratio = model.angular_frequency * (-1 - 1j * ratio / damped)
    return Sensitivity(
        label=model.label,
        natural_frequency=(read * slope * s).real,
        damping_ratio=(ratio * (read_slope * by_channel.sum(axis=1) + read * slope * along_ratio)).real,
        modal_gain=(read[:, :, None] * by_channel).real,
    )


def _response_to_steps(step: FloatArray, ago: FloatArray, exponent: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return x of x' = s x + v, and dx/ds, after steps of v some time ago, two (n_states, n_channels) arrays."""
    reached, slope = np.empty((2, exponent.size, step.shape[0]), dtype=complex)
    for k, s in enumerate(exponent):
        # One state at a time bounds the memory.
        grown = np.expm1(s * ago) / s
        reached[k] = step @ grown
        slope[k] = step @ (ago * np.exp(s * ago) - grown) / s
    return reached, slope


@dataclass(frozen=True, eq=False)
class Scatter:
    """What an uncertain beam makes of a design.

    Attributes
    ----------
    field : (n_draws, n_points) array
        Velocity at the points at the focusing instant [m/s].
    modal_error : (n_draws,) array
        Largest of |velocity - target| and |w eta| over the modes [m/s].
    """

    field: FloatArray
    modal_error: FloatArray

    @property
    def deviation(self) -> FloatArray:
        """Standard deviation of the velocity at each point, (n_points,) array [m/s]."""
        return np.asarray(self.field.std(axis=0, ddof=1))


def scatter(
    stimulus: Stimulus,
    positions: ArrayLike,
    *,
    natural_frequency: float = 0.001,
    damping_ratio: float = 0.02,
    modal_gain: float = 0.02,
    n_draws: int = 200,
    seed: int = 0,
) -> Scatter:
    """Return what beams drawn around the identified one make of the voltages as designed.

    Parameters
    ----------
    stimulus : Stimulus
        The design.
    positions : (n_points,) array_like
        Where the field is looked at, origin at mid-beam [m].
    natural_frequency, damping_ratio, modal_gain : float
        Relative standard deviations, log-normal, each mode on its own [1].
    n_draws : int
        Beams drawn, at least 2.
    seed : int
        Of the random numbers.

    Raises
    ------
    ValueError
        If a deviation is negative, or fewer than two beams are drawn.
    """
    if n_draws < 2:
        raise ValueError(f"{n_draws} beams are drawn; a scatter needs at least 2: draw 200")
    for name, value in (("frequency", natural_frequency), ("damping", damping_ratio), ("gain", modal_gain)):
        if not value >= 0:
            raise ValueError(f"the relative deviation of the {name} is {value}; it must be 0 or above")
    rng = np.random.default_rng(seed)
    model, timing = stimulus.model, stimulus.timing
    shapes = model.shapes(positions)
    field, worst = np.empty((n_draws, shapes.shape[1])), np.empty(n_draws)
    for draw in range(n_draws):
        factor = np.exp(rng.normal(size=(3, model.n_modes)))
        beam = replace(
            model,
            natural_frequency=model.natural_frequency * factor[0] ** natural_frequency,
            damping_ratio=np.minimum(model.damping_ratio * factor[1] ** damping_ratio, 0.999),
            modal_gain=model.modal_gain * (factor[2] ** modal_gain)[:, None],
        )
        system = DiagonalSystem.of(beam, stimulus.amplifier)
        velocity, displacement = system.read(system.state_at(stimulus.voltage, timing, timing.focusing_instant))
        field[draw] = velocity @ shapes
        worst[draw] = max(np.abs(velocity - stimulus.target).max(), np.abs(displacement).max())
    return Scatter(field, worst)
