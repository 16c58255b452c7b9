"""Errors a user can act on."""

from __future__ import annotations

from pathlib import Path


class InputError(Exception):
    """Bad input: names the file, the key or row, the value found and what is allowed.

    The command line prints the message and exits with code 2.
    """

    def __init__(self, source: str | Path, where: str, value: object, allowed: str) -> None:
        self.source = str(source)
        self.where = where
        self.value = value
        self.allowed = allowed
        shown = "" if value is None else f" = {value!r}"
        super().__init__(f"{self.source}: {where}{shown}: {allowed}")


class BuildError(Exception):
    """The C compiler refused an emitted package; the message carries its output."""
