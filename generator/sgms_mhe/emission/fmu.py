"""FMUs of a package: its C with the glue of a version of FMI, in an archive of the same bytes for the same content."""

from __future__ import annotations

import io
import platform
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from sgms_mhe.support.errors import BuildError
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, shared_library

SUFFIX: Final = ".fmu/"
"""In a path: what stands behind it is inside the archive."""
_EPOCH: Final = (1980, 1, 1, 0, 0, 0)
"""The first time that an archive can state: it tells of no other."""
_MACHINES: Final[Mapping[str, str]] = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
_SYSTEMS: Final[Mapping[str, tuple[str, str]]] = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib")}


def fmu(files: Mapping[str, str], name: str, archive: str) -> tuple[bytes, str | None]:
    """An archive with a binary for this host, where it has a compiler.

    Args:
        files: of the FMU, by path inside it.
        name: of the machine.
        archive: its name, which says the version of FMI.

    Returns:
        The archive, and why it has no binary; None where it has one.
    """
    version = 2 if archive.endswith("_fmi2.fmu") else 3
    content = {path: text.encode() for path, text in files.items()}
    folder, suffix = _platform(version)
    missing: str | None = f"FMI {version}.0 has no name for this platform"
    if folder is not None:
        try:
            content[f"binaries/{folder}/{name}{suffix}"] = _binary(files)
            missing = None
        except BuildError as error:
            missing = str(error)
    return _archive(content), missing


def without_binaries(archive: bytes) -> dict[str, bytes] | None:
    """What of an FMU does not hang on the compiler that made it, by path; None where it is no archive."""
    try:
        with zipfile.ZipFile(io.BytesIO(archive)) as opened:
            return {path: opened.read(path) for path in opened.namelist() if not path.startswith("binaries/")}
    except zipfile.BadZipFile:
        return None


def _platform(version: int) -> tuple[str | None, str]:
    """Folder and suffix of this host's binaries; None where FMI has no name for it."""
    system, suffix = _SYSTEMS.get(sys.platform, (None, ""))
    machine = _MACHINES.get(platform.machine().lower())
    if system is None or machine is None:
        return None, suffix
    if version == 2:
        return {"x86_64-linux": "linux64", "x86_64-darwin": "darwin64"}.get(f"{machine}-{system}"), suffix
    return f"{machine}-{system}", suffix


def _binary(files: Mapping[str, str]) -> bytes:
    """Shared library of an FMU's sources.

    Raises:
        BuildError: no compiler, or it refused.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for path, text in files.items():
            inside, _, file = path.rpartition("/")
            if inside == "sources":
                (folder / file).write_text(text, encoding="utf-8")
        sources = sorted(folder.glob("*.c"))
        return shared_library(sources, [folder], (*DEFAULT_FLAGS, "-fvisibility=hidden")).read_bytes()


def _archive(content: Mapping[str, bytes]) -> bytes:
    """Entries in the order of their paths, stored as they are: compressed, they would hang on a library's version."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as archive:
        for path, data in sorted(content.items()):
            entry = zipfile.ZipInfo(path, _EPOCH)
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)
    return whole.getvalue()
