"""The architecture as the import contracts have it: a box per package, a row per layer."""

import ast
import tomllib
from collections import defaultdict
from importlib import import_module
from pathlib import Path

from generator.pages import write

ROOT = Path(__file__).parents[2]
WIDTH, ROW, BOX = 460, 62, 42


def layers() -> list[list[str]]:
    """Return the packages from the last layer to the first, those of the same layer together."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    layered = next(each for each in contracts if each["type"] == "layers")
    return [[room.strip() for room in layer.split("|")] for layer in layered["layers"] if layer != "__main__"]


def imports() -> dict[str, set[str]]:
    """Return which packages each package imports, read from the source."""
    package, found = ROOT / "src" / "modaltouch", defaultdict(set)
    for file in package.rglob("*.py"):
        room = file.relative_to(package).parts[0].removesuffix(".py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("modaltouch."):
                found[room].add(node.module.split(".")[1])
    return {room: rooms - {room} for room, rooms in found.items()}


def shortest(used: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the imports that do not follow from others: none to a package that an imported package reaches."""
    reached: dict[str, set[str]] = {}
    for room in (room for row in reversed(layers()) for room in row):
        reached[room] = used.get(room, set()).union(*(reached.get(other, set()) for other in used.get(room, ())))
    return {
        room: {other for other in rooms if not any(other in reached.get(each, ()) for each in rooms)}
        for room, rooms in used.items()
    }


def draw() -> str:
    """Return the drawing: boxes in the order of the contracts, a line for each import that does not follow from others."""
    rows, used = layers(), shortest(imports())
    height = len(rows) * ROW + 10
    centre = {}
    for r, row in enumerate(rows):
        for c, room in enumerate(row):
            centre[room] = (WIDTH * (c + 1) / (len(row) + 1), r * ROW + 5 + BOX / 2)
    lines, boxes = [], []
    for room, (x, y) in centre.items():
        for other in sorted(used.get(room, ())):
            if other not in centre:
                continue
            x2, y2 = centre[other]
            if y2 - y < 1.5 * ROW:
                middle, ends = (y + y2) / 2, (x, y + BOX / 2, x2, y2 - BOX / 2)
                curve = f"{x:.0f},{middle:.0f} {x2:.0f},{middle:.0f}"
            else:  # beside what lies between
                side = 1 if len(lines) % 2 else -1
                ends, bend = (x + side * 62, y, x2 + side * 62, y2), side * 80
                curve = f"{ends[0] + bend:.0f},{y:.0f} {ends[2] + bend:.0f},{y2:.0f}"
            lines.append(
                f'<path class="import" data-from="{room}" data-to="{other}" '
                f'd="M{ends[0]:.0f},{ends[1]:.0f} C{curve} {ends[2]:.0f},{ends[3]:.0f}"/>'
            )
        boxes.append(
            f'<a href="../generated/api/{room}.html"><title>{_first_line(room)}</title>'
            f'<rect class="box" x="{x - 62:.0f}" y="{y - BOX / 2:.0f}" width="124" height="{BOX}" rx="6"/>'
            f'<text x="{x:.0f}" y="{y + 5:.0f}">{room}</text></a>'
            if room != "cli"
            else f'<rect class="box" x="{x - 62:.0f}" y="{y - BOX / 2:.0f}" width="124" height="{BOX}" rx="6"/>'
            f'<text x="{x:.0f}" y="{y + 5:.0f}">{room}</text>'
        )
    return (
        f'<svg class="architecture" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="The packages of the program in the '
        f'order of its import contracts, from the command line down to the system">{"".join(lines)}{"".join(boxes)}</svg>'
    )


def _first_line(room: str) -> str:
    line = (import_module(f"modaltouch.{room}").__doc__ or "").partition("\n")[0]
    return line.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def write_architecture(folder: Path) -> None:
    """Write the drawing, to be included in a page."""
    write(folder / "architecture.html", f'<div class="drawing">{draw()}</div>\n')
