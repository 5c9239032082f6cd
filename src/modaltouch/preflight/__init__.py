"""Everything that can fail before the participant sits down: files, limits, predicted speeds; no hardware.

``ground``   the sound parts of the files that a stimulus needs
``figures``  what each level does to the beam
``advice``   where the field does not go, what was taken by default
``examine``  the whole check: limits at every level, and what the engine refuses, with its place
"""

from modaltouch.preflight.checked import Preflight
from modaltouch.preflight.examination import examine, examine_findings

__all__ = ["Preflight", "examine", "examine_findings"]
