"""Names: those that were meant where an unknown one was written, and that of a distribution."""

from collections.abc import Iterable
from difflib import get_close_matches
from importlib.metadata import EntryPoint


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """`; did you mean A or B?`: the known names nearest to an unknown one, nearest first; empty if none is near."""
    near = get_close_matches(name.lower(), known)
    return f"; did you mean {' or '.join(near)}?" if near else ""


def name_distribution(entry: EntryPoint) -> str:
    """Return name and version of the distribution an entry point comes from."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "a distribution without a name"
