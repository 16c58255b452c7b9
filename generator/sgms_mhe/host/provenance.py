"""Digest of the generator's sources and libraries: the key of cached packages and results beside their machine.

There is no list that could be forgotten: the import statements tell which files count, beginning at the emission.
"""

import hashlib
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import packages_distributions, version
from pathlib import Path
from typing import Final

from sgms_mhe.model.effects import outside_sources
from sgms_mhe.support.paths import runtime_dir, templates_dir

EMISSION: Final = "emission"
"""The room whose bytes count."""
DIGITS: Final = 12
"""Hexadecimal digits of the digest."""

# A tenth of the time of parsing, which counts where one package out of a cache is all that is asked for.
_IMPORT = re.compile(
    rb"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import\b|import[ \t]+([\w.]+)[ \t]*(?:as\b|#|$))", re.MULTILINE
)


@dataclass(frozen=True)
class Sources:
    """Sources that decide the bytes of every package.

    Attributes:
        files: content by path below the tree it is part of (`package/...`, `templates/...`, `runtime/...`).
        libraries: version of every library the modules among them import. CasADi decides which expressions are
            simplified and shared, Jinja2 lays out, the numerical ones decide the digits of tables and vectors.
    """

    files: Mapping[str, bytes]
    libraries: Mapping[str, str]

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of all of it."""
        whole = hashlib.sha256()
        for name, content in sorted(self.files.items()):
            whole.update(f"{name}\0{len(content)}\0".encode() + content)
        for name, number in sorted(self.libraries.items()):
            whole.update(f"{name} {number}\0".encode())
        return whole.hexdigest()


def read_sources(package: Path, templates: Path, runtime: Path) -> Sources:
    """Read the sources of a generator.

    Args:
        package: folder of the Python package; of its rooms, the emission and all that it imports count, whole.
        templates: folder of the templates.
        runtime: folder of the C beside them, of which `sgms_*.h` go into packages.
    """
    files = {"package/__init__.py": (package / "__init__.py").read_bytes()}
    libraries: set[str] = set()
    rooms: set[str] = set()
    waiting = {EMISSION}
    while waiting:
        room = waiting.pop()
        rooms.add(room)
        inside = {path: path.read_bytes() for path in _files(package / room)}
        files |= {f"package/{path.relative_to(package).as_posix()}": content for path, content in inside.items()}
        for module in {name for path, content in inside.items() if path.suffix == ".py" for name in _imports(content)}:
            library, *own = module.split(".")
            if library != package.name:
                libraries.add(library)
            elif own and own[0] not in rooms:
                waiting.add(own[0])
    files |= {f"templates/{path.relative_to(templates).as_posix()}": path.read_bytes() for path in _files(templates)}
    files |= {f"runtime/{path.name}": path.read_bytes() for path in runtime.glob("sgms_*.h")}
    return Sources(files, {name: version(name) for name in libraries - sys.stdlib_module_names})


def _files(folder: Path) -> list[Path]:
    """Files below a folder, but for files of editors and interpreters."""
    return [
        path
        for path in folder.rglob("*")
        if path.is_file() and not any(part.startswith((".", "__pycache__")) for part in path.relative_to(folder).parts)
    ]


def _imports(content: bytes) -> set[str]:
    """Modules a Python file imports, those of its own folder by relative names left out."""
    names = {(first or second).decode() for first, second in _IMPORT.findall(content)}
    return {name for name in names if not name.startswith(".")}


def digest_of_sources(effects: Iterable[str] = ()) -> str:
    """Return the digest of the sources of a package, for caches: the same sources, the same package.

    Args:
        effects: of the machine; those that other distributions bring count with their files and libraries.
    """
    return _add_outside(_own_sources(), outside_sources(effects)).digest[:DIGITS]


@lru_cache(maxsize=1)
def _own_sources() -> Sources:
    package = Path(__file__).resolve().parents[1]
    return read_sources(package, templates_dir(), runtime_dir())


def _add_outside(own: Sources, outside: Mapping[str, bytes]) -> Sources:
    """The sources with files of other distributions and the libraries that these import."""
    if not outside:
        return own
    modules = {name for path, content in outside.items() if path.endswith(".py") for name in _imports(content)}
    known = packages_distributions()
    versions = {
        f"{library}/{name}": version(name)
        for library in {module.partition(".")[0] for module in modules} - own.libraries.keys()
        for name in known.get(library, ())
    }
    files = {f"outside/{path}": content for path, content in outside.items()}
    return Sources({**own.files, **files}, {**own.libraries, **versions})
