"""Names that were meant where an unknown one was written."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """`; did you mean A or B?`: the known names nearest to an unknown one, nearest first; empty if none is near."""
    near = get_close_matches(name.lower(), known)
    return f"; did you mean {' or '.join(near)}?" if near else ""
