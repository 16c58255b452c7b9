"""Work of one tick is bounded, whatever comes in: by that of a motion at max_velocity."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from c_packages import PROBES, STRICT, Array, build, compile_object, machine, run, scheme, written
from package_variants import EFFECTS
from sgms_mhe.emission.package import emit_package
from sgms_mhe.host.compiled import replay_definitions

MAX_VELOCITY = 0.05  # m/s; work at it is what a coupled block's tick takes longest for


def effects(*names: str) -> list[dict[str, Any]]:
    return [{"name": name, **EFFECTS[name]} for name in names]


PACKAGES: dict[str, dict[str, Any]] = {
    "flow": {},
    "flow, merged": {"sampling": scheme("flow", substeps=20)},
    "rk4": {"sampling": scheme("rk4")},
    "rk4, merged, linear": {"sampling": scheme("rk4", substeps=25)},
    "a block outside the flow": {"effects": effects("backlash")},
    "several": {
        "effects": effects("backlash", "frictional_lag", "dwell_dependence", "structural_resonance", "hose_hysteresis")
    },
}


def jumping(position: Array, kind: str) -> Array:
    """The motion, spoilt."""
    spoilt, n = position.copy(), len(position)
    if kind == "jump":
        spoilt[n // 2 :] += 0.5
    elif kind == "far jump":
        spoilt[n // 2 :] += 1e6
    elif kind == "from end to end":
        spoilt[n // 2 : n // 2 + 20] = 3.9e6 * (-1.0) ** np.arange(20)
    elif kind == "missing":
        spoilt[n // 2 : n // 2 + 30] = np.nan
        spoilt[n // 2 + 30 :] += 1.0
    return spoilt


@pytest.mark.parametrize("relinearise", ["all", "auto"])
@pytest.mark.parametrize("package", list(PACKAGES))
def test_what_comes_in_does_not_make_more_work(
    package: str, relinearise: str, require_tool: Callable[[str], str], tmp_path: Path
) -> None:
    changes = PACKAGES[package]
    sampling = {**changes.get("sampling", {}), "max_velocity": MAX_VELOCITY}
    settings = machine(**{**changes, "sampling": sampling, "estimator": {"relinearise": relinearise, "horizon": 4}})
    folder = written(emit_package(settings, selftest=False), tmp_path)
    gcc, options = require_tool("gcc"), [*STRICT, "-O1", f"-I{folder}", *replay_definitions("etel_xy")]
    made = compile_object(gcc, folder / "etel_xy.c", options, "-finstrument-functions")
    program = build(gcc, [PROBES / "work.c", made], tmp_path / "program", options)

    def work(position: Array) -> Array:
        samples = tmp_path / "samples.bin"
        np.column_stack([position, np.full(len(position), 3.0)]).tofile(samples)
        return np.array([int(line) for line in run(program, samples).split()])

    # Back and forth, up to max_velocity and a little below it, every element breaking away again and again.
    steps = np.concatenate([speed * np.sin(0.02 * np.arange(800)) for speed in (0.01, 0.5, 1.0, 1.0)]) * MAX_VELOCITY
    steps = np.concatenate([steps, np.full(600, 0.999 * MAX_VELOCITY), np.full(600, -0.999 * MAX_VELOCITY)])
    regular = work(np.cumsum(steps) * settings.sampling.step)
    # Elements that a jump takes over many deflection scales ask for more steps ahead than at this speed, which is most
    # of all work where few intervals are linearised anew; blocks that are neither elements nor follow the flow, whose
    # work is the largest, for none.
    allowed = 1.05 if "effects" in changes else 2.0 if relinearise == "all" else 3.0
    slow = np.cumsum(1e-3 * np.sin(0.02 * np.arange(1500))) * settings.sampling.step
    for kind in ("jump", "far jump", "from end to end", "missing"):
        worst = work(jumping(slow, kind))
        assert worst.max() <= allowed * regular.max(), f"{kind}: {worst.max()} functions at tick {worst.argmax()}"
    assert "effects" not in changes or regular.max() > 20.0 * work(slow).max()
