"""What an installation carries, and the rule that CI does not skip."""

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import sgms_mhe
from sgms_mhe.support import paths

FOLDERS = {"templates": paths.templates_dir, "runtime_c": paths.runtime_dir, "machines": paths.machines_dir}

SESSION = """
import pytest

def test_runs():
    pass

@pytest.mark.skip(reason={reason!r})
def test_skips():
    pass

@pytest.mark.xfail(strict=True)
def test_fails_as_expected():
    raise AssertionError
"""


@pytest.mark.parametrize("name", FOLDERS)
def test_folder_of_the_checkout_is_found(name: str, repo_root: Path) -> None:
    assert FOLDERS[name]() == repo_root / name


@pytest.mark.slow
def test_wheel_carries_every_file_of_the_data_folders(repo_root: Path, wheel: Path) -> None:
    packed = set(zipfile.ZipFile(wheel).namelist())
    for name in FOLDERS:
        for path in (repo_root / name).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                assert f"sgms_mhe/_data/{path.relative_to(repo_root).as_posix()}" in packed
    assert "sgms_mhe/py.typed" in packed
    # The workbench stays in the checkout: its modules, its C programs, its commands.
    workbench = {path.name for path in (repo_root / "bench" / "c").iterdir()}
    assert {Path(file).parts[0] for file in packed} == {"sgms_mhe", f"sgms_mhe-{sgms_mhe.__version__}.dist-info"}
    assert "harness.c" in workbench and not workbench & {Path(file).name for file in packed}


def test_missing_data_folder_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(paths, "_BUNDLED", tmp_path / "a")
    monkeypatch.setattr(paths, "_CHECKOUT", tmp_path / "b")
    with pytest.raises(FileNotFoundError, match="templates/ is neither in"):
        paths.templates_dir()


def test_lock_holds_every_declared_dependency_at_one_version(repo_root: Path) -> None:
    project = tomllib.loads((repo_root / "pyproject.toml").read_text())
    declared = project["project"]["dependencies"] + project["project"]["optional-dependencies"]["dev"]
    declared += project["build-system"]["requires"]
    bench = tomllib.loads((repo_root / "bench" / "pyproject.toml").read_text())["project"]["dependencies"]
    declared += [name for name in bench if name != project["project"]["name"]]
    lines = (repo_root / "requirements.lock").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[^ ;@]+", pin) for pin in pins)
    locked = {_normal(pin.partition("==")[0]) for pin in pins}
    assert locked >= {_normal(re.split(r"[<>=!~\[; ]", entry)[0]) for entry in declared}


def test_newest_version_of_the_changelog_is_this_one(repo_root: Path) -> None:
    sections = re.findall(r"^## (\S+)", (repo_root / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert next(name for name in sections if name != "Unreleased") == sgms_mhe.__version__


RELEASE = {
    "generator/sgms_mhe/__init__.py": '__version__ = "1.2.3"\n',
    "CITATION.cff": "version: 1.2.3\n",
    "CHANGELOG.md": "# Changelog\n\n## 1.2.3 (2026-01-31)\n",
}


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("README.md", "", ""),
        ("CITATION.cff", "version: 1.2.2\n", "CITATION.cff is not of version 1.2.3"),
        ("CHANGELOG.md", "## Unreleased\n\n## 1.2.3 (2026-01-31)\n", "does not begin with '## 1.2.3 (year-month-day)'"),
        ("CHANGELOG.md", "## 1.2.3\n", "does not begin with '## 1.2.3 (year-month-day)'"),
        ("generator/sgms_mhe/__init__.py", '__version__ = "1.2"\n', "states no version X.Y.Z"),
        ("untracked", "", "changes are not committed"),
        ("tagged", "", "the tag v1.2.3 is taken"),
    ],
)
def test_what_a_release_needs(file: str, content: str, message: str, repo_root: Path, tmp_path: Path) -> None:
    def git(*arguments: str) -> None:
        identity = [
            "-c",
            "user.name=a",
            "-c",
            "user.email=a@b.c",
            "-c",
            "tag.gpgsign=false",
            "-c",
            "commit.gpgsign=false",
        ]
        subprocess.run(["git", *identity, *arguments], cwd=tmp_path, check=True, capture_output=True)

    for name, text in (RELEASE | {file: content}).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    git("init")
    git("add", "--all")
    if file == "untracked":
        git("rm", "-q", "--cached", file)
    git("commit", "-m", "all")
    if file == "tagged":
        git("tag", "v1.2.3")
    ran = subprocess.run([repo_root / ".ci" / "release-check", tmp_path], check=False, capture_output=True, text=True)
    assert ran.returncode == bool(message)
    assert message in ran.stderr if message else ran.stdout == "v1.2.3 can be tagged\n"


@pytest.mark.parametrize(
    ("ci", "reason", "code", "workers"),
    [
        ("1", "tool absent: valgrind", 1, []),
        ("1", "tool absent: valgrind", 1, ["-n", "2"]),
        ("1", "measured data absent: x.mat", 0, []),
        ("", "tool absent: valgrind", 0, []),
    ],
)
def test_skip_fails_a_ci_session_unless_allowed(
    ci: str,
    reason: str,
    code: int,
    workers: list[str],
    repo_root: Path,
    pytester: pytest.Pytester,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("SGMS_MHE_CI", ci)
    pytester.makeconftest((repo_root / "tests" / "conftest.py").read_text())
    pytester.makepyfile(SESSION.format(reason=reason))
    result = pytester.runpytest_subprocess(*workers)
    assert result.ret == code
    result.assert_outcomes(passed=1, skipped=1, xfailed=1)
    listed = f"*test_skips: {reason}"
    if code:
        result.stdout.fnmatch_lines(["*checks that CI must run were skipped*", listed])
    else:
        result.stdout.no_fnmatch_line(listed)


@pytest.mark.slow
def test_skip_of_a_whole_module_fails_a_ci_session(
    repo_root: Path, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SGMS_MHE_CI", "1")
    pytester.makeconftest((repo_root / "tests" / "conftest.py").read_text())
    pytester.makepyfile(
        test_a="def test_runs():\n    pass\n", test_b="import pytest\n\npytest.importorskip('no_such_module')\n"
    )
    result = pytester.runpytest_subprocess("-n", "2")
    assert result.ret == 1
    result.stdout.fnmatch_lines(["*checks that CI must run were skipped*", "test_b.py: *no_such_module*"])


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_another_system_is_refused_by_what_to_do() -> None:
    code = "import os; os.name = 'nt'; import sgms_mhe"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "ImportError: sgms-mhe runs on Linux and macOS; on Windows in WSL" in done.stderr
