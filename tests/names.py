"""Fails where two public classes of the package have the same name. Part of ``make check``."""

import ast
import sys
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "src" / "modaltouch"


def public_classes(package):
    """Return the places of each public class by its name."""
    places = defaultdict(list)
    for file in sorted(package.rglob("*.py")):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(f"{file.relative_to(package)}:{node.lineno}")
    return places


if __name__ == "__main__":
    twice = {name: places for name, places in public_classes(PACKAGE).items() if len(places) > 1}
    sys.exit("\n".join(f"{name}: {', '.join(places)}" for name, places in twice.items()) or 0)
