"""The digest of the caches: all sources of a package's bytes, found and not listed. And what no package holds of it."""

import ast
import json
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import sgms_mhe
from c_packages import machine
from package_variants import TOY
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import emit_package
from sgms_mhe.host import packages, provenance
from sgms_mhe.host.compiled import CompiledEstimator, CompiledModel
from sgms_mhe.host.provenance import Sources, digest_of_sources, read_sources
from sgms_mhe.support.paths import runtime_dir, templates_dir

PACKAGE = Path(sgms_mhe.__file__).parent


class Tree(NamedTuple):
    """The folders that sources are read from."""

    package: Path
    templates: Path
    runtime: Path

    def read(self) -> Sources:
        return read_sources(*self)


HERE = Tree(PACKAGE, templates_dir(), runtime_dir())


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Tree:
    """A copy of the generator's sources."""
    root = tmp_path_factory.mktemp("tree")
    ignored = shutil.ignore_patterns("__pycache__", "_data")
    package = root / "generator" / PACKAGE.name
    shutil.copytree(PACKAGE, package, ignore=ignored)
    shutil.copytree(HERE.templates, root / "templates")
    shutil.copytree(HERE.runtime, root / "runtime_c")
    return Tree(package, root / "templates", root / "runtime_c")


def edited(tree: Tree, path: Path) -> str:
    """Digest with one byte more in a file, or with a file of one byte."""
    before = path.read_bytes() if path.is_file() else None
    try:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes((before or b"") + b"\n")
        return tree.read().digest
    finally:
        if before is None:
            path.unlink()
        else:
            path.write_bytes(before)


KINDS = {
    "signal chain": ("package", "signals/chain.py"),
    "machine schema": ("package", "machine/*.py"),
    "reference, which the self-test vectors come from": ("package", "reference/*.py"),
    "self-test": ("package", "emission/selftest.py"),
    "model": ("package", "model/*.py"),
    "effects": ("package", "model/effects/*.py"),
    "structure": ("package", "emission/structure.py"),
    "flow's table": ("package", "model/flow_table.py"),
    "paths": ("package", "support/paths.py"),
    "version": ("package", "__init__.py"),
    "templates": ("templates", "**/*.jinja"),
    "runtime headers": ("runtime", "sgms_*.h"),
}
"""Every kind of input: its folder, and where its files are in it."""


@pytest.mark.parametrize("kind", KINDS)
def test_every_file_of_every_kind_counts(kind: str, copy: Tree) -> None:
    folder, pattern = KINDS[kind]
    before = copy.read().digest
    assert before == HERE.read().digest, "the digest hangs on where the tree lies"
    found = sorted(getattr(copy, folder).glob(pattern))
    assert found
    assert len({before, *(edited(copy, path) for path in found)}) == len(found) + 1


def test_a_new_file_counts_and_what_is_above_or_beside_does_not(copy: Tree) -> None:
    before = copy.read().digest
    new = (
        copy.package / "model" / "effects" / "new.py",
        copy.templates / "part" / "new.jinja",
        copy.runtime / "sgms_n.h",
    )
    for path in new:
        assert edited(copy, path) != before, path
    beside = [copy.package / room / "__init__.py" for room in ("diagnosis", "report", "commands", "host")]
    beside += [copy.runtime / "harness.c", copy.package / "model" / "__pycache__" / "axis.pyc"]
    beside += [copy.templates / ".machine.c.jinja.swp"]
    for path in beside:
        assert edited(copy, path) == before, path


@pytest.mark.parametrize("library", ["casadi", "jinja2", "numpy", "scipy"])
def test_version_of_a_library_counts(library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = HERE.read()
    assert before.libraries[library]
    of = provenance.version
    monkeypatch.setattr(provenance, "version", lambda name: "0.0" if name == library else of(name))
    assert HERE.read().digest != before.digest


def test_imports_are_those_that_a_parser_finds() -> None:
    """They are found by a regular expression, for its speed."""
    for name in HERE.read().files:
        path = PACKAGE / name.removeprefix("package/")
        if path.suffix != ".py":
            continue
        found = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level < 2, f"{path}: an import out of the folder without the package's name"
                assert node.module != PACKAGE.name or [a.name for a in node.names] == ["__version__"], path
                found |= {node.module or ""} if node.level == 0 else set()
        assert provenance._imports(path.read_bytes()) == found, path


SCRIPT = """
import json, pickle, sys
from sgms_mhe.emission.package import emit_package
emit_package(pickle.load(sys.stdin.buffer))
modules = [getattr(module, "__file__", None) for name, module in sys.modules.items() if name.startswith("sgms_mhe")]
print(json.dumps(modules))
"""


def test_whatever_an_emission_loads_counts() -> None:
    """All that a fresh process has imported after a package with effects and self-test vectors."""
    settings = override_machine(load_machine(TOY), {"effects": [{"name": "dwell_dependence"}, {"name": "force_delay"}]})
    command = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, input=pickle.dumps(settings), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    loaded = {Path(file) for file in json.loads(done.stdout)}
    assert PACKAGE / "reference" / "mhe.py" in loaded
    assert loaded <= {PACKAGE / name.removeprefix("package/") for name in HERE.read().files}


def test_cached_packages_have_the_digest_of_the_sources(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    settings = machine(estimator={"kind": "ekf"})
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    emitted = packages.cached_package(settings)
    assert digest_of_sources() == HERE.read().digest[: len(digest_of_sources())]
    kept = set(tmp_path.rglob("package-*.json"))
    assert len(kept) == 1
    monkeypatch.setattr(packages, "emit_package", None)
    assert packages.cached_package(settings).files == emitted.files
    monkeypatch.setattr(packages, "emit_package", emit_package)
    monkeypatch.setattr(packages, "digest_of_sources", lambda _: "0123456789ab")
    assert packages.cached_package(settings).files == emitted.files
    assert len(set(tmp_path.rglob("package-*.json"))) == 2


def test_a_machine_is_emitted_once_for_all_models_on_this_host(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    settings = machine(estimator={"kind": "ekf"})
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    emitted: list[Any] = []

    def count(*given: Any, **options: Any) -> Any:
        emitted.append(given)
        return emit_package(*given, **options)

    monkeypatch.setattr(packages, "emit_package", count)
    for each in (CompiledModel, CompiledModel, CompiledEstimator):
        each(settings)
    assert len(emitted) == 1


COMMENTED = """
import sys
from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.package import emit_package, write_package
from pathlib import Path
write_package(emit_package(load_machine(sys.argv[1])), Path(sys.argv[2]))
"""


def test_a_comment_in_the_generator_moves_no_byte_of_a_package(copy: Tree, tmp_path: Path) -> None:
    """Every file of a package, its manifest included, after a comment in every Python file of the generator."""
    before = copy.read().digest
    for path in copy.package.rglob("*.py"):
        path.write_text(path.read_text(encoding="utf-8") + "# one more comment\n", encoding="utf-8")
    assert copy.read().digest != before
    command = [sys.executable, "-c", COMMENTED, TOY, str(tmp_path / "toy")]
    environment = {**os.environ, "PYTHONPATH": str(copy.package.parent)}
    done = subprocess.run(command, capture_output=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr.decode()
    written = {path.name: path.read_text(encoding="utf-8") for path in (tmp_path / "toy").iterdir()}
    assert written == emit_package(load_machine(TOY)).files
