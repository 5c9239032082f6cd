"""Freezes today's behaviour: ``python tests/golden/write.py`` writes the JSON files beside this one again.

``git diff tests/golden`` then shows what has changed, and the commit that keeps it says why. A change of which nobody
can say why is a fault.

``python tests/golden/write.py --record`` records the two sessions of tests/record/format_<n> for a new format of the
record; those of former formats stay as the versions of their day wrote them.
"""

from __future__ import annotations

import sys
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory

from cases import COLLECTIONS, output
from freezing import HERE, write
from outside import RECORDS, ROOT, call
from sayings import OUTPUTS

INTERRUPTED_AT = "4 of 12 answered"


def record(folder: Path) -> None:
    """Record a whole demonstration, and another that is interrupted after its fourth answer."""
    if folder.exists():
        sys.exit(f"{folder} is there already; a record of a former format is never written again")
    with chdir(ROOT):  # the record keeps the protocol's path as it is given
        whole = call(f"simulate protocols/demo.yaml -n 1 --results {folder}")
        words = f"run protocols/demo.yaml -p p02 --rig simulated --answers simulated --results {folder}"
        broken = call(words, interrupt_at=INTERRUPTED_AT)
    assert (whole.status, broken.status) == (0, 130), whole.stderr + broken.stderr
    for lock in folder.rglob(".lock"):
        lock.unlink()


def freeze() -> None:
    """Write what every collection of cases comes to today."""
    for stale in HERE.rglob("*.json"):
        stale.unlink()
    with TemporaryDirectory() as folder:
        for name, collect in COLLECTIONS.items():
            write(name, collect(Path(folder) / name))
        for name, case in OUTPUTS.items():
            write(f"outputs/{name}", output(case, Path(folder) / "outputs" / name))


if __name__ == "__main__":
    if sys.argv[1:] not in ([], ["--record"]):
        sys.exit(__doc__)
    if sys.argv[1:]:
        record(RECORDS)
    else:
        freeze()
