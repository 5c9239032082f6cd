"""Psychophysical observers: from what two fingers feel to an answer, left, right or both, and its reaction time.

``participant``  one participant: comparison, criterion, lapses, reaction time; probabilities of answers in closed form
``population``   Observer: a typical participant, the spread between participants, and the front end; its YAML file
``felt``         what a finger feels of the velocity under it, as one number; at the zones, once for all levels
``fit``          an observer fitted to recorded answers by maximum likelihood, and what such a fit cannot determine
"""

from modaltouch.planning.observer.participant import Participant
from modaltouch.planning.observer.population import DrawnParticipants, Observer

__all__ = ["DrawnParticipants", "Observer", "Participant"]
