"""Shared libraries from C sources: built once, rebuilt when anything they are made of changes, errors that say why."""

from __future__ import annotations

import ctypes
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from sgms_mhe.support.errors import BuildError
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, WARNING_FLAGS, cache_dir, compiler, shared_library


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
        shared_library([source], cache_key="machine digest"),
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
    monkeypatch.delenv("CC", raising=False)
    assert compiler() == ("gcc",)
    monkeypatch.setenv("CC", "gcc -g0")
    assert compiler() == ("gcc", "-g0")
    assert answer(shared_library([source])) == 42
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(BuildError, match=r"no-such-compiler.*CC names"):
        shared_library([source])


def test_missing_source_and_unwritable_cache(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BuildError, match=r"absent\.c"):
        shared_library([source.with_name("absent.c")])
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(BuildError, match="XDG_CACHE_HOME"):
        shared_library([source])


def test_relative_cache_home_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    assert cache_dir() == Path.home() / ".cache" / "sgms-mhe"
