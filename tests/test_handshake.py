"""The handshake: an application compiled against another header than the package's is refused."""

import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from c_packages import PRECISIONS, STRICT, compile_object, package_of, run, written
from sgms_mhe.emission.rendering import declared_digest

APPLICATION = """
#include "etel_xy.h"
#include <stdio.h>
int main(void)
{
    const int status = etel_xy_check(sizeof(etel_xy_t), ETEL_XY_HEADER);
    printf("%d %s %s %s", status, etel_xy_status_text(status), ETEL_XY_VERSION, ETEL_XY_MACHINE);
    return status != ETEL_XY_OK;
}
"""

OTHERS: dict[str, dict[str, Any]] = {
    "another mass": {"plant": {"mass": 21.0}},
    "another horizon": {"estimator": {"horizon": 5}},
    "another precision": {"code": {"precision": "single"}},
}


def folder_of(folder: Path, **changes: Any) -> Path:
    return written(package_of(**changes), folder)


def said(library: Path, header: Path, scratch: Path, tool: str, *flags: str) -> subprocess.CompletedProcess[str]:
    """What an application compiled with `header` hears from the package in `library`."""
    scratch.mkdir()
    (scratch / "application.c").write_text(APPLICATION)
    package = compile_object(tool, library / "etel_xy.c", STRICT)
    run(tool, STRICT, flags, f"-I{header}", "-c", scratch / "application.c", "-o", scratch / "application.o")
    run(tool, scratch / "application.o", package, "-o", scratch / "program")
    return subprocess.run([scratch / "program"], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_own_header_is_accepted(precision: str, require_tool: Callable[[str], str], tmp_path: Path) -> None:
    folder = folder_of(tmp_path, code={"precision": precision})
    done = said(folder, folder, tmp_path / "scratch", require_tool("gcc"))
    banner = (folder / "etel_xy.h").read_text().splitlines()[0]
    version, digest = re.findall(r"sgms-mhe (\S+) from machine (\w{12})", banner)[0]
    assert (done.returncode, done.stdout) == (0, f"0 good {version} {digest}")


@pytest.mark.parametrize("other", OTHERS)
def test_another_header_is_refused(other: str, require_tool: Callable[[str], str], tmp_path: Path) -> None:
    library, header = folder_of(tmp_path / "a"), folder_of(tmp_path / "b", **OTHERS[other])
    done = said(library, header, tmp_path / "scratch", require_tool("gcc"))
    assert done.returncode == 1 and done.stdout.startswith("-4 refused: the application was compiled against another")


def test_another_layout_of_the_same_header_is_refused(require_tool: Callable[[str], str], tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    done = said(folder, folder, tmp_path / "scratch", require_tool("gcc"), "-fpack-struct=1")
    assert done.returncode == 1 and done.stdout.startswith("-4 ")


def test_digest_is_of_declarations_alone() -> None:
    header = "/* one */\nint a(int b); /* two */\n"
    assert declared_digest(header) == declared_digest("int  a(int b);\n/* other\n words */")
    assert declared_digest(header) != declared_digest(header.replace("int b", "long b"))
    assert len(declared_digest(header)) == 8
