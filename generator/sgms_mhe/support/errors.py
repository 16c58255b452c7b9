"""Errors a user can act on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, Self

LONGEST_VALUE: Final = 200
"""Characters of a wrong value, or of a wrong key, that a message repeats."""


class InputError(Exception):
    """Bad input: names the file, the key or row, the value found and what is allowed.

    The command line prints the message and exits with code 2.
    """

    def __init__(self, source: str | Path, where: str, value: object, allowed: str) -> None:
        self.source = str(source)
        self.where = where
        self.value = value
        self.allowed = allowed
        self._arguments = (source, where, value, allowed)
        shown = "" if value is None else f" = {_shorten(repr(value))}"
        super().__init__(f"{self.source}: {_shorten(where)}{shown}: {allowed}")

    def add_notes(self, sentences: Sequence[str]) -> Self:
        """Return the error with sentences on how the log was used; they may be the reason behind the reason."""
        if not sentences:
            return self
        source, where, value, allowed = self._arguments
        return type(self)(source, where, value, f"{allowed} (note: {'; '.join(sentences)})")

    def __reduce__(self) -> tuple[type[InputError], tuple[str | Path, str, object, str]]:
        return type(self), self._arguments


class ImplausibleError(InputError):
    """Columns of a log that cannot be what they are called: of another sign, scale or unit."""


def _shorten(text: str) -> str:
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


class LogWarning(UserWarning):
    """Sentence on how a log was read: on what was left out, changed or assumed."""


class BuildError(Exception):
    """The C compiler refused an emitted package; the message carries its output."""
