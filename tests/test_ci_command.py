"""`ci`: what a repository of machine files and packages is checked for, and what its report says."""

import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from cli_cases import SMALL, done, refused, run

CHECKS = ["machine file", "package", "reference", "self-test"]


@pytest.fixture(scope="module")
def repository(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one machine file and its package."""
    folder = tmp_path_factory.mktemp("repository")
    (folder / "machines").mkdir()
    (folder / "machines" / "small.toml").write_text(SMALL)
    done("generate", folder / "machines" / "small.toml", "--out", folder / "generated" / "small")
    return folder


def test_a_repository_that_is_in_order_passes(
    repository: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(repository)
    report = tmp_path / "report.xml"
    said = json.loads(done("ci", "--junit", report, "--json").stdout)
    assert said["passed"]
    assert [(c["machine"], c["name"], c["failure"], c["skipped"]) for c in said["checks"]] == [
        ("small", name, "", "") for name in CHECKS
    ]
    (suite,) = ElementTree.parse(report).getroot()
    assert (suite.get("name"), suite.get("tests"), suite.get("failures")) == ("small", "4", "0")
    assert [case.get("name") for case in suite] == CHECKS


@pytest.mark.slow
@pytest.mark.needs_arm
def test_self_test_runs_on_the_emulated_target_too(repository: Path) -> None:
    machine = repository / "machines" / "small.toml"
    said = json.loads(
        done("ci", machine, "--generated", repository / "generated", "--target", "cortex_m7", "--json").stdout
    )
    assert said["passed"]
    assert said["checks"][-1]["name"] == "self-test, cortex_m7"


@pytest.mark.slow
def test_a_changed_file_and_a_changed_package_are_found(repository: Path, tmp_path: Path) -> None:
    machine, generated = tmp_path / "small.toml", tmp_path / "generated"
    machine.write_text(SMALL.replace("mass = 20.0", "mass = 21.0"))
    done("generate", repository / "machines" / "small.toml", "--out", generated / "small")
    result = run("ci", machine, "--generated", generated)
    assert result.exit_code == 1
    assert "files are not what the machine file gives (" in result.stdout
    assert f"sgms-mhe generate {machine} --out {generated / 'small'}" in result.stdout

    done("generate", machine, "--out", generated / "small")
    (generated / "small" / "left_over.c").write_text("int left_over;\n")
    said = json.loads(run("ci", machine, "--generated", generated, "--json").stdout)
    assert not said["passed"]
    (failure,) = [c["failure"] for c in said["checks"] if c["failure"]]
    assert "1 files are not what the machine file gives (left_over.c)" in failure


@pytest.mark.slow
def test_an_amalgamated_package_is_compared_as_one(repository: Path, tmp_path: Path) -> None:
    machine = repository / "machines" / "small.toml"
    done("generate", machine, "--out", tmp_path / "small", "--amalgamate")
    said = json.loads(done("ci", machine, "--generated", tmp_path, "--json").stdout)
    assert said["passed"]


@pytest.fixture(scope="module")
def bound(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package of small and some of its bindings."""
    generated = tmp_path_factory.mktemp("bound")
    machine = repository / "machines" / "small.toml"
    done("generate", machine, "--out", generated / "small", "--bindings", "python,fmu3")
    return generated


def package_check(repository: Path, generated: Path) -> str:
    """What of the package is wrong; nothing: empty."""
    machine = repository / "machines" / "small.toml"
    said = json.loads(run("ci", machine, "--generated", generated, "--json").stdout)
    (check,) = [c for c in said["checks"] if c["name"] == "package"]
    return str(check["failure"])


@pytest.mark.slow
def test_a_package_with_bindings_is_compared_with_them(repository: Path, bound: Path) -> None:
    assert package_check(repository, bound) == ""


@pytest.mark.slow
def test_an_fmu_that_another_compiler_made_is_the_same_package(repository: Path, bound: Path, tmp_path: Path) -> None:
    shutil.copytree(bound / "small", tmp_path / "small")
    fmu, manifest = tmp_path / "small" / "small_fmi3.fmu", tmp_path / "small" / "MANIFEST.json"
    before = hashlib.sha256(fmu.read_bytes()).hexdigest()
    _rewrite(fmu, lambda path, data: b"another binary" if path.startswith("binaries/") else data)
    after = hashlib.sha256(fmu.read_bytes()).hexdigest()
    assert before != after
    assert "(MANIFEST.json)" in package_check(repository, tmp_path)  # its digest is the other one's
    manifest.write_text(manifest.read_text().replace(before, after))
    assert package_check(repository, tmp_path) == ""
    _rewrite(fmu, lambda path, data: data + b" " if path == "modelDescription.xml" else data)
    assert "(MANIFEST.json, small_fmi3.fmu)" in package_check(repository, tmp_path)


@pytest.mark.slow
def test_a_binding_that_is_not_what_the_file_gives_is_named(repository: Path, bound: Path, tmp_path: Path) -> None:
    shutil.copytree(bound / "small", tmp_path / "small")
    (tmp_path / "small" / "small.py").write_text("changed\n")
    failure = package_check(repository, tmp_path)
    assert "1 files are not what the machine file gives (small.py)" in failure
    assert failure.endswith(" --bindings python,fmu3")
    (tmp_path / "small" / "small.hpp").write_text("// of nothing in the manifest\n")
    assert "4 files" in package_check(repository, tmp_path)  # a binding to install is in CMakeLists.txt too


def _rewrite(archive: Path, change: Callable[[str, bytes], bytes]) -> None:
    """Write an archive anew, its entries changed."""
    with zipfile.ZipFile(archive) as opened:
        entries = [(entry, opened.read(entry)) for entry in opened.infolist()]
    with zipfile.ZipFile(archive, "w") as opened:
        for entry, data in entries:
            opened.writestr(entry, change(entry.filename, data))


def test_what_cannot_be_generated_fails_and_the_rest_is_left_out(tmp_path: Path) -> None:
    machine, report = tmp_path / "small.toml", tmp_path / "report.xml"
    machine.write_text(SMALL.replace("mass = 20.0", "mass = -20.0"))
    result = run("ci", machine, "--generated", tmp_path, "--junit", report)
    assert result.exit_code == 1
    assert "plant.mass = -20" in result.stdout
    suite = ElementTree.parse(report).getroot()[0]
    assert (suite.get("failures"), suite.get("skipped")) == ("1", "3")
    assert "plant.mass" in str(suite[0][0].get("message"))


def test_a_missing_package_says_how_to_make_it(repository: Path, tmp_path: Path) -> None:
    machine = repository / "machines" / "small.toml"
    result = run("ci", machine, "--generated", tmp_path / "none")
    assert result.exit_code == 1
    assert f"no package; sgms-mhe generate {machine} --out" in result.stdout


def test_a_compiler_that_refuses_is_a_failure(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "cc"
    broken.write_text("#!/bin/sh\necho 'no such processor' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    machine = repository / "machines" / "small.toml"
    said = json.loads(run("ci", machine, "--generated", repository / "generated", "--json").stdout)
    failures = {c["name"]: c["failure"] for c in said["checks"] if c["failure"]}
    assert "no such processor" in failures["self-test"]


def test_a_folder_without_machines_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "a folder with machine files (*.toml), or machines by name" in refused("ci")


@pytest.mark.parametrize("forge", ["github.yml", "gitlab.yml", "Dockerfile"])
def test_example_workflows_call_commands_that_exist(forge: str, repo_root: Path) -> None:
    text = (repo_root / "examples" / "ci" / forge).read_text()
    (line,) = [line for line in re.sub(r'[",]+ ?', " ", text).replace("  ", " ").splitlines() if "sgms-mhe ci" in line]
    options = {word for word in line.split() if word.startswith("--")}
    help_text = done("ci", "--help").stdout
    assert options
    assert all(option in help_text for option in options)


@pytest.mark.slow
def test_example_of_a_hook_stops_at_a_machine_file_that_is_wrong(tmp_path: Path, repo_root: Path) -> None:
    text = (repo_root / "examples" / "ci" / "pre-commit-config.yaml").read_text()
    hook = dict(re.findall(r"^ +(entry|files): (.+)$", text, re.MULTILINE))
    right, wrong = tmp_path / "right.toml", tmp_path / "wrong.toml"
    right.write_text('name = "right"\nextends = "etel_xy"\n')
    wrong.write_text('name = "wrong"\nextends = "etel_xy"\n[plant]\nmass = -1.0\n')
    assert re.search(hook["files"], "machines/axis.toml") and not re.search(hook["files"], "pyproject.toml")
    path = {"PATH": os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))}
    for files, code in (((right, right), 0), ((wrong, right), 2), ((right, wrong), 2)):
        command = [*shlex.split(hook["entry"]), *map(str, files)]
        assert subprocess.run(command, env={**os.environ, **path}, check=False).returncode == code
