"""Equation (6), the reference trajectory: the printed form and its correction (errata 3, 4 and 5)."""

import mpmath
import pytest

MODES = {1: (229, 0.0437), 3: (2553, 0.0165), 13: (58303, 0.0101)}
FOCUS = mpmath.mpf("0.025")


@pytest.fixture(params=MODES, ids=lambda label: f"mode {label}")
def poles(request):
    """Return (a, b) of a mode of Table I [1/s]."""
    frequency, ratio = MODES[request.param]
    mpmath.mp.dps = 60
    w, xi = 2 * mpmath.pi * frequency, mpmath.mpf(str(ratio))
    return xi * w, w * mpmath.sqrt(1 - xi**2)


def test_printed_exponential_contradicts_equation_7(poles):
    """Erratum 4: with the A_k of (6), equation (7) as printed lacks the factor e^(a t_F): 7e-41 for mode 13."""
    a, b = poles
    alpha = b * FOCUS - mpmath.pi / 2
    amplitude = mpmath.exp(-a * FOCUS)
    reached = amplitude * mpmath.exp(a * FOCUS) * mpmath.sin(b * FOCUS - alpha)
    assert mpmath.almosteq(reached, 1)
    in_equation_7 = amplitude * mpmath.exp(a * (FOCUS - FOCUS)) * mpmath.sin(b * FOCUS - alpha)
    assert mpmath.almosteq(in_equation_7, mpmath.exp(-a * FOCUS))
    assert in_equation_7 < 0.21


def test_with_the_printed_equation_mode_13_vanishes():
    """Erratum 4 in figures: e^(-a t_F) of mode 13 is 7e-41."""
    a = 0.0101 * 2 * mpmath.pi * 58303
    assert float(mpmath.exp(-a * FOCUS)) == pytest.approx(7e-41, rel=0.1)


def test_amplitude_condition_needs_the_phase(poles):
    """Erratum 4: A_k e^(a t_F) is the target only where sin(b t_F - alpha) is 1."""
    a, b = poles
    amplitude = mpmath.exp(-a * FOCUS)
    for alpha in (0, mpmath.mpf(1) / 3):
        reached = amplitude * mpmath.exp(a * FOCUS) * mpmath.sin(b * FOCUS - alpha)
        assert abs(reached - 1) > 0.005


def test_printed_orbit_does_not_start_at_rest():
    """Erratum 3: at t = 0 mode 1 already moves at e^(-a t_F) = 21 % of its target, and is displaced."""
    a = mpmath.mpf("0.0437") * 2 * mpmath.pi * 229
    assert float(mpmath.exp(-a * FOCUS)) == pytest.approx(0.21, abs=0.005)


def test_started_from_rest_mode_1_ends_short(shipped_paper):
    """Erratum 3: the term that cancels the start of the orbit has decayed to e^(-2 a t_F) = 4.3 % at t_F."""
    reached, _ = shipped_paper.achieved(0.2)
    short = 1 - reached[0] / shipped_paper.target[0]
    a = 0.0437 * 2 * 3.141592653589793 * 229
    assert short == pytest.approx(float(mpmath.exp(-2 * a * 0.025)), abs=2e-3)


def test_initial_displacement_fixes_a_missing_constant():
    """Erratum 5: with eta(0) = 0 the integral of (6) for mode 1 is offset by a constant that (7) does not contain."""
    mpmath.mp.dps = 30
    w, xi = 2 * mpmath.pi * 229, mpmath.mpf("0.0437")
    a, b = xi * w, w * mpmath.sqrt(1 - xi**2)
    alpha = b * FOCUS - mpmath.pi / 2

    def velocity(t):
        return mpmath.exp(a * (t - FOCUS)) * mpmath.sin(b * t - alpha)

    def force(t, start):
        displacement = mpmath.quad(velocity, mpmath.linspace(0, t, 12)) + start
        return mpmath.diff(velocity, t) + 2 * a * velocity(t) + w**2 * displacement

    t = mpmath.mpf("0.02")
    antiderivative = mpmath.im(mpmath.exp(-a * FOCUS - 1j * alpha) / (a + 1j * b))
    assert abs(force(t, antiderivative) / (4 * a * velocity(t)) - 1) < 1e-9
    assert abs(force(t, 0) / (4 * a * velocity(t)) - 1) > 0.05
