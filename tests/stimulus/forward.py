"""Responses of a beam to any voltages, as the engine computes them."""

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.vibration import BlockStates, history


def modal_history(model, voltage, timing, amplifier=None):
    """Return the modal velocities as each sample arrives, (n_modes, n_samples) array [m/s], from rest."""
    system = DiagonalSystem.of(model, amplifier)
    return history(system, system.velocity, voltage, timing)


def velocity_history(model, voltage, timing, positions, amplifier=None):
    """Return the velocity at points of the beam as each sample arrives, (n_positions, n_samples) array [m/s]."""
    system = DiagonalSystem.of(model, amplifier)
    return history(system, model.shapes(positions).T @ system.velocity, voltage, timing)


def peak_velocity(model, voltage, timing, positions, amplifier=None):
    """Return the highest speed at points of the beam until the next burst would begin, (n_positions,) array [m/s]."""
    system = DiagonalSystem.of(model, amplifier)
    return BlockStates.of(system, voltage, timing).peak(model.shapes(positions).T @ system.velocity)
