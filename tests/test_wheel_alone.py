"""Somebody with the wheel in an environment of its own: a joint in Python, and the commands, without a checkout."""

import json
import os
import re
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

JOINT = """
import json, sys
import numpy as np, pandas as pd
import sgms_mhe

rng = np.random.default_rng(3)
rate, seconds = 500.0, 12.0
t = np.arange(int(rate * seconds)) / rate
speed = 2.0 * np.sin(2.1 * t) * np.sin(0.37 * t + 0.5)
angle = np.round(np.cumsum(speed) / rate, 4)
torque = 0.05 * np.gradient(speed, t) + 0.8 * np.tanh(speed / 1e-3) + 0.1 * speed + 0.01 * rng.standard_normal(len(t))
frame = pd.DataFrame({"t [s]": t, "joint position [rad]": angle, "joint torque [Nm]": torque})

found = sgms_mhe.identify(frame, inertia=0.05)
numbers = {number.name: number.value for number in found.numbers}
machine = found.machine
left = sgms_mhe.predict(machine, frame).to_frame()
package = sgms_mhe.generate(machine, "joint_c")
exported = sgms_mhe.export(machine, "mujoco")
print(json.dumps({
    "where": sgms_mhe.__file__,
    "numbers": numbers,
    "left": float((left["friction_measured_Nm"] - left["friction_Nm"]).std()),
    "files": [str(name) for name in package.files],
    "exported": exported.text,
}))
"""


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the Python of a new environment: the wheel, and what it depends on, nothing of the checkout."""
    folder = tmp_path_factory.mktemp("alone")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder / "venv")], check=True)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    site = folder / "venv" / "lib" / version / "site-packages"
    # A wheel is installed by unpacking it; a folder named in a .pth file gives its packages, not its editable ones.
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(site)
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    return folder / "venv" / "bin" / "python"


def run(python: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    own = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "SGMS_MHE"))}
    return subprocess.run(
        [str(python), *arguments], cwd=folder, env=own, capture_output=True, text=True, check=False, timeout=600
    )


@pytest.mark.slow
def test_a_joint_in_python(environment: Path, tmp_path: Path) -> None:
    done = run(environment, tmp_path, "-c", JOINT)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout.splitlines()[-1])
    assert Path(said["where"]).is_relative_to(environment.parents[1])
    assert said["numbers"]["coulomb"] == pytest.approx(0.8, rel=0.03)
    assert said["numbers"]["viscous"] == pytest.approx(0.1, rel=0.1)
    assert said["left"] < 0.2  # a reversal shows up to two steps of the encoder late
    assert (tmp_path / "joint_c").is_dir() and any(name.endswith("_selftest.c") for name in said["files"])
    assert 'lugre="' in said["exported"]


@pytest.mark.slow
def test_commands(environment: Path, tmp_path: Path) -> None:
    for line in (
        "check etel_xy",
        "simulate etel_xy --duration 2 --out log.csv",
        "estimate etel_xy log.csv --out e.csv",
    ):
        done = run(environment, tmp_path, "-m", "sgms_mhe", *line.split())
        assert done.returncode == 0, done.stderr
    refused = run(environment, tmp_path, "-m", "sgms_mhe", "experiment")
    # The checkout's workbench is found here, by its entry points, and cannot be imported.
    assert refused.returncode == 2 and re.match(r"Error: sgms-mhe-bench .*: command experiment = ", refused.stderr)
