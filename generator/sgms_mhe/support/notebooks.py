"""Results at a prompt and in a notebook: a sentence, a table, axes to draw on, arrays that nobody changes."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from html import escape
from typing import Any, TypeVar

import numpy as np

from sgms_mhe.support.libraries import optional_library

Result = TypeVar("Result")
Presentation = tuple[str, Sequence[str], Sequence[Sequence[object]]]
"""Sentence, and head and rows of the table below it; no rows: there is none."""


class Shown:
    """A result as a prompt shows it, by a sentence, and a notebook, with a table below it."""

    def _shown(self) -> Presentation:
        """Return the sentence, and head and rows of the table."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._shown()[0]}>"

    def _repr_html_(self) -> str:
        title, head, rows = self._shown()
        top = "".join(f"<th>{escape(name)}</th>" for name in head)
        body = "".join(f"<tr>{''.join(f'<td>{escape(str(value))}</td>' for value in row)}</tr>" for row in rows)
        if not body:
            return f"<p>{escape(title)}</p>"
        return f"<table><caption>{escape(title)}</caption><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


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
