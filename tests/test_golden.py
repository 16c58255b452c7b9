"""The whole emitted folder of a toy machine, kept in git: what a change does to the C shows as a diff.

    python tests/test_golden.py --update

rewrites the folders; the diff is then reviewed and committed with the change that caused it.
"""

import sys
from pathlib import Path

import pytest

from sgms_mhe.configuration import load_machine
from sgms_mhe.emission.delivery import MANIFEST
from sgms_mhe.emission.package import emit_package

pytestmark = pytest.mark.core

GOLDEN = Path(__file__).parent / "golden"
UPDATE = "python tests/test_golden.py --update"
MACHINES = sorted(path.stem for path in GOLDEN.glob("*.toml"))


def emitted(name: str) -> dict[str, str]:
    """Files of a machine's package but for the digests of the others."""
    files = dict(emit_package(load_machine(GOLDEN / f"{name}.toml")).files)
    del files[MANIFEST]
    return files


def stored(folder: Path) -> dict[str, str]:
    """Files of a folder."""
    return {path.name: path.read_text(encoding="utf-8") for path in sorted(folder.iterdir())} if folder.is_dir() else {}


@pytest.mark.parametrize("name", MACHINES)
def test_package_is_the_golden_one(name: str) -> None:
    before, after = stored(GOLDEN / name), emitted(name)
    changed = [file for file in before.keys() | after.keys() if before.get(file) != after.get(file)]
    assert not changed, f"if this is meant: {UPDATE}, and see git diff"


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
