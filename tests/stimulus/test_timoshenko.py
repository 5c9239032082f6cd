"""Timoshenko bending against independent solutions, published formulas, a measured bar and the slender limit."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest
from numpy.polynomial import chebyshev
from scipy.linalg import eig
from scipy.optimize import brentq

from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier
from modaltouch.stimulus.other_shapes import TimoshenkoBeam
from modaltouch.stimulus.shapes import characteristic_root, mode_shapes
from modaltouch.stimulus.stimulus import design_stimulus
from modaltouch.stimulus.target_field import Projection, TargetField

SHIPPED = TimoshenkoBeam(length=0.1, thickness=2e-3)
THICK = TimoshenkoBeam(length=0.1, thickness=0.02)
YOUNGS_MODULUS, DENSITY = 70e9, 2700.0


def hertz(beam, bending):
    """Return the natural frequency of a bending mode of an aluminium beam [Hz]."""
    wave_speed = np.sqrt(YOUNGS_MODULUS / DENSITY)
    return beam._root(bending) * np.sqrt(beam.rotary) * wave_speed / (2 * np.pi * beam.length)


def spectral_parameters(beam, n):
    """Return frequency parameters b of a free-free beam by Galerkin in Chebyshev polynomials of W and Psi.

    Potential energy 1/2 int Psi'^2 + (W' - Psi)^2 / s^2, kinetic energy b^2/2 int W^2 + r^2 Psi^2: free ends
    are the natural boundary conditions, so that nothing is imposed.
    """
    node, weight = np.polynomial.legendre.leggauss(2 * n)
    values = chebyshev.chebvander(node, n - 1)
    slopes = np.stack([chebyshev.chebval(node, chebyshev.chebder(row)) for row in np.eye(n)], axis=1) * 2
    weight = weight[:, None] / 2
    zero = np.zeros((n, n))
    bend = slopes.T @ (weight * slopes)
    cross = -slopes.T @ (weight * values) / beam.shear
    mass = values.T @ (weight * values)
    stiffness = np.block([[bend / beam.shear, cross], [cross.T, bend + mass / beam.shear]])
    inertia = np.block([[mass, zero], [zero, beam.rotary * mass]])
    square = np.sort(eig(stiffness, inertia, right=False).real)
    return np.sqrt(np.maximum(square, 0.0))[2:]


@pytest.mark.parametrize("beam", [SHIPPED, THICK], ids=["2 mm", "20 mm"])
def test_frequencies_match_a_spectral_solution(beam):
    """Galerkin in 40 Chebyshev polynomials, free ends as natural boundary conditions; past the cut-off as well."""
    unit = np.sqrt(beam.rotary * YOUNGS_MODULUS / DENSITY) / (2 * np.pi * beam.length)
    expected = spectral_parameters(beam, 40) * unit
    found = sorted(hertz(beam, n) for n in range(1, 13))
    assert found == pytest.approx(expected[:12], rel=1e-7)
    cut_off = unit / np.sqrt(beam.rotary * beam.shear)
    assert (found[-1] > cut_off) == (beam is THICK)


def free_free_determinant(beam, b):
    """Return the 4 x 4 determinant of both free ends in 40 digits, from exponentials e^(ky) as they come.

    k^4 + b^2 (r^2 + s^2) k^2 + b^2 (b^2 r^2 s^2 - 1) = 0; no moment, (k^2 + b^2 s^2) e^(ky), and no shear force,
    e^(ky) / k, at y = -1/2 and 1/2.
    """
    with mpmath.workdps(40):
        b, r2, s2 = mpmath.mpf(b), mpmath.mpf(beam.rotary), mpmath.mpf(beam.shear)
        half, rest = b**2 * (r2 + s2) / 2, b**2 * (b**2 * r2 * s2 - 1)
        root = mpmath.sqrt(half**2 - rest)
        squares = (-half + root, -half - root)
        wave = [sign * mpmath.sqrt(mpmath.mpc(square)) for square in squares for sign in (1, -1)]
        rows = [[(k**2 + b**2 * s2) * mpmath.exp(k * y) for k in wave] for y in (-0.5, 0.5)]
        rows += [[mpmath.exp(k * y) / k for k in wave] for y in (-0.5, 0.5)]
        return mpmath.det(mpmath.matrix(rows))


@pytest.mark.parametrize("bending", [1, 2, 3, 5, 8, 13, 20])
@pytest.mark.parametrize("beam", [SHIPPED, THICK], ids=["2 mm", "20 mm"])
def test_frequencies_are_roots_of_the_exact_determinant(beam, bending):
    """The determinant of the free ends changes sign within a relative 1e-12 of each frequency."""
    b = beam._root(bending)
    below, above = free_free_determinant(beam, b * (1 - 1e-12)), free_free_determinant(beam, b * (1 + 1e-12))
    assert (below / above).real < 0


def standard_frequency(beam):
    """Return the fundamental flexural frequency of a free bar by ASTM E1876 (equations 1 and 2), solved for it [Hz]."""
    x, mu = (beam.thickness / beam.length) ** 2, beam.poissons_ratio
    correction = 1 + 6.585 * (1 + 0.0752 * mu + 0.8109 * mu**2) * x - 0.868 * x**2
    correction -= 8.340 * (1 + 0.2023 * mu + 2.173 * mu**2) * x**2 / (1 + 6.338 * (1 + 0.1408 * mu + 1.536 * mu**2) * x)
    slender = np.sqrt(YOUNGS_MODULUS / (0.9465 * DENSITY)) * beam.thickness / beam.length**2
    return slender / np.sqrt(correction)


@pytest.mark.parametrize("thickness", [0.002, 0.005, 0.01])
@pytest.mark.parametrize("ratio", [0.0, 0.33])
def test_fundamental_agrees_with_the_standard_for_free_bars(thickness, ratio):
    """Within 0.03 % of the fit in ASTM E1876 up to a thickness of a tenth of the length."""
    beam = TimoshenkoBeam(length=0.1, thickness=thickness, poissons_ratio=ratio)
    assert hertz(beam, 1) == pytest.approx(standard_frequency(beam), rel=3e-4)


def test_a_measured_free_bar_has_its_frequencies():
    """One slenderness explains a real free bar within 0.15 %, where Euler-Bernoulli is 2.4 % off at the third mode.

    First four of the record ``acceleration.lvm`` of github.com/ladisk/ImageBasedModalAnalysisTutorial (MIT) [Hz].
    """
    measured = np.array([695.75, 1898.1, 3671.2, 5975.0])

    def ratios(thickness):
        beam = TimoshenkoBeam(length=1.0, thickness=thickness)
        found = np.array([hertz(beam, n) for n in range(1, 5)])
        return found / found[0]

    slenderness = brentq(lambda each: ratios(each)[3] - measured[3] / measured[0], 1e-3, 0.2)
    assert ratios(slenderness) == pytest.approx(measured / measured[0], rel=1.5e-3)
    assert ratios(1e-4)[2] / (measured[2] / measured[0]) == pytest.approx(1.024, abs=0.001)


def test_wave_numbers_follow_the_published_hinged_frequencies():
    """Hinged ends have b beta = n pi; Robert (1996, Samtech 121) prints b^2 in closed form for them."""
    for beam in (SHIPPED, THICK):
        j, g = beam.rotary, beam.shear
        wave = np.pi * np.arange(1, 9)
        root = np.sqrt((g - j) ** 2 * wave**4 + 2 * (g + j) * wave**2 + 1)
        b = np.sqrt(((g + j) * wave**2 + 1 - root) / (2 * g * j))
        _, beta2 = beam.wave_numbers(b)
        assert b * np.sqrt(beta2) == pytest.approx(wave, rel=1e-9)


def test_slender_beam_is_euler_bernoulli():
    """For a very thin beam frequencies are the squared Euler-Bernoulli roots, and the shapes agree."""
    slender = TimoshenkoBeam(length=0.1, thickness=1e-6)
    place = np.linspace(-0.05, 0.05, 21)
    for n in (1, 2, 5):
        scale = np.sqrt(slender.rotary * YOUNGS_MODULUS / DENSITY) / (2 * np.pi * 0.1)
        assert hertz(slender, n) == pytest.approx(characteristic_root(n) ** 2 * scale, rel=1e-6)
        theory = mode_shapes([n + 2], place, 0.1)
        assert slender.shapes([n], place) == pytest.approx(theory, abs=1e-5)


def test_shear_lowers_the_shipped_beam_as_derived():
    """Shear lowers the 5th bending mode of a bare beam of this size by 2 % and the 13th by 10 %."""
    scale = np.sqrt(SHIPPED.rotary * YOUNGS_MODULUS / DENSITY) / (2 * np.pi * 0.1)
    change = {n: hertz(SHIPPED, n) / (characteristic_root(n) ** 2 * scale) - 1 for n in (5, 13)}
    assert change[5] == pytest.approx(-0.02, abs=0.005)
    assert change[13] == pytest.approx(-0.10, abs=0.02)


def test_shapes_are_even_or_odd_with_unit_mean_square():
    """Odd modes are symmetric, and the right end is positive."""
    node, weight = np.polynomial.legendre.leggauss(200)
    shapes = THICK.shapes([1, 2, 3, 8], node * 0.05)
    assert shapes[[0, 2]] == pytest.approx(shapes[[0, 2], ::-1], abs=1e-9)
    assert shapes[[1, 3]] == pytest.approx(-shapes[[1, 3], ::-1], abs=1e-9)
    assert shapes**2 @ weight / 2 == pytest.approx(1, abs=1e-9)
    assert (THICK.shapes([1, 2, 3, 8], [0.05]) > 0).all()


def test_model_takes_timoshenko_shapes(model):
    """On the slender shipped beam the targets change by less than 5 mm/s; every state is met."""
    bent = replace(model, beam=SHIPPED)
    stimulus = design_stimulus(
        bent, TargetField(), Timing(AFG3022B.converter, n_samples=25_000), Amplifier(gain=25.0, limit=250.0)
    )
    assert stimulus.selected == (1, 3, 5, 7, 11, 13)
    change = np.abs(stimulus.target - Projection(model, TargetField()).target).max()
    assert 1e-5 < change < 5e-3
    assert stimulus.worst_modal_error(0.2) < 1e-6
    assert stimulus.velocity_at_focus([0.0], 0.2)[0] == pytest.approx(0.2, rel=1e-5)
