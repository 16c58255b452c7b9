"""Small drawings of a number over logs or axes: dots with intervals, bands behind them. SVG, coloured by the page."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final, Literal

from sgms_mhe.support.numbers import SIGMAS

WIDTH, HEIGHT = 340.0, 150.0
LEFT, RIGHT, TOP, BOTTOM = 80.0, 4.0, 6.0, 20.0
LONGEST_LABEL: Final = 18
"""Characters."""
MOST_BAND: Final = 1.5
"""Heights of what the numbers span that a band may add on either side; a wider one is cut off."""


@dataclass(frozen=True)
class Mark:
    """A number at a place: its standard deviation, the band it is compared with, whether it left it, its label.

    `label` is written beside it where it left its band.
    """

    at: float
    value: float
    std: float
    band: tuple[float, float] | None
    left: bool
    said: str
    label: str = ""


def drawn(
    marks: Sequence[Mark],
    ends: tuple[str, str],
    nominal: float,
    written: Callable[[float], str],
    line: Literal["", "course", "course moves"],
    breaks: Sequence[int] = (),
) -> str:
    """An SVG element.

    Args:
        marks: from left to right.
        ends: labels below the first and the last.
        nominal: drawn as a dashed line where it is near; NaN: none.
        written: a value of the vertical axis in words.
        line: class of the line that connects the numbers; empty: none.
        breaks: numbers (by place) before which the mean changed.
    """
    low, high = _range(marks, nominal)
    first, last = marks[0].at, marks[-1].at

    def x(at: float) -> float:
        if last <= first:
            return 0.5 * WIDTH
        return LEFT + 14.0 + (WIDTH - LEFT - RIGHT - 28.0) * (at - first) / (last - first)

    def y(value: float) -> float:
        return TOP + (HEIGHT - TOP - BOTTOM) * (high - value) / (high - low)

    parts = [_bands(marks, x, y, low, high)]
    if low < nominal < high:
        parts.append(f'<line class="nominal" x1="{LEFT}" x2="{WIDTH - RIGHT}" {_same("y", y(nominal))}/>')
    if line:
        points = " ".join(f"{x(m.at):.1f},{y(m.value):.1f}" for m in marks)
        parts.append(f'<polyline class="{line}" points="{points}"/>')
    for k in breaks:
        place = _same("x", 0.5 * (x(marks[k - 1].at) + x(marks[k].at)))
        parts.append(f'<line class="break" {place} y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>')
    parts += [_dot(mark, x(mark.at), y) for mark in marks]
    parts.append(f'<text class="end" x="{LEFT - 6}" y="{TOP + 8}">{escape(written(high))}</text>')
    parts.append(f'<text class="end" x="{LEFT - 6}" y="{HEIGHT - BOTTOM}">{escape(written(low))}</text>')
    parts.append(f'<text x="{LEFT}" y="{HEIGHT - 5}">{_label(ends[0])}</text>')
    if len(marks) > 1:
        parts.append(f'<text class="end" x="{WIDTH - RIGHT}" y="{HEIGHT - 5}">{_label(ends[1])}</text>')
    said = escape("; ".join(mark.said for mark in marks), quote=True)
    size = f"0 0 {WIDTH:g} {HEIGHT:g}"
    return f'<svg class="course" viewBox="{size}" role="img" aria-label="{said}">{"".join(parts)}</svg>'


def _range(marks: Sequence[Mark], nominal: float) -> tuple[float, float]:
    low = min(mark.value - SIGMAS * mark.std for mark in marks)
    high = max(mark.value + SIGMAS * mark.std for mark in marks)
    span = high - low or abs(high) or 1.0
    bands = [mark.band for mark in marks if mark.band is not None]
    least, most = low - MOST_BAND * span, high + MOST_BAND * span
    if bands:
        low = max(least, min([low, *(band[0] for band in bands)]))
        high = min(most, max([high, *(band[1] for band in bands)]))
        # A band that was left is seen at least where it ends.
        low, high = min([low, *map(_beyond, marks)]), max([high, *map(_beyond, marks)])
    if math.isfinite(nominal) and least < nominal < most:
        low, high = min(low, nominal), max(high, nominal)
    margin = 0.06 * (high - low or span)
    return low - margin, high + margin


def _beyond(mark: Mark) -> float:
    """The end of the band a mark left, and a bit of the band; its own value where it left none."""
    if mark.band is None or not mark.left:
        return mark.value
    end = mark.band[1] if mark.value > mark.band[1] else mark.band[0]
    return end + 0.3 * (end - mark.value)


def _bands(
    marks: Sequence[Mark], x: Callable[[float], float], y: Callable[[float], float], low: float, high: float
) -> str:
    """Behind every number the band it is compared with, halfway to its neighbours."""
    places = [x(mark.at) for mark in marks]
    parts = []
    for k, mark in enumerate(marks):
        if mark.band is None:
            continue
        start = 0.5 * (places[k - 1] + places[k]) if k else LEFT
        end = 0.5 * (places[k] + places[k + 1]) if k + 1 < len(marks) else WIDTH - RIGHT
        top, bottom = y(min(mark.band[1], high)), y(max(mark.band[0], low))
        parts.append(
            f'<rect class="band" x="{start:.1f}" width="{end - start:.1f}" y="{top:.1f}" height="{bottom - top:.1f}"/>'
        )
    return "".join(parts)


def _dot(mark: Mark, x: float, y: Callable[[float], float]) -> str:
    kind = "dot left" if mark.left else "dot"
    reach = SIGMAS * mark.std
    ends = f'y1="{y(mark.value + reach):.1f}" y2="{y(mark.value - reach):.1f}"'
    text = ""
    if mark.left and mark.label:
        side = 'class="out end" x="{:.1f}"' if x > 0.6 * WIDTH else 'class="out" x="{:.1f}"'
        place = x - 8.0 if x > 0.6 * WIDTH else x + 8.0
        text = f'<text {side.format(place)} y="{y(mark.value) + 4:.1f}">{_label(mark.label)}</text>'
    return (
        f'<g class="{kind}"><title>{escape(mark.said)}</title><line {_same("x", x)} {ends}/>'
        f'<circle cx="{x:.1f}" cy="{y(mark.value):.1f}" r="3.5"/>{text}</g>'
    )


def _label(text: str) -> str:
    """A name that leaves room for another in its row."""
    return escape(text if len(text) <= LONGEST_LABEL else f"{text[: LONGEST_LABEL - 1]}…")


def _same(axis: str, place: float) -> str:
    return f'{axis}1="{place:.1f}" {axis}2="{place:.1f}"'
