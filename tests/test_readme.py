"""The README's C example compiles against the committed package, with every warning an error."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from sgms_mhe.support.toolchain import WARNING_FLAGS, compiler


def test_c_example_compiles(repo_root: Path, tmp_path: Path) -> None:
    blocks = re.findall(r"```c\n(.*?)```", (repo_root / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    assert blocks, "the README has no C example"
    source = tmp_path / "example.c"
    # The example's functions are called by a firmware; a prototype is all they lack here.
    prototypes = "void start(void);\ndouble control_tick(double, double);\nint first_stiffness(double *, double *);\n"
    source.write_text(prototypes + "\n".join(blocks), encoding="utf-8")
    package = repo_root / "generated" / "etel_xy"
    done = subprocess.run(
        [*compiler(), "-std=c99", *WARNING_FLAGS, f"-I{package}", "-c", str(source), "-o", str(tmp_path / "example.o")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
