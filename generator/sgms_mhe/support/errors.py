"""Errors a user can act on."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Final, Self

LONGEST_VALUE: Final = 200
"""Characters of a wrong value, or of a wrong key, that a message repeats."""


_FILE_WORDS: Final = re.compile(r"\[log\](?: \(machine file, --log\))?")
_OPTION: Final = re.compile(r"(?:; or|, as) --[a-z-]+(?: \w+=\w+)?")
_ENTRY: Final = re.compile(r'\b([a-zA-Z]\w*) = (\{[^{}]*\}|"[^"]*"|true|false|\.{3}|-?[\d.]+(?:e[-+]?\d+)?)')
_at_command_line: ContextVar[bool] = ContextVar("at_command_line", default=False)


@contextmanager
def speak_to_command_line() -> Iterator[None]:
    """Let messages name keys of files and options; elsewhere they name arguments of Python functions."""
    token = _at_command_line.set(True)
    try:
        yield
    finally:
        _at_command_line.reset(token)


def _name_arguments(text: str) -> str:
    """Return the allowed values with `read_log`'s argument `table` in place of a file's table [log] and of options.

    `[log] (machine file, --log) has resample = true` becomes `read_log's table={"resample": True}`, and `--follow`
    becomes `follow`; a whole command stays.
    """
    if _FILE_WORDS.search(text) is None:
        return text if "sgms-mhe " in text else re.sub(r"--([a-z]+)", r"\1", text)

    def name_entry(entry: re.Match[str]) -> str:
        value = re.sub(r"(\w+) = ", r'"\1": ', entry[2].replace("{ ", "{").replace(" }", "}"))
        return f'{{"{entry[1]}": {value.title() if value in ("true", "false") else value}}}'

    entries = _ENTRY.sub(name_entry, _OPTION.sub("", _FILE_WORDS.sub("[log]", text)))
    return entries.replace("[log] has {", "read_log's table={").replace("[log]", "read_log's table")


class InputError(Exception):
    """Bad input: names the file, the key or row, the value found and the allowed ones.

    The command line prints the message and exits with code 2.

    Attributes:
        source: file, option or argument.
        where: key, or row and column.
        value: found there; None where the message repeats none.
        allowed: in a sentence, as a machine file says it.
    """

    def __init__(self, source: str | Path, where: str, value: object, allowed: str) -> None:
        self.source = str(source)
        self.where = where
        self.value = value
        self.allowed = allowed
        self._arguments = (source, where, value, allowed)
        super().__init__(*self._arguments)

    def __str__(self) -> str:
        shown = "" if self.value is None else f" = {_shorten(repr(self.value))}"
        text = f"{self.source}: {_shorten(self.where)}{shown}: "
        if _at_command_line.get():
            return text + self.allowed
        return text.removeprefix("--") + _name_arguments(self.allowed)

    def add_notes(self, sentences: Sequence[str]) -> Self:
        """Return the error with sentences on how the log was used; they may be the reason behind the reason."""
        if not sentences:
            return self
        source, where, value, allowed = self._arguments
        return type(self)(source, where, value, f"{allowed} (note: {'; '.join(sentences)})")

    def __reduce__(self) -> tuple[type[Self], tuple[str | Path, str, object, str]]:
        return type(self), self._arguments


class ImplausibleError(InputError):
    """Columns of a log that contradict their names: of another sign, scale or unit."""


def _shorten(text: str) -> str:
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


class LogWarning(UserWarning):
    """Sentence on how a log was read: on omitted, changed or assumed data."""


class MachineWarning(UserWarning):
    """Sentence on a machine file read as it stands, but may be outdated."""


class BuildError(Exception):
    """The C compiler refused an emitted package; the message carries its output."""
