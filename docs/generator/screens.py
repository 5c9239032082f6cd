"""The screens of a protocol as the participant sees them, drawn without a window from what the window draws."""

from collections.abc import Iterator
from io import BytesIO

import numpy as np
from PIL import Image

from modaltouch.protocol import Schedule
from modaltouch.window.controls import typesetter_of
from modaltouch.window.layout import DARK, Picture, Shape, cover
from modaltouch.window.pictures import Illustrator

SIZE = (800, 500)
"""Size of a picture [pixels]."""


def screens(experiment) -> list[Picture]:
    """Return the screens of a session in their order: one placement and question for each finger condition."""
    protocol, texts = experiment.protocol, experiment.texts
    design, zones = protocol.conditions, experiment.apparatus.zone_spans

    def asking(answers):
        return Illustrator.of(SIZE, zones, "dark", texts, answers, design)

    trials = Schedule.draw(protocol, "p01", 1).trials
    first = {trial.condition.finger_condition: trial for trial in reversed(trials) if not trial.practice}
    intervals = range(1, 1 + (protocol.intervals.number if protocol.intervals else 0))
    pictures = asking(protocol.answers)

    def session() -> Iterator[Picture]:
        yield pictures.welcome(trials[0])
        yield pictures.answering(trials[0])
        for trial in sorted(first.values(), key=lambda each: each.index):
            progress = (trial.index, len(trials))
            yield pictures.placement(trial)
            yield from (pictures.feel(trial, progress, interval) for interval in intervals)
            yield pictures.question(trial, progress)
            for name, answers in protocol.answers.further.items():
                yield asking(answers).question(trial, progress, name=name)
        if protocol.schedule.break_after_trials:
            yield pictures.page("rest", str(texts.rest), progress)
        for name, answers in protocol.closing.items():
            yield asking(answers).form(name, None, confirmed=False)

    return list(session())


def png(picture: Picture, texts) -> bytes:
    """Return a screen as a PNG: its marks one above the other, with the very coverage that the window draws."""
    width, height = SIZE
    image = np.empty((height, width, 3), dtype=np.float32)
    image[:] = _colour(DARK.ground)
    for mark in picture.marks:
        if isinstance(mark, Shape):
            covered = cover(np.array(mark.corners) * height + (width / 2, height / 2))
        else:
            covered = typesetter_of(texts).cover(mark, SIZE)
        rows, columns = (
            slice(max(low, 0), max(low + n, 0))
            for low, n in zip((covered.bottom, covered.left), covered.alpha.shape, strict=True)
        )
        below = image[rows, columns]
        alpha = covered.alpha[rows.start - covered.bottom :, columns.start - covered.left :]
        alpha = alpha[: below.shape[0], : below.shape[1], np.newaxis]
        below += alpha * (_colour(mark.fill) - below)
    file = BytesIO()
    Image.fromarray(np.round(image[::-1]).astype(np.uint8)).save(file, "PNG", optimize=True)
    return file.getvalue()


def _colour(fill: str) -> np.ndarray:
    return np.array([int(fill[place : place + 2], 16) for place in (1, 3, 5)], dtype=np.float32)
