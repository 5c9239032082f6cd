"""The beam with its zones and the hands that touch it, seen from above by the participant."""

from __future__ import annotations

from modaltouch.window.layout import Layout
from modaltouch.window.marks import Box, Mark, Point, Words, capsule, framed, rectangle, rounded
from modaltouch.window.theme import Theme, mixed


def draw_beam(layout: Layout, theme: Theme, touched: tuple[str, ...]) -> tuple[Mark, ...]:
    """Return the beam with its zones; every touched zone looks the same."""
    unit, beam = layout.unit, layout.beam()
    boxes = list(layout.zones.values())
    rim = 0.007 * unit
    marks: list[Mark] = [
        *framed(
            Box(beam.x, beam.y, beam.width + 2 * rim, beam.height + 2 * rim),
            0.012 * unit,
            theme.beam_edge,
            theme.beam,
            0.004 * unit,
        )
    ]
    for left, right in zip(boxes[:-1], boxes[1:], strict=True):
        x = (left.right + right.left) / 2
        marks.append(rectangle(Box(x, beam.y, 0.003 * unit, beam.height), theme.beam_edge))
    for name, box in layout.zones.items():
        is_touched = name in touched
        if is_touched:
            marks += framed(box.inset(-0.004 * unit), 0.01 * unit, theme.text, theme.zone, 0.007 * unit)
        above = Box(box.x, box.top + 0.042 * unit, box.width, 0.07 * unit)
        fill = theme.text if is_touched else theme.dim
        marks.append(Words(name, above, 0.05 * unit, fill, bold=is_touched))
    return tuple(marks)


def draw_hands(
    layout: Layout, theme: Theme, zones: tuple[str, str], fingers: tuple[str, str], names: tuple[str, str]
) -> tuple[Mark, ...]:
    """Return the hands with each finger on its zone, and the fingers' names above.

    Parameters
    ----------
    layout : Layout
        Where the zones lie.
    theme : Theme
        Colours.
    zones : tuple of str
        Zone under the left and under the right finger, as the participant sees them.
    fingers : tuple of str
        Those fingers, such as ``left index``.
    names : tuple of str
        What the participant calls them.

    Raises
    ------
    ValueError
        If a finger is none that touches the beam.
    """
    for finger in fingers:
        if finger not in {f"{side} {name}" for side in ("left", "right") for name in ("index", "middle")}:
            raise ValueError(f"given the finger {finger!r}; allowed: left or right, then index or middle")
    colours = (theme.left, theme.right)
    tips = {finger: (layout.zones[zone].x, layout.zones[zone].y) for finger, zone in zip(fingers, zones, strict=True)}
    fills = dict(zip(fingers, colours, strict=True))
    palms: list[Mark] = []
    touching: list[Mark] = []
    for side in ("left", "right"):
        own = {finger.split()[1]: tip for finger, tip in tips.items() if finger.startswith(side)}
        own_fills = {finger.split()[1]: fill for finger, fill in fills.items() if finger.startswith(side)}
        if own:
            palm, on_beam = _draw_hand(layout, theme, side, own, own_fills)
            palms += palm
            touching += on_beam
    # Crossed hands on neighbouring zones overlap: no palm hides the other hand's finger.
    marks = [*palms, *touching]
    gap = abs(tips[fingers[1]][0] - tips[fingers[0]][0])
    for zone, name, fill in zip(zones, names, colours, strict=True):
        box = layout.zones[zone]
        above = Box(box.x, box.top + 0.094 * layout.unit, max(gap, box.width) * 0.96, 0.05 * layout.unit)
        marks.append(Words(name, above, 0.031 * layout.type_scale, fill, bold=True))
    return tuple(marks)


def _draw_hand(
    layout: Layout, theme: Theme, side: str, tips: dict[str, Point], fills: dict[str, str]
) -> tuple[list[Mark], list[Mark]]:
    """Return one hand: palm and resting fingers, and the touching fingers that go over them."""
    unit = layout.unit
    outward = 1 if side == "right" else -1
    thick, thin = 0.034 * unit, 0.026 * unit
    knuckles = _place_knuckles(layout, outward, tips)
    xs = list(knuckles.values())
    top = layout.zones[next(iter(layout.zones))].y - 0.185 * unit
    palm = Box((min(xs) + max(xs)) / 2, top - 0.035 * unit, max(xs) - min(xs) + 0.078 * unit, 0.115 * unit)
    line = 0.005 * unit
    thumb_base = (xs[0] - outward * 0.005 * unit, palm.bottom + 0.035 * unit)
    thumb_tip = (xs[0] - outward * 0.085 * unit, top + 0.03 * unit)
    resting = [(thumb_base, thumb_tip, thin)]
    resting += [((x, top), (x, top + 0.03 * unit), thin) for name, x in knuckles.items() if name not in tips]
    marks: list[Mark] = [capsule(start, end, radius + line, theme.hand_edge) for start, end, radius in resting]
    marks.append(rounded(palm.inset(-line), 0.05 * unit, theme.hand_edge))
    marks += [capsule(start, end, radius, theme.hand) for start, end, radius in resting]
    marks.append(rounded(palm, 0.048 * unit, theme.hand))
    touching: list[Mark] = []
    for name, tip in tips.items():
        knuckle = (knuckles[name], top)
        touching.append(capsule(knuckle, tip, thick + line, theme.ground))
        touching.append(capsule(knuckle, tip, thick, fills[name]))
        touching.append(_draw_nail(knuckle, tip, thick, mixed(fills[name], theme.nail, 0.65)))
    return marks, touching


def _place_knuckles(layout: Layout, outward: int, tips: dict[str, Point]) -> dict[str, float]:
    """Return where the four fingers leave the palm, from index to little finger [window heights]."""
    unit = layout.unit
    if len(tips) == 2:
        middle = sum(x for x, _ in tips.values()) / 2
        half = min(0.36 * abs(tips["middle"][0] - tips["index"][0]) / 2 + 0.01 * unit, 0.085 * unit)
        index, spacing = middle - outward * half, 2 * half
    else:
        index, spacing = tips["index"][0] + outward * 0.012 * unit, 0.052 * unit
    beyond = index + outward * spacing
    return {
        "index": index,
        "middle": beyond,
        "ring": beyond + outward * 0.052 * unit,
        "little": beyond + outward * 0.1 * unit,
    }


def _draw_nail(knuckle: Point, tip: Point, radius: float, fill: str) -> Mark:
    """Return the nail, which shows that the palm looks down."""
    run, rise = tip[0] - knuckle[0], tip[1] - knuckle[1]
    length = (run**2 + rise**2) ** 0.5
    along = (run / length, rise / length)
    near = (tip[0] - along[0] * 0.35 * radius, tip[1] - along[1] * 0.35 * radius)
    far = (tip[0] + along[0] * 0.3 * radius, tip[1] + along[1] * 0.3 * radius)
    return capsule(near, far, 0.5 * radius, fill)
