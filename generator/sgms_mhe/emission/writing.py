"""A package's folder."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from sgms_mhe.emission.delivery import MANIFEST, manifested
from sgms_mhe.support.errors import InputError

EARLIER_SUFFIXES = (".c", ".h", ".txt")
"""Of the files of packages that had no manifest."""


def write_folder(files: Mapping[str, str | bytes], folder: Path) -> None:
    """Write files into `folder`, which afterwards holds them and nothing else that a package could have left.

    The folder is replaced in one move, so an interruption leaves the old one or the new one.

    Raises:
        InputError: the folder cannot be written, or holds files that no package emits.
    """
    parent = folder.parent
    foreign = _foreign(folder) if folder.is_dir() else []
    if foreign:
        raise InputError(folder, "output folder", sorted(foreign)[0], "an empty folder or an earlier package")
    try:
        parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(dir=parent, prefix=f".{folder.name}-"))
        try:
            for name, content in files.items():
                (scratch / name).write_bytes(content if isinstance(content, bytes) else content.encode())
            scratch.chmod(0o755)
            if folder.exists():
                shutil.rmtree(folder)
            scratch.rename(folder)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise InputError(folder, "output folder", None, f"cannot be written: {error.strerror}") from None


def _foreign(folder: Path) -> list[str]:
    """Names of what is in a folder and belongs to no package: its manifest lists what does."""
    listed = folder / MANIFEST
    names = {path.name for path in folder.iterdir()}
    if listed.is_file():
        return list(names - manifested(listed.read_text(encoding="utf-8", errors="replace")))
    return [name for name in names if not name.endswith(EARLIER_SUFFIXES) or name == "CMakeLists.txt"]
