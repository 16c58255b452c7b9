"""Shared libraries from C sources: built once, rebuilt when anything they are made of changes, errors that say why."""

import ctypes
import importlib.util
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from sgms_mhe.support import cache
from sgms_mhe.support.cache import cache_dir
from sgms_mhe.support.errors import BuildError
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, WARNING_FLAGS, compiler, load_library, program, shared_library


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = tmp_path / "code" / "answer.c"
    path.parent.mkdir()
    path.write_text('#include "answer.h"\nint answer(void);\nint answer(void) { return ANSWER; }\n')
    (path.parent / "answer.h").write_text("#define ANSWER 42\n")
    return path


def answer(library: Path) -> int:
    return int(ctypes.CDLL(str(library)).answer())


def test_library_is_built_once(source: Path) -> None:
    library = shared_library([source])
    assert answer(library) == 42
    assert library.parent == cache_dir()
    stamp = library.stat().st_mtime_ns
    assert shared_library([source]) == library
    assert library.stat().st_mtime_ns == stamp
    assert [path.name for path in cache_dir().iterdir()] == [library.name]


def test_everything_that_matters_makes_another_library(source: Path, tmp_path: Path) -> None:
    header = tmp_path / "include" / "other.h"
    header.parent.mkdir()
    header.write_text("")
    libraries = [
        shared_library([source]),
        shared_library([source], [header.parent]),
        shared_library([source], flags=("-std=c99", "-O1")),
        shared_library([source], flags=(*DEFAULT_FLAGS, *WARNING_FLAGS)),
        shared_library([source], libraries=("m",)),
    ]
    header.write_text("/* changed */\n")
    libraries.append(shared_library([source], [header.parent]))
    (source.parent / "answer.h").write_text("#define ANSWER 43\n")
    libraries.append(shared_library([source]))
    assert len(set(libraries)) == len(libraries)
    assert answer(libraries[-1]) == 43


def test_place_of_the_source_does_not_matter(source: Path) -> None:
    library = shared_library([source])
    moved = source.parent.rename(source.parent.with_name("moved"))
    assert shared_library([moved / source.name]) == library


def test_same_library_from_many_at_once(source: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        libraries = set(pool.map(lambda _: shared_library([source]), range(8)))
    assert len(libraries) == 1
    assert answer(libraries.pop()) == 42
    assert len(list(cache_dir().iterdir())) == 1


def test_compiler_output_reaches_the_user(source: Path) -> None:
    source.write_text("int answer(void) { return missing; }\n")
    with pytest.raises(BuildError, match="missing"):
        shared_library([source])
    assert not list(cache_dir().iterdir())


def test_compiler_is_taken_from_the_environment(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "gcc -g0")
    assert compiler() == ("gcc", "-g0")
    assert answer(shared_library([source])) == 42
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(BuildError, match=r"no-such-compiler.*CC names"):
        shared_library([source])


@pytest.fixture
def empty_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A PATH without a compiler, to put some into."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(folder))
    return folder


def test_compiler_is_the_first_that_is_there(empty_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert compiler()[:3] == (sys.executable, "-m", "ziglang")
    for name in ("cc", "clang", "gcc"):
        (empty_path / name).touch(mode=0o755)
        assert compiler() == (name,)
        (empty_path / name).unlink()
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(BuildError, match=r"no C compiler: none of gcc, clang, cc .*sgms-mhe\[compiler\]"):
        compiler()


@pytest.mark.slow
def test_a_compiler_in_a_package_makes_the_same_numbers(empty_path: Path, tmp_path: Path) -> None:
    """Simulated axis, model and estimator of two compilers agree to the bit; nothing but Python is on PATH."""

    def run(folder: Path, **environment: str) -> list[bytes]:
        folder.mkdir()
        own = {"XDG_CACHE_HOME": str(folder / "cache"), **environment}
        for line in ("simulate etel_xy --duration 1 --out log.csv", "estimate etel_xy log.csv --out e.csv"):
            command = [sys.executable, "-m", "sgms_mhe", *line.split()]
            subprocess.run(command, cwd=folder, env={**os.environ, **own}, check=True)
        return [(folder / name).read_bytes() for name in ("log.csv", "e.csv")]

    assert run(tmp_path / "packaged") == run(tmp_path / "gcc", PATH=os.defpath)


def test_missing_source_and_unwritable_cache(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BuildError, match=r"absent\.c"):
        shared_library([source.with_name("absent.c")])
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(BuildError, match="XDG_CACHE_HOME"):
        shared_library([source])


@pytest.mark.parametrize("words", ["'x", "gcc '", 'gcc "', "gcc \\"])
def test_a_compiler_that_is_no_command_line_is_refused(words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", words)
    with pytest.raises(BuildError, match=r"CC = .*(quotation|escaped).*CC names"):
        compiler()


@pytest.mark.parametrize(
    "words", ["true", "echo", "gcc -fsyntax-only", "cat", "/", "sh -c exit", "sh -c 'printf \\\\377; exit 1'"]
)
def test_a_compiler_that_compiles_nothing_is_refused(words: str, source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", words)
    with pytest.raises(BuildError):
        shared_library([source])


@pytest.mark.parametrize("flag", ["-c", "-E"])
def test_a_library_that_this_host_cannot_load_is_refused(flag: str, source: Path) -> None:
    with pytest.raises(BuildError, match="cannot be loaded"):
        load_library(shared_library([source], flags=(*DEFAULT_FLAGS, flag)))


# --- what is kept is what was written, and the user's own ---------------------------------------------------------


@pytest.mark.parametrize("damage", [b"", b"no library", None], ids=["empty", "garbage", "cut off"])
def test_a_damaged_file_is_made_again(source: Path, damage: bytes | None) -> None:
    library = shared_library([source])
    whole = library.read_bytes()
    library.write_bytes(whole[:-200] if damage is None else damage)
    assert answer(shared_library([source])) == 42
    assert [path.read_bytes() for path in cache_dir().iterdir()] == [whole]


def test_another_library_under_the_name_is_not_loaded(source: Path) -> None:
    library = shared_library([source])
    (source.parent / "answer.h").write_text("#define ANSWER 43\n")
    other = shared_library([source])
    other.replace(library)
    (source.parent / "answer.h").write_text("#define ANSWER 42\n")
    assert answer(shared_library([source])) == 42


def test_links_and_what_others_may_write_are_not_followed(source: Path, tmp_path: Path) -> None:
    library = shared_library([source])
    moved = library.rename(tmp_path / "elsewhere.so")
    library.symlink_to(moved)
    assert not shared_library([source]).is_symlink()
    library.chmod(0o722)
    assert shared_library([source]).stat().st_mode & 0o777 == 0o700
    library.unlink()
    os.mkfifo(library)
    assert answer(shared_library([source])) == 42


def test_the_folder_is_the_user_s_alone(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache_dir().mkdir(parents=True, mode=0o755)
    shared_library([source])
    assert cache_dir().stat().st_mode & 0o777 == 0o700
    elsewhere = cache_dir().rename(tmp_path / "elsewhere")
    cache_dir().symlink_to(elsewhere)
    with pytest.raises(BuildError, match="XDG_CACHE_HOME"):
        shared_library([source])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other"))
    owner = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    with pytest.raises(BuildError, match=f"belongs to user {owner}"):
        shared_library([source])


def test_programs_are_kept_ready_to_run(source: Path) -> None:
    source.write_text("int main(void) { return 3; }\n")
    assert subprocess.run([program([source])], check=False).returncode == 3
    assert subprocess.run([program([source])], check=False).returncode == 3


def test_content_is_found_as_it_was_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    key = "0123456789abcdef" * 4
    assert cache.read("thing", key, ".json") is None
    path = cache.keep("thing", key, ".json", b"{}")
    assert cache.read("thing", key, ".json") == b"{}"
    path.write_bytes(b"{]")
    assert cache.read("thing", key, ".json") is None
    assert not path.exists()


def test_of_too_many_files_those_not_asked_for_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(cache, "MOST", 8)
    keys = [f"{i:02d}" + "0" * 62 for i in range(9)]
    for age, key in enumerate(keys):
        path = cache.keep("thing", key, ".json", key.encode())
        os.utime(path, (1e9 + age, 1e9 + age))
    assert cache.read("thing", keys[0], ".json") is None  # nine: three too many to go on with
    assert [cache.read("thing", key, ".json") is None for key in keys[1:]] == [True, True] + 6 * [False]
    for key in keys[:3]:
        cache.keep("thing", key, ".json", key.encode())
    assert cache.read("thing", keys[3], ".json") == keys[3].encode()  # asked for, so no longer the oldest
    assert cache.read("other", keys[0], ".json") is None
    assert cache.read("thing", keys[3], ".json") is not None


def test_without_a_home_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as it does where the user has no home
    with pytest.raises(BuildError, match="XDG_CACHE_HOME"):
        cache_dir()


def test_relative_cache_home_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    assert cache_dir() == Path.home() / ".cache" / "sgms-mhe"
