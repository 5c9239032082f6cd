"""From a bare beam to its table of modes: section III-B of the paper, on a rig or from files.

``excitation``   a periodic chirp on each actuator set, and the scans of the beam under it
``responses``    H1 frequency responses by the measured drive, with coherence
``search``       first poles from the peaks, joint refinement, more poles while something is left to explain
``kernel``       the least squares behind it: common poles and delay, real residues, complex linear rest
``shapes``       residues to shapes, labels by their likeness to those of a free-free beam, points that alias
``halfpower``    peak picking and half-power bandwidth, as the paper does, and when they mean nothing
``identified``   the result: every number with its 95 % interval
"""

from modaltouch.identification.identified import Estimate, Identification, IdentifiedMode, identify
from modaltouch.identification.responses import FrequencyResponses

__all__ = ["Estimate", "FrequencyResponses", "Identification", "IdentifiedMode", "identify"]
