"""Results in a notebook: a table as HTML, axes to draw on, arrays that nobody changes by mistake."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from html import escape
from typing import Any, TypeVar

import numpy as np

from sgms_mhe.support.libraries import optional_library

Result = TypeVar("Result")


def html_table(title: str, head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a table as HTML, everything in it escaped."""
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "".join(f"<tr>{''.join(f'<td>{escape(str(value))}</td>' for value in row)}</tr>" for row in rows)
    return (
        f"<table><caption>{escape(title)}</caption><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"
        if body
        else f"<p>{escape(title)}</p>"
    )


def labelled_axes(axes: Any | None, horizontal: str, vertical: str) -> Any:
    """Return matplotlib axes with labels: those given, or of a new figure, which a notebook shows.

    Raises:
        InputError: matplotlib is not installed.
    """
    if axes is None:
        axes = optional_library("matplotlib.pyplot", "plot", "plot()").subplots(layout="constrained")[1]
    axes.set(xlabel=horizontal, ylabel=vertical)
    return axes


def read_only(result: Result) -> Result:
    """Return a result, a dataclass, whose arrays cannot be written to; arrays of the caller stay as they are."""
    _lock(result, set())
    return result


def _lock(part: Any, seen: set[int]) -> None:
    if id(part) in seen:
        return
    seen.add(id(part))
    if isinstance(part, Mapping):
        for value in part.values():
            _lock(value, seen)
    elif isinstance(part, tuple | list):
        for value in part:
            _lock(value, seen)
    elif is_dataclass(part) and not isinstance(part, type):
        for field in fields(part):
            value = getattr(part, field.name)
            if isinstance(value, np.ndarray):
                view = value.view()
                view.setflags(write=False)
                object.__setattr__(part, field.name, view)
            else:
                _lock(value, seen)
