"""Psychophysical observers: models of answers and reaction times, from the speeds felt by two fingers.

``participant``  a single participant: comparison, criterion, lapses, reaction time
``population``   `Observer`: typical participant, spread between participants, front end, YAML file; probabilities
``felt``         front ends, which reduce the velocity under a finger to a felt speed
``fit``          maximum-likelihood fit to recorded answers, and its limits
"""

from modaltouch.planning.observer.participant import Participant
from modaltouch.planning.observer.population import DrawnParticipants, Observer

__all__ = ["DrawnParticipants", "Observer", "Participant"]
