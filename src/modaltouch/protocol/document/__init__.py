"""Reads YAML with the place of every value, and says every fault with its place.

``problems``  Problem and InputError: what was given, what is allowed, what to do
``source``    the text of a file, with its hash for the record
``tree``      YAML 1.2 -> tree of nodes that know their line and column
``reading``   tree + model -> sound values and located problems
``shipped``   files that come with the program, by name
"""

from modaltouch.protocol.document.problems import InputError, Problem, fault, suggest
from modaltouch.protocol.document.reading import Reading, read
from modaltouch.protocol.document.shipped_files import find, shipped
from modaltouch.protocol.document.source import Source, load_source
from modaltouch.protocol.document.tree import Node, parse_tree

__all__ = [
    "InputError",
    "Node",
    "Problem",
    "Reading",
    "Source",
    "fault",
    "find",
    "load_source",
    "parse_tree",
    "read",
    "shipped",
    "suggest",
]
