"""A friction curve: its numbers in a machine file, and its shape."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sgms_mhe.configuration import load_machine
from sgms_mhe.model import build_model
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]

ENTRY = """extends = "etel_xy"
name = "curved"
[[effects]]
name = "friction_curve"
speed_m_s = {speeds}
forward_N = [1.0, 0.5]
backward_N = [0.4, -0.2]
end_m_s = {end}
"""


def write(folder: Path, speeds: str = "[0.01, 0.1]", end: str = "0.3") -> Path:
    path = folder / "curved.toml"
    path.write_text(ENTRY.format(speeds=speeds, end=end), encoding="utf-8")
    return path


def added(machine: Path | str, velocities: Array) -> Array:
    """Friction of a model beyond that of the machine without its effects, at constant speeds (n) [N]."""
    outputs = [build_model(load_machine(source)).function("output") for source in (machine, "etel_xy")]
    rows = ([0.0, v, 0.0, 0.0, 0.0] for v in velocities)
    found = [[float(output(np.zeros(4), w, np.ones(4))) for output in outputs] for w in rows]
    return np.array([here - there for here, there in found])


def test_curve_runs_smoothly_through_its_knots_and_is_none_beyond_them(tmp_path: Path) -> None:
    curved = write(tmp_path)
    ends = np.array([0.0, 0.01, 0.1, 0.3])
    np.testing.assert_allclose(added(curved, ends), [0.0, 1.0, 0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(added(curved, -ends), [0.0, -0.4, 0.2, 0.0], atol=1e-12)
    np.testing.assert_array_equal(added(curved, np.array([0.31, -0.9])), 0.0)
    for at in (0.01, -0.01, 0.1, -0.1):  # one slope on both sides of a knot
        before, here, behind = added(curved, at + np.array([-1e-7, 0.0, 1e-7]))
        assert here - before == pytest.approx(behind - here, rel=1e-3)


def test_curve_of_a_parabola_is_that_parabola(tmp_path: Path) -> None:
    """Slopes are those of parabolas, so that where the values lie on one the curve is it, between knots too."""
    speeds = np.array([0.02, 0.05, 0.15])
    forces = 40.0 * speeds * (0.3 - speeds)
    text = ENTRY.format(speeds=speeds.tolist(), end="0.3")
    lists = f"forward_N = {forces.tolist()}\nbackward_N = {forces.tolist()}"
    path = tmp_path / "curved.toml"
    path.write_text(text.replace("forward_N = [1.0, 0.5]\nbackward_N = [0.4, -0.2]", lists), encoding="utf-8")
    v = np.linspace(-0.29, 0.29, 59)
    np.testing.assert_allclose(added(path, v), 40.0 * v * (0.3 - np.abs(v)), atol=1e-9)


@pytest.mark.parametrize(
    ("speeds", "end"), [("[0.1, 0.01]", "0.3"), ("[0.01, 0.01]", "0.3"), ("[0.01, 0.3]", "0.3"), ("[0.01, 0.4]", "0.3")]
)
def test_speeds_that_do_not_ascend_to_the_end_are_refused(speeds: str, end: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"curved\.toml.*speed_m_s = \[.*ascend, all below 0.3, the curve's end"):
        load_machine(write(tmp_path, speeds, end))


def test_speeds_that_just_ascend_are_read(tmp_path: Path) -> None:
    (effect,) = load_machine(write(tmp_path, "[0.01, 0.2999]")).effects
    assert effect.parameters["speed_m_s"] == (0.01, 0.2999)
