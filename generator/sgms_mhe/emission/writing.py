"""A package's folder."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from sgms_mhe.support.errors import InputError

EMITTED_SUFFIXES = (".c", ".h", ".txt")


def write_folder(files: Mapping[str, str], folder: Path) -> None:
    """Write files into `folder`, which afterwards holds them and nothing else that a package could have left.

    The folder is replaced in one move, so an interruption leaves the old one or the new one.

    Raises:
        InputError: the folder cannot be written, or holds files that no package emits.
    """
    parent = folder.parent
    foreign = [p.name for p in folder.iterdir() if p.suffix not in EMITTED_SUFFIXES] if folder.is_dir() else []
    if foreign:
        raise InputError(folder, "output folder", sorted(foreign)[0], "an empty folder or an earlier package")
    try:
        parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(dir=parent, prefix=f".{folder.name}-"))
        try:
            for name, text in files.items():
                (scratch / name).write_text(text, encoding="utf-8")
            scratch.chmod(0o755)
            if folder.exists():
                shutil.rmtree(folder)
            scratch.rename(folder)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise InputError(folder, "output folder", None, f"cannot be written: {error.strerror}") from None
