"""Pieces that several pages show, as their templates take them: tiles, and tables with a bar in each row."""

import math
from collections.abc import Iterable

from sgms_mhe.report.units import force
from sgms_mhe.report.words import capital

Row = dict[str, str]


def tile(label: str, value: str, note: str, kind: str = "", before: str = "") -> Row:
    """A key figure; `kind` colours it, `before` is the number it was."""
    return {"label": label, "before": before, "value": value, "kind": kind, "note": note}


def bar_width(value: float, most: float) -> float:
    """Width of a bar, 0 to 100, for its value over the largest."""
    return round(100.0 * max(0.0, min(1.0, value / most)), 2) if most > 0.0 and math.isfinite(value) else 0.0


def force_bars(rows: Iterable[tuple[str, str, float]], most: float) -> list[dict[str, str | float]]:
    """Forces by bars: of each its words, the kind of its bar, and the force [N]; `most` has the whole width."""
    return [
        {"words": capital(words), "kind": kind, "value": force(value), "width": bar_width(value, most)}
        for words, kind, value in rows
    ]
