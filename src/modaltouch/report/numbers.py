"""Numbers as a reader sees them, in a page, a table or a sentence."""

from __future__ import annotations

import math
import sys


def say_number(value: float | None, digits: int = 3, *, decimals: int | None = None) -> str:
    """Return a number in words for readers; a dash where there is none.

    Parameters
    ----------
    value : float or None
        The number.
    digits : int
        Significant digits.
    decimals : int, optional
        Digits behind the point, in place of significant ones.

    Examples
    --------
    >>> say_number(0.97512), say_number(float("nan")), say_number(float("inf")), say_number(39.0)
    ('0.975', '–', '∞', '39')
    >>> say_number(12.0, decimals=1), say_number(None)
    ('12.0', '–')
    """
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if decimals is None and abs(value) <= 2 * sys.float_info.min and value != 0:
        return "< 1e-300"
    text = f"{value:.{digits}g}" if decimals is None else f"{value:.{decimals}f}"
    # Zero has no sign, also where rounding makes it zero.
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−", 1) if value < 0 else text
