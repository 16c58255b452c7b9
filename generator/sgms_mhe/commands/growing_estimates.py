"""The growing file of estimates that `sgms-mhe watch` writes."""

import os
from pathlib import Path
from typing import BinaryIO

from sgms_mhe.commands.common import is_stream
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import atomic_write


class GrowingEstimates:
    """The file of estimates that `estimate` writes, of whole lines at any time.

    It takes its place with the first update; an irregular file is written directly.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stream: BinaryIO | None = None
        self._size = 0

    def append(self, estimates: Estimates) -> None:
        """Write rows.

        Raises:
            InputError: the file cannot be written; earlier content stays, in whole lines.
        """
        if not len(estimates):
            return
        columns = estimates.columns
        rows = zip(*(map(repr, values.tolist()) for values in columns.values()), strict=True)
        text = "".join(",".join(row) + "\n" for row in rows).encode()
        try:
            if self._stream is None:
                header = (",".join(columns) + "\n").encode()
                self._stream, self._size = self._open(header)
                text = text if self._size else header + text
            done = 0
            while done < len(text):
                done += self._stream.write(text[done:])
            self._size += len(text)
        except BrokenPipeError:  # whoever read it has enough
            raise
        except OSError as error:
            if not is_stream(self._path) and self._stream is not None:
                os.truncate(self._path, self._size)
            raise InputError(
                self._path, "output file", None, f"a file that can be written ({error.strerror})"
            ) from None

    def close(self) -> None:
        """No more rows come."""
        if self._stream is not None:
            self._stream.close()

    def _open(self, header: bytes) -> tuple[BinaryIO, int]:
        """(where rows go, bytes that are there): a new file with its header, or a stream as it is."""
        if is_stream(self._path):
            return self._path.open("wb", buffering=0), 0
        with atomic_write(self._path) as whole:
            whole.write(header)
        return self._path.open("ab", buffering=0), len(header)
