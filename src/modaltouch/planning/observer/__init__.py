"""Psychophysical observers: from what two fingers feel to left, right or both, and its reaction time.

``participant``  one person: comparison, criterion, lapses, reaction time; chances of the answers in closed form
``population``   Observer: a typical participant, the spread between participants, and the front end
``felt``         what a finger makes of the velocity under it, one number; at the zones, once for all levels
``file``         observers as YAML files, shipped and one's own
``fit``          an observer fitted to recorded answers by their likelihood, and what such a fit cannot know
"""

from modaltouch.planning.observer.participant import Participant
from modaltouch.planning.observer.population import Crowd, Observer

__all__ = ["Crowd", "Observer", "Participant"]
