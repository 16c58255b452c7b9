"""Files kept between runs, in a folder of the user's own: found as they were written, or not at all.

Files cached here are loaded into the process and run. So the folder belongs to the user alone, nothing in it is reached
through a link, every file has the digest of its content in its name, and a file that does not match it is thrown away
and made again. Files appear whole: processes may look for one and keep the same one at the same time. There are never
many more than `MOST` of them: those that were not asked for longest go first.
"""

import hashlib
import os
import stat
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

from platformdirs import user_cache_path

from sgms_mhe.support.errors import BuildError

DIGITS: Final = 24
"""Of a SHA-256 in hexadecimal, in the names of files: 96 bits."""
MOST: Final = 20_000
"""Files, some 40 kB each."""
KEPT: Final = 0.75
"""Share of `MOST` that stays where there are more."""

_listed: Final[dict[Path, dict[str, list[str]]]] = {}
"""Names of files by folder and stem, as they were when the folder was read last: that takes longer than a file."""


def cache_dir() -> Path:
    """Folder of cached files: where the system has caches; on Linux $XDG_CACHE_HOME/sgms-mhe or ~/.cache/sgms-mhe.

    Raises:
        BuildError: the user has no home.
    """
    try:
        return user_cache_path("sgms-mhe", appauthor=False)
    except RuntimeError:
        raise BuildError("no home folder to keep compiled code in; XDG_CACHE_HOME names another place") from None


def find(stem: str, key: str, suffix: str) -> Path | None:
    """The file that `keep` wrote for a stem and a key, if its content is still the same.

    Args:
        stem: readable part of the name.
        key: digest (hexadecimal) of all that the content depends on.
        suffix: of the name.

    Raises:
        BuildError: the folder is not the user's own.
    """
    with _Folder() as folder:
        found = folder.found(_name(stem, key), suffix)
        return None if found is None else folder.path / found[0]


def read(stem: str, key: str, suffix: str) -> bytes | None:
    """Content of the file that `find` finds."""
    with _Folder() as folder:
        found = folder.found(_name(stem, key), suffix)
        return None if found is None else found[1]


def keep(stem: str, key: str, suffix: str, content: bytes) -> Path:
    """Write a file for `find`; whoever else is writing the same one does no harm.

    Raises:
        BuildError: the folder is not the user's own or cannot be written to.
    """
    with _Folder() as folder:
        return folder.write(f"{_name(stem, key)}-{_digest(content)}{suffix}", content)


def _name(stem: str, key: str) -> str:
    return f"{stem}-{key[:DIGITS]}"


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:DIGITS]


class _Folder:
    """The cache folder, made where it is missing, checked, and held open: names below are looked up in it alone.

    Raises:
        BuildError: it cannot be made, is a link or no folder, or belongs to another user.
    """

    def __init__(self) -> None:
        self.path = cache_dir()

    def __enter__(self) -> Self:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.mkdir(mode=0o700, exist_ok=True)
            self._descriptor = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError as error:
            raise self._refusal(f"no folder to keep compiled code in ({error.strerror})") from None
        status = os.fstat(self._descriptor)
        try:
            if status.st_uid != os.geteuid():
                raise self._refusal(f"belongs to user {status.st_uid}; compiled code is kept in a folder of one's own")
            if stat.S_IMODE(status.st_mode) != 0o700:
                os.fchmod(self._descriptor, 0o700)
        except BaseException:
            os.close(self._descriptor)
            raise
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)

    def _refusal(self, why: str) -> BuildError:
        return BuildError(f"{self.path}: {why}; XDG_CACHE_HOME names another place")

    def found(self, stem: str, suffix: str) -> tuple[str, bytes] | None:
        """Name and content of a file that `write` wrote; those that are no longer as it wrote them are removed."""
        for listed in (_listed.get(self.path, {}), None):
            names = (self._list() if listed is None else listed).get(stem, [])
            for name in sorted(names):
                content = self.content(name)
                if content is not None and name == f"{stem}-{_digest(content)}{suffix}":
                    self._touch(name)
                    return name, content
                self.remove(name)
        return None

    def _list(self) -> dict[str, list[str]]:
        """Names of the folder's files by stem and key; of too many the oldest are removed."""
        with os.scandir(self._descriptor) as entries:
            names = [entry.name for entry in entries]
        if len(names) > MOST:
            names.sort(key=self._access_time)
            for name in names[: len(names) - int(KEPT * MOST)]:
                self.remove(name)
        listed: dict[str, list[str]] = {}
        for name in names:
            listed.setdefault(name.rpartition("-")[0], []).append(name)
        _listed[self.path] = listed
        return listed

    def _touch(self, name: str) -> None:
        """A file's time of access is now: file systems need not keep it by themselves."""
        with suppress(OSError):
            written = os.stat(name, dir_fd=self._descriptor, follow_symlinks=False).st_mtime_ns
            os.utime(name, ns=(time.time_ns(), written), dir_fd=self._descriptor, follow_symlinks=False)

    def _access_time(self, name: str) -> float:
        """When a file was asked for last; 0.0 of one that is gone."""
        try:
            return os.stat(name, dir_fd=self._descriptor, follow_symlinks=False).st_atime
        except OSError:
            return 0.0

    def content(self, name: str) -> bytes | None:
        """Return the content of a regular file of the user that nobody else may write; None for anything else."""
        try:
            # Without waiting for the other end of a pipe.
            flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
            descriptor = os.open(name, flags, dir_fd=self._descriptor)
        except OSError:
            return None
        with os.fdopen(descriptor, "rb") as stream:
            status = os.fstat(descriptor)
            own = status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
            return stream.read() if own and stat.S_ISREG(status.st_mode) else None

    def remove(self, name: str) -> None:
        """Remove files whose content contradicts their name. One that cannot be removed stays unused."""
        with suppress(OSError):
            os.unlink(name, dir_fd=self._descriptor)

    def write(self, name: str, content: bytes) -> Path:
        """Write a file the user alone may read, write and run, whole or not at all."""
        try:
            # A folder of its own, so that an interrupt leaves nothing behind.
            with tempfile.TemporaryDirectory(dir=self.path, prefix="part-") as part:
                written = Path(part) / name
                written.touch(mode=0o700)
                written.write_bytes(content)
                return written.replace(self.path / name)
        except OSError as error:
            raise self._refusal(f"cannot be written ({error.strerror})") from None
