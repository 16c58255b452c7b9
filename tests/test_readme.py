"""C examples of the documents compile against the committed package, with every warning an error."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from sgms_mhe.support.toolchain import WARNING_FLAGS, compiler

# The examples' functions are called by a firmware; a prototype is all they lack here.
PROTOTYPES = {
    "README.md": "void start(void);\ndouble control_tick(double, double);\nint first_stiffness(double *, double *);\n",
    "docs/own_axis.md": "double fast_task(double, double);\nvoid slow_task(void);\n",
}


@pytest.mark.parametrize("page", PROTOTYPES)
def test_c_example_compiles(page: str, repo_root: Path, tmp_path: Path) -> None:
    blocks = re.findall(r"```c\n(.*?)```", (repo_root / page).read_text(encoding="utf-8"), flags=re.DOTALL)
    assert blocks, f"{page} has no C example"
    source = tmp_path / "example.c"
    source.write_text(PROTOTYPES[page] + "\n".join(blocks), encoding="utf-8")
    package = repo_root / "generated" / "etel_xy"
    done = subprocess.run(
        [*compiler(), "-std=c99", *WARNING_FLAGS, f"-I{package}", "-c", str(source), "-o", str(tmp_path / "example.o")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_every_page_with_c_is_compiled(repo_root: Path) -> None:
    pages = [*repo_root.glob("*.md"), *repo_root.glob("docs/*.md")]
    assert {page.relative_to(repo_root).as_posix() for page in pages if "```c\n" in page.read_text("utf-8")} == set(
        PROTOTYPES
    )
