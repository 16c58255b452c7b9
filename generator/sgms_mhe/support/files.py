"""Output files that are either whole or absent."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from sgms_mhe.support.errors import InputError


@contextmanager
def atomic_write(path: str | Path) -> Iterator[BinaryIO]:
    """Write a file that takes its place only when the block ends without an exception.

    A temporary file in the same folder receives the bytes and is renamed over the target; an interrupt leaves the
    target as it was and no temporary file. Other targets (a pipe, /dev/stdout) are written directly. Raises
    InputError where the folder cannot be written to.
    """
    target = Path(path)
    try:
        if target.exists() and not target.is_file() and not target.is_dir():
            with target.open("wb") as stream:
                yield stream
            return
        target = target.resolve()  # a link stays a link
        part = target.with_name(f".{target.name}.{os.getpid()}.part")
        try:
            with part.open("wb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(path, "output file", None, f"a file that can be written ({error.strerror})") from error


def write_text(path: str | Path, content: str) -> None:
    """Write text (UTF-8, line feeds) atomically."""
    with atomic_write(path) as stream:
        stream.write(content.encode())
