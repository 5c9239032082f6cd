"""Run models.R of every design, and compare the statistics with R's own: ``make models-r``.

For each protocol at fixed levels a few participants are simulated and analysed; R must fit every model that can be
fitted, give the reason for the others, and find the same p, intervals and estimates as in `reference.R`.

On Debian brms needs r-cran-brms, r-cran-rcppeigen, r-cran-rcppparallel and r-cran-bh, and a link that rstan looks for:
``ln -s /usr/include /usr/lib/R/site-library/BH/include``. A model takes minutes with it; without it, it is skipped.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT, HERE = Path(__file__).parents[2], Path(__file__).parent
PROTOCOLS = [
    *(f"protocols/{name}.yaml" for name in (
        "differentiated_stimulation", "with_catch_trials", "two_fields", "comparison_2ifc", "detection_with_confidence",
        "magnitude", "under_the_finger",
    )),
    *(f"docs/examples/protocol_{name}.yaml" for name in (
        "cells", "comparison", "factors", "groups", "plateau", "questions", "same_different", "table", "three_fingers",
    )),
]  # fmt: skip
"""A protocol of each family of designs."""


def run(*words: str | Path, folder: Path = ROOT) -> str:
    """Return the output of a command; exit with all of its output if it fails.

    Raises
    ------
    SystemExit
        If it fails.
    """
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, words))}\n{done.stdout}{done.stderr}")
    return done.stdout


def main() -> None:
    """Simulate, analyse, fit and compare."""
    if shutil.which("Rscript") is None:
        sys.exit("no Rscript: on Debian, apt-get install r-base-core r-cran-lme4 r-cran-ordinal")
    program = (sys.executable, "-m", "modaltouch")
    for protocol in sys.argv[1:] or PROTOCOLS:
        with TemporaryDirectory() as place:
            results, out = Path(place, "results"), Path(place, "out")
            run(*program, "simulate", protocol, "-n", "6", "--results", results)
            run(*program, "analyse", results, "--out", out)
            fitted = run("Rscript", "models.R", folder=out).splitlines()
            print(f"{protocol}\n  " + "\n  ".join(line for line in fitted if line.startswith(("== ", "no fit"))))
            print("  " + run("Rscript", HERE / "reference.R", folder=out).replace("\n", "\n  ").rstrip(), flush=True)


if __name__ == "__main__":
    main()
