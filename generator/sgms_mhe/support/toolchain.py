"""C sources to a shared library that ctypes loads, compiled once and kept in the user's cache."""

import ctypes
import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path

from sgms_mhe.support import cache
from sgms_mhe.support.errors import BuildError

# Neither -march=native nor relaxed arithmetic: results must not depend on the machine that compiles. A multiply and an
# add stay two roundings for the same reason. Hosts have vector registers, which compilers make use of at -O3.
DEFAULT_FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-DSGMS_VECTORS=1")
# The same numbers in half the compiler's time: for code that it takes longer to compile than to run over a log.
QUICK_FLAGS = ("-std=c99", "-O1", "-ffp-contract=off", "-DSGMS_VECTORS=1")
# The widest registers of this host. Operations and their order stay, so results do to the bit: what
# `-ffp-contract=off` and strict arithmetic forbid they forbid here too.
_WIDE = {
    ("avx512f", "avx512dq", "avx512vl"): ("-mavx512f", "-mavx512dq", "-mavx512vl", "-mprefer-vector-width=256"),
    ("avx2",): ("-mavx2",),
}
_HOST = Path("/proc/cpuinfo")
COMPILERS = ("gcc", "clang", "cc")
PACKAGED = "ziglang"
"""Python package with a compiler in it, for hosts that have none."""
WARNING_FLAGS = (
    "-pedantic",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Wshadow",
    "-Wmissing-prototypes",
    "-Werror",
)


def compiler() -> tuple[str, ...]:
    """The C compiler's command: $CC with its arguments, gcc, clang or cc from PATH, or the one of `ziglang`.

    Raises:
        BuildError: $CC is no command line, or there is no compiler.
    """
    stated = os.environ.get("CC", "")
    try:
        words = tuple(shlex.split(stated))
    except ValueError as error:
        raise BuildError(f"CC = {stated!r}: {str(error).lower()}; CC names the C compiler to use") from None
    if words:
        return words
    for name in COMPILERS:
        if shutil.which(name):
            return (name,)
    if importlib.util.find_spec(PACKAGED):
        # Without -mcpu it compiles for the processor that it runs on.
        return (sys.executable, "-m", PACKAGED, "cc", "-mcpu=baseline")
    raise BuildError(
        f"no C compiler: none of {', '.join(COMPILERS)} is on PATH. Install one (Debian, Ubuntu: apt install gcc; "
        "macOS: xcode-select --install), or pip install 'sgms-mhe[compiler]', which brings one, or name it in CC"
    )


@lru_cache
def wide_flags() -> tuple[str, ...]:
    """Flags for code this host alone runs: its wide registers, which change how fast it is and no result.

    Empty where the host has none or the compiler does not know them. Such code is kept apart: flags are part of a name.
    """
    try:
        words = {word for line in _HOST.read_text().splitlines() if line.startswith("flags") for word in line.split()}
    except OSError:  # another system
        return ()
    for registers, flags in _WIDE.items():
        if words.issuperset(registers):
            try:
                tool_output([*compiler(), *flags, "-x", "c", "-fsyntax-only", os.devnull])
            except BuildError:  # a compiler that is older than the host
                continue
            return flags
    return ()


def load_library(path: Path) -> ctypes.CDLL:
    """Load a shared library.

    Raises:
        BuildError: it is none for this host.
    """
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        remedy = "CC and the flags must make code for this host"
        raise BuildError(f"{shlex.join(compiler())}: what it made cannot be loaded ({error}); {remedy}") from None


def shared_library(
    sources: Sequence[Path],
    include_dirs: Sequence[Path] = (),
    flags: Sequence[str] = DEFAULT_FLAGS,
    libraries: Sequence[str] = (),
) -> Path:
    """Compile C sources to a shared library and return its path; arguments, cache and errors as for `program`."""
    return program(sources, include_dirs, (*flags, "-fPIC", "-shared"), libraries, suffix=".so")


def program(
    sources: Sequence[Path],
    include_dirs: Sequence[Path] = (),
    flags: Sequence[str] = DEFAULT_FLAGS,
    libraries: Sequence[str] = (),
    *,
    suffix: str = "",
) -> Path:
    """Compile C sources to a program and return its path.

    It is kept under a name that is a digest of everything it is made of: contents of the sources and of the headers
    beside them and in `include_dirs`, flags, compiler and its version; see `sgms_mhe.support.cache`.

    Args:
        sources: C files.
        include_dirs: folders of headers.
        flags: compiler flags.
        libraries: system libraries to link, as `m`.
        suffix: of its name.

    Raises:
        BuildError: no compiler, or it refused; the message carries its output.
    """
    command = compiler()
    digest = _digest(sources, include_dirs, (*command, _version(command), *flags, *libraries))
    stem = sources[0].stem
    kept = cache.find(stem, digest, suffix)
    if kept is not None:
        return kept
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / f"{stem}{suffix}"
        arguments = [
            *flags,
            *(f"-I{folder}" for folder in include_dirs),
            *(str(source) for source in sources),
            "-o",
            str(built),
            *(f"-l{library}" for library in libraries),
        ]
        tool_output([*command, *arguments])
        try:
            content = built.read_bytes()
        except OSError as error:
            raise BuildError(
                f"{shlex.join([*command, *arguments])}\nmade no file ({error.strerror}); CC names the C compiler to use"
            ) from None
    return cache.keep(stem, digest, suffix, content)


def tool_output(command: Sequence[str], remedy: str = "CC names the C compiler to use") -> str:
    """Return the stdout of a compiler or one of its tools.

    Raises:
        BuildError: it is not there, which `remedy` mends, or it refused; the message carries its output.
    """
    try:
        # A tool that waits for input, or prints what is no text, is still a tool that refused.
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", check=False
        )
    except OSError as error:
        raise BuildError(f"{command[0]}: {error.strerror}; {remedy}") from None
    if done.returncode != 0:
        raise BuildError(f"{shlex.join(command)}\nexit code {done.returncode}\n{done.stderr}{done.stdout}")
    return done.stdout


@lru_cache
def _version(command: tuple[str, ...]) -> str:
    return tool_output([*command, "--version"])


def _digest(sources: Sequence[Path], include_dirs: Sequence[Path], rest: Iterable[str]) -> str:
    folders = dict.fromkeys([*(source.parent for source in sources), *include_dirs])
    headers = [header for folder in folders for header in sorted(folder.glob("*.h"))]
    digest = hashlib.sha256()
    for path in [*sources, *headers]:
        try:
            content = path.read_bytes()
        except OSError as error:
            raise BuildError(f"{path}: {error.strerror}") from None
        # Names count, places do not: a checkout that moved finds what it built.
        digest.update(f"{path.name}\0{len(content)}\0".encode())
        digest.update(content)
    for word in rest:
        digest.update(f"{word}\0".encode())
    return digest.hexdigest()
