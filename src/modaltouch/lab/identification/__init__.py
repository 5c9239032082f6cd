"""From a bare beam to its table of modes: section III-B of the paper, on a rig or from files.

``excitation``   a periodic chirp on each actuator set, and the scans of the beam under it
``responses``    H1 frequency responses by the measured drive, with coherence
``peaks``        half-power bandwidth, as the paper does; first poles, and the delay; refuses conjugated responses
``kernel``       the least squares behind it: common poles and delay, real residues, complex linear rest
``shapes``       residues to shapes, labels by their likeness to those of a free-free beam, points that alias
``identified``   the joint fit, read as modes; `identify_each` for files that do not say where they were measured
``estimates``    the result: every number with its 95 % interval
``files``        responses of other programs: CSV, NPZ, plain numbers, UFF; `lvm` reads LabVIEW's
``report``       Table I, plain values, the files of a folder; ``figures`` and ``apparatus_file`` make theirs
"""

from modaltouch.lab.identification.estimates import Estimate, Identification, IdentifiedMode
from modaltouch.lab.identification.joint_fit import identify
from modaltouch.lab.identification.responses import FrequencyResponses

__all__ = ["Estimate", "FrequencyResponses", "Identification", "IdentifiedMode", "identify"]
