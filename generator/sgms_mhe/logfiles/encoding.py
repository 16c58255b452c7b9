"""From bytes to text: UTF-8, UTF-16 with or without a mark, Latin-1."""

import codecs
import re
from pathlib import Path
from typing import Final

from sgms_mhe.support.errors import InputError

_MARKS: Final = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
PROBE: Final = 4096
"""Bytes that tell UTF-16 without a mark."""
_NO_TEXT: Final = re.compile(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]")


def decode(path: Path, content: bytes, encoding: str | None) -> tuple[str, str]:
    """(text, encoding) of a file's content; `encoding` is the one that [log] states.

    Latin-1 gives every byte a meaning, so it is taken only where UTF-8 fails and nothing but text comes of it; its µ, °
    and ² are those of Windows-1252 too. Raises InputError for other content.
    """
    chosen = encoding or guess(content)
    try:
        text = content.decode(chosen)
    except LookupError:
        raise _unknown(path, encoding) from None
    except UnicodeDecodeError as error:
        where = f"byte {error.start}"
        raise InputError(
            path, where, None, f'{chosen} text; another encoding? [log] (machine file, --log) has encoding = "..."'
        ) from None
    check_text(path, text)
    return text, "utf-8" if chosen == "utf-8-sig" and not content.startswith(codecs.BOM_UTF8) else chosen


def check_text(path: Path, text: str, before: int = 0) -> None:
    """Refuse characters of no text; `before`: lines above this one."""
    if found := _NO_TEXT.search(text):
        line = before + text.count("\n", 0, found.start()) + 1
        allowed = (
            "text; a file of another format needs its own suffix (.mat, .npz, .npy, .h5, .parquet, .feather, .mf4), "
            "another encoding [log] (machine file, --log)"
        )
        raise InputError(path, f"line {line}", found[0], allowed)


def guess(content: bytes, *, whole: bool = True) -> str:
    """The encoding of a file's content, or of its beginning, which may end within a character."""
    for mark, name in _MARKS:
        if content.startswith(mark):
            return name
    probe = content[:PROBE]
    half = max(len(probe) // 2, 1)
    if probe[1::2].count(0) > 0.4 * half:
        return "utf-16-le"
    if probe[0::2].count(0) > 0.4 * half:
        return "utf-16-be"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(content, final=whole)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


class Decoder:
    """Bytes of a text that come in pieces of any size, within characters too.

    Args:
        path: for messages.
        encoding: that [log] states; None: by the first bytes, Latin-1 where UTF-8 fails.
    """

    def __init__(self, path: Path, encoding: str | None) -> None:
        self._path, self._stated = path, encoding
        self._waiting = b""
        self._decoder: codecs.IncrementalDecoder | None = None
        self._chosen = ""
        self._plain = True

    def decode(self, content: bytes, *, ended: bool = False, whole: bool = False) -> str:
        """The characters that are whole with these bytes.

        Args:
            content: the bytes.
            ended: no more will come.
            whole: nor is any of them missing.

        Raises:
            InputError: they are no text of this encoding.
        """
        self._waiting += content
        if self._decoder is None:
            if len(self._waiting) < PROBE and not ended:
                return ""
            self._decoder = self._choose(self._stated or guess(self._waiting[:PROBE], whole=False))
        pending, self._waiting = self._waiting, b""
        held = self._decoder.getstate()[0]  # the beginning of a character
        try:
            text = self._decoder.decode(pending, final=whole)
        except UnicodeDecodeError:
            if self._stated is not None or self._chosen != "utf-8" or not self._plain:
                allowed = f'{self._chosen} text; another encoding? [log] (machine file, --log) has encoding = "..."'
                raise InputError(self._path, "text", None, allowed) from None
            self._decoder = self._choose("latin-1")  # ASCII so far, which is both
            text = self._decoder.decode(held + pending, final=whole)
        self._plain = self._plain and text.isascii()
        return text

    def _choose(self, encoding: str) -> codecs.IncrementalDecoder:
        self._chosen = encoding
        try:
            return codecs.getincrementaldecoder(encoding)()
        except LookupError:
            raise _unknown(self._path, encoding) from None


def _unknown(path: Path, encoding: str | None) -> InputError:
    allowed = "an encoding that Python knows, as utf-8, utf-16-le or latin-1"
    return InputError(path, "[log] encoding", encoding, allowed)
