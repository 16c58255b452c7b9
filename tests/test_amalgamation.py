"""A package as one source and one header: no warning, the same bits, nothing else in the folder's C."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from c_packages import STRICT, compile_object, machine, run, written
from cli_cases import SMALL, done
from sgms_mhe.emission.package import emit_package

Tool = Callable[[str], str]
MOTION = """
#include "etel_xy.h"
#include <stdio.h>
int main(void)
{
    static etel_xy_t axis;
    etel_xy_estimate_t e;
    int status = etel_xy_check(sizeof axis, ETEL_XY_HEADER);
    etel_xy_init(&axis);
    for (long k = 0; k <= 6000; k++) {
        const double forth = (double)((k / 1500) % 2 ? 1500 - k % 1500 : k % 1500) / 1500.0;
        const etel_xy_position position = etel_xy_position_from_metres(0.3 + 1e-3 * forth);
        const double force = (double)etel_xy_tick(&axis, position, (etel_xy_real)((k / 1500) % 2 ? -4 : 4));
        etel_xy_estimate(&axis, &e);
        printf("%.17g %.17g %.17g %d\\n", force, (double)e.parameter[0], (double)e.deviation[0], e.status);
    }
    return status;
}
"""
SHAPES: dict[str, dict[str, Any]] = {
    "flow": {},
    "merged, auto": {
        "sampling": {"integrator": {"scheme": "flow", "substeps": 20}},
        "estimator": {"relinearise": "auto"},
    },
    "ekf, rk4": {"sampling": {"integrator": {"scheme": "rk4"}}, "estimator": {"kind": "ekf"}},
    "effects": {"effects": [{"name": "dwell_dependence"}, {"name": "force_ripple"}]},
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "precision"),
    [("flow", "double"), ("flow", "single"), ("merged, auto", "single"), ("ekf, rk4", "single"), ("effects", "double")],
)
def test_compiles_without_a_warning_and_gives_the_same_bits(
    shape: str, precision: str, require_tool: Tool, tmp_path: Path
) -> None:
    settings = machine(**SHAPES[shape], code={"precision": precision})
    apart, joined = (
        written(emit_package(settings, selftest=False, amalgamate=amalgamate), tmp_path / str(amalgamate))
        for amalgamate in (False, True)
    )
    assert {path.name for path in joined.iterdir() if path.suffix in (".c", ".h")} == {"etel_xy.c", "etel_xy.h"}
    assert (joined / "etel_xy.h").read_bytes() == (apart / "etel_xy.h").read_bytes()
    source = joined / "etel_xy.c"
    assert re.findall(r'#include "(.*)"', source.read_text()) == ["etel_xy.h"]
    for compiler in ("gcc", "clang"):
        compile_object(require_tool(compiler), source, STRICT, "-O1")
    run(require_tool("g++"), "-std=c++17", "-Wall", "-Wextra", "-Werror", "-x", "c++", "-fsyntax-only", source)
    (tmp_path / "main.c").write_text(MOTION)
    said = []
    for folder in (apart, joined):
        files = [tmp_path / "main.c", folder / "etel_xy.c", "-o", folder / "program"]
        run(require_tool("gcc"), "-std=c99", "-O2", f"-I{folder}", *files)
        said.append(run(folder / "program"))
    assert said[0] == said[1] and len(set(said[0].splitlines())) > 4000


def test_command_emits_it_with_the_self_test(require_tool: Tool, tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL)
    folder = tmp_path / "out"
    files = json.loads(done("generate", tmp_path / "small.toml", "--out", folder, "--amalgamate", "--json").stdout)[
        "files"
    ]
    assert {file for file in files if file.endswith((".c", ".h"))} == {"small.c", "small.h"}
    assert (folder / "files.txt").read_text() == "small.c\nsmall.h\n"
    (tmp_path / "main.c").write_text('#include "small.h"\nint main(void)\n{\n    return small_selftest();\n}\n')
    files = [tmp_path / "main.c", folder / "small.c", "-o", tmp_path / "program"]
    run(require_tool("gcc"), STRICT, f"-I{folder}", *files)
    run(tmp_path / "program")
    done("generate", tmp_path / "small.toml", "--out", folder)  # the one takes the other's place
    assert (folder / "small_config.h").is_file()
