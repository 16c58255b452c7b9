"""From bytes to text: UTF-8, UTF-16 with or without a mark, Latin-1."""

from __future__ import annotations

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
_PROBE: Final = 4096
_NO_TEXT: Final = re.compile(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]")


def decode(path: Path, content: bytes, encoding: str | None) -> tuple[str, str]:
    """(text, encoding) of a file's content; `encoding` is the one that [log] states.

    Latin-1 gives every byte a meaning, so it is taken only where UTF-8 fails and nothing but text comes of it; its µ, °
    and ² are those of Windows-1252 too. Raises InputError for what is no text.
    """
    chosen = encoding or _guess(content)
    try:
        text = content.decode(chosen)
    except LookupError:
        allowed = "an encoding that Python knows, as utf-8, utf-16-le or latin-1"
        raise InputError(path, "[log] encoding", encoding, allowed) from None
    except UnicodeDecodeError as error:
        where = f"byte {error.start}"
        raise InputError(
            path, where, None, f'{chosen} text; another encoding? [log] of the machine file has encoding = "..."'
        ) from None
    if found := _NO_TEXT.search(text):
        line = text.count("\n", 0, found.start()) + 1
        allowed = "text; a file of another format needs its own suffix, another encoding [log] of the machine file"
        raise InputError(path, f"line {line}", found[0], allowed)
    return text, "utf-8" if chosen == "utf-8-sig" and not content.startswith(codecs.BOM_UTF8) else chosen


def _guess(content: bytes) -> str:
    for mark, name in _MARKS:
        if content.startswith(mark):
            return name
    probe = content[:_PROBE]
    half = max(len(probe) // 2, 1)
    if probe[1::2].count(0) > 0.4 * half:
        return "utf-16-le"
    if probe[0::2].count(0) > 0.4 * half:
        return "utf-16-be"
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"
