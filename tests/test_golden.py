"""The whole emitted folder of a toy machine, kept in git: what a change does to the C shows as a diff.

    python tests/test_golden.py --update

rewrites the folders; the diff is then reviewed and committed with the change that caused it.
"""

from __future__ import annotations

import difflib
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.delivery import MANIFEST
from sgms_mhe.emission.package import emit_package

pytestmark = pytest.mark.core

GOLDEN = Path(__file__).parent / "golden"
UPDATE = "python tests/test_golden.py --update"
MACHINES = sorted(path.stem for path in GOLDEN.glob("*.toml"))
DIFF_LINES = 200


def emitted(name: str) -> dict[str, str]:
    """Files of a machine's package but for the digests of the others."""
    files = dict(emit_package(load_machine(GOLDEN / f"{name}.toml")).files)
    del files[MANIFEST]
    return files


def stored(folder: Path) -> dict[str, str]:
    """Files of a folder."""
    return {path.name: path.read_text(encoding="utf-8") for path in sorted(folder.iterdir())} if folder.is_dir() else {}


def difference(before: Mapping[str, str], after: Mapping[str, str]) -> str:
    """Unified diff of two folders, empty where they are the same."""
    lines: list[str] = []
    for file in sorted(before.keys() | after.keys()):
        old, new = (side.get(file, "").splitlines() for side in (before, after))
        lines += difflib.unified_diff(old, new, f"golden/{file}", f"emitted/{file}", lineterm="", n=2)
        if (file in before) != (file in after):
            lines.append(f"{file}: {'no longer emitted' if file in before else 'not in the golden folder'}")
    return "\n".join(lines)


def check_folder(before: Mapping[str, str], after: Mapping[str, str]) -> None:
    """Fail with the diff and the command that updates the folder."""
    diff = difference(before, after)
    if diff:
        shown = diff.splitlines()
        more = [f"... {len(shown) - DIFF_LINES} more lines"] if len(shown) > DIFF_LINES else []
        pytest.fail("\n".join([*shown[:DIFF_LINES], *more, "", f"if this is meant: {UPDATE}"]), pytrace=False)


@pytest.mark.parametrize("name", MACHINES)
def test_package_is_the_golden_one(name: str) -> None:
    check_folder(stored(GOLDEN / name), emitted(name))


def test_difference_is_shown_with_the_command_that_updates() -> None:
    before = {"a.c": "one\ntwo\n", "gone.h": "x\n"}
    check_folder(before, dict(before))
    with pytest.raises(pytest.fail.Exception) as failure:
        check_folder(before, {"a.c": "one\nthree\n", "new.h": "y\n"})
    text = str(failure.value)
    for part in ("-two", "+three", "gone.h: no longer emitted", "new.h: not in the golden folder", UPDATE):
        assert part in text


def update() -> None:
    """Rewrite every golden folder."""
    for name in MACHINES:
        folder = GOLDEN / name
        folder.mkdir(exist_ok=True)
        for path in folder.iterdir():
            path.unlink()
        for file, text in emitted(name).items():
            (folder / file).write_text(text, encoding="utf-8")
        print(f"{folder}: {len(stored(folder))} files")


if __name__ == "__main__":
    if sys.argv[1:] != ["--update"]:
        sys.exit(f"usage: {UPDATE}")
    update()
