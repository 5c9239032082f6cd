"""Runs ``python -m modaltouch.rig.simulator --port 0 APPARATUS.yaml``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from modaltouch.protocol import Apparatus, InputError
from modaltouch.rig.simulator import serve


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``python -m modaltouch.rig.simulator``."""
    parser = argparse.ArgumentParser(prog="python -m modaltouch.rig.simulator", description="Run a simulated rig.")
    parser.add_argument("apparatus", help="apparatus file (YAML)")
    parser.add_argument("--port", type=int, default=0, help="TCP port on 127.0.0.1; 0 takes a free one")
    parser.add_argument("--seed", type=int, default=None, help="instead of the seed in the file")
    parser.add_argument("--played", type=Path, default=None, help="file that gets a JSON line for each burst")
    options = parser.parse_args(arguments)
    try:
        serve(Apparatus.read(options.apparatus), port=options.port, seed=options.seed, played=options.played)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
