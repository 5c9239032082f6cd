"""Runs over the level: what is presented next follows from the recorded answers alone.

``staircase``  weighted and transformed up-down
``quest``      QUEST+, by the package questplus
``levels``     Levels: the level of a trial, replayed from the record
"""

from modaltouch.protocol.adaptive_rules.levels import AnsweredLevel, Levels, describe_rule

__all__ = ["Levels", "AnsweredLevel", "describe_rule"]
