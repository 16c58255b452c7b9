"""The axis as an FMU: what the standard says of it, the motion that `simulate` makes of the same force, refusals."""

import math
import re
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.build import build_platform_binary
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

import sgms_mhe
from c_packages import STRICT, compile_object, run, symbols
from export_cases import drive_force, machine_of_effect, machine_with, slave_of
from package_variants import EFFECTS, GEARED
from sgms_mhe.emission.axis_forms import axis_numbers
from sgms_mhe.machine import Machine
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.native import loaded_library
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import make_trajectory
from sgms_mhe.support.errors import InputError

Tool = Callable[[str], str]
VERSIONS = (2, 3)
HEADERS = Path(fmpy.__file__).parent / "c-code"
BARE = AxisConfig(current_loop_Hz=math.inf, encoder_resolution_m=0.0, force_noise_N=0.0)
"""A drive without a lag, so that the force of a sample is what the controller asked for; nothing drawn, no steps."""


def exported(machine: Machine, version: int, folder: Path) -> Path:
    path = folder / "axis.fmu"
    result = sgms_mhe.export(machine, f"fmu{version}", path)
    assert result.missing is None and path.read_bytes() == result.content
    return path


def test_effects_name_their_parameters_in_the_order_of_the_plant() -> None:
    """The FMU places parameters by it."""
    from sgms_mhe.model.effects import effect_definition

    found = dict(loaded_library().effects)
    assert set(found) == {*EFFECTS, *GEARED}
    for name, names in found.items():
        assert tuple(p.name for p in effect_definition(name).parameters) == names


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("base", ["etel_xy", "etel_xy_switching", "etel_xy_rotary"])
def test_it_is_valid_and_every_number_has_a_unit(base: str, version: int, tmp_path: Path) -> None:
    machine = machine_of_effect("position_map") if base == "etel_xy" else machine_with(base=base)
    path = exported(machine, version, tmp_path)
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    variables = {v.name: v for v in description.modelVariables if v.name != "time"}
    assert all(v.unit for v in variables.values())
    assert {v.unit for v in variables.values()} <= {unit.name for unit in description.unitDefinitions}
    numbers = axis_numbers(machine)
    tunable = [v for v in variables if (variables[v].causality, variables[v].variability) == ("parameter", "tunable")]
    assert tunable == [n.name for n in numbers]
    for number in numbers:
        assert float(variables[number.name].start) == number.value
        assert variables[number.name].unit == (number.unit.replace("^", "").replace(" ", ".") or "1")
    inert = machine.plant.units.inert
    assert variables[inert].unit == {"mass": "kg", "inertia": "kg.m2"}[inert]


def test_units_are_made_of_base_units(tmp_path: Path) -> None:
    description = fmpy.read_model_description(str(exported(machine_with(base="etel_xy_rotary"), 3, tmp_path)))
    found = {unit.name: unit.baseUnit for unit in description.unitDefinitions}
    assert (found["N.m.s/rad"].kg, found["N.m.s/rad"].m, found["N.m.s/rad"].s, found["N.m.s/rad"].rad) == (1, 2, -1, -1)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_glue_agrees_with_the_headers_of_the_standard(
    compiler: str, version: int, require_tool: Tool, tmp_path: Path
) -> None:
    machine = machine_of_effect("position_map")
    zipfile.ZipFile(exported(machine, version, tmp_path)).extractall(tmp_path)
    glue, header = tmp_path / "sources" / f"etel_xy_axis_fmi{version}.c", f"fmi{version}Functions.h"
    flags = ([], [f"-I{HEADERS}", "-include", header])
    made = [compile_object(require_tool(compiler), glue, STRICT, "-O2", words) for words in flags]
    alone, beside = ({name for kind, name in symbols(path) if kind == "T"} for path in made)
    assert beside == alone
    wanted = set(re.findall(rf"^#define (fmi{version}\w+) +fmi{version}FullName", (HEADERS / header).read_text(), re.M))
    assert alone <= wanted and len(alone) == {2: 34, 3: 75}[version]
    library = next((tmp_path / "binaries").rglob("*.so"))
    assert {name for kind, name in symbols(library, "-D") if kind == "T"} == alone


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_an_importer_builds_it_from_its_sources(
    version: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, require_tool: Tool
) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=":")
    require_tool("cmake")
    machine = machine_with()
    path = exported(machine, version, tmp_path)
    fmpy.extract(str(path), unzipdir=str(tmp_path / "own"))
    shipped = next((tmp_path / "own" / "binaries").rglob("*.so"))
    shipped.unlink()
    (tmp_path / "build").mkdir()
    build_platform_binary(tmp_path / "own", build_dir=tmp_path / "build")
    assert shipped.is_file()
    force = drive_force(machine, 0.2)
    times = np.arange(len(force)) / machine.sampling.rate
    given = np.array(list(zip(times, force, strict=True)), dtype=[("time", float), ("force", float)])
    found = fmpy.simulate_fmu(
        str(tmp_path / "own"), stop_time=0.2, output_interval=1.0 / machine.sampling.rate, input=given,
        output=["position"],
    )  # fmt: skip
    with slave_of(path, tmp_path / "shipped") as slave:
        wanted = slave.run(force, ("position",))[:, 0]
    np.testing.assert_allclose(found["position"][1 : len(wanted) + 1], wanted[: len(found) - 1], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("base", ["etel_xy", "etel_xy_switching"])
def test_it_moves_as_simulate_does(base: str, version: int, tmp_path: Path) -> None:
    effects = ("structural_resonance", "force_delay", "position_map", "encoder_periodic_error", "dwell_dependence")
    machine = machine_with(*({"name": name, **EFFECTS[name]} for name in effects), base=base)
    run = simulate_axis(machine, make_trajectory("paper", machine.sampling.rate, duration_s=1.0), BARE)
    truth = run.truth
    assert truth is not None and np.ptp(truth.position_m) > 1e-5
    names = ("position", "velocity", "friction", "effect_force", "position_measured", "force_measured")
    with slave_of(exported(machine, version, tmp_path), tmp_path / "unpacked") as slave:
        found = slave.run(truth.force_N[1:], names)
    wanted = (truth.position_m, truth.velocity_m_s, truth.friction_N, truth.effect_force_N)
    for name, column, series in zip(names, found.T, (*wanted, run.log.position_m, run.log.force_N), strict=True):
        np.testing.assert_array_equal(column, series[1:], err_msg=name)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("base", ["etel_xy", "etel_xy_switching"])
def test_it_starts_within_a_motion(base: str, version: int, tmp_path: Path) -> None:
    machine = machine_with(base=base)
    run = simulate_axis(machine, make_trajectory("paper", machine.sampling.rate, duration_s=1.0), BARE)
    truth = run.truth
    assert truth is not None
    k = int(np.argmax(np.abs(truth.velocity_m_s[: len(truth.velocity_m_s) // 2])))
    starts = {"start_position": truth.position_m[k], "start_velocity": truth.velocity_m_s[k]}
    starts |= {f"start_deflection_{i}": z for i, z in enumerate(truth.deflection_m[k], 1)}
    with slave_of(exported(machine, version, tmp_path), tmp_path / "unpacked", started=False) as slave:
        slave["start_deflection_1"] = 1.0  # no further than its level
        assert slave["friction"] < 2.0 * machine.friction.coulomb * (1.0 + machine.friction.stribeck_ratio)
        for name, value in starts.items():
            slave[name] = value
        assert slave["velocity"] == truth.velocity_m_s[k]
        slave.start()
        found = slave.run(truth.force_N[k + 1 :], ("position", "velocity"))
        with pytest.raises(FMICallException):
            slave["start_velocity"] = 0.0
    wanted = np.column_stack((truth.position_m, truth.velocity_m_s))[k + 1 :]
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("version", VERSIONS)
def test_parameters_change_the_axis_while_it_runs(version: int, tmp_path: Path) -> None:
    machine = machine_of_effect("position_map")
    force = drive_force(machine, 0.3)
    changed = machine_with({"name": "position_map", **EFFECTS["position_map"], "pitch_m": 0.006})
    (tmp_path / "other").mkdir()
    with (
        slave_of(exported(machine, version, tmp_path), tmp_path / "a", started=False) as slave,
        slave_of(exported(changed, version, tmp_path / "other"), tmp_path / "b", started=False) as other,
    ):
        slave["start_position"] = other["start_position"] = 0.0013
        assert slave["position"] == 0.0013
        slave["position_map.pitch_m"] = 0.006  # in all its places
        slave.start()
        other.start()
        np.testing.assert_array_equal(slave.run(force), other.run(force))
        slave["mass"], slave["coulomb"] = 40.0, 3.0
        heavier, same = slave.run(force, first=len(force)), other.run(force, first=len(force))
        assert (slave["mass"], slave["coulomb"]) == (40.0, 3.0) and np.abs(heavier - same).max() > 1e-5


@pytest.mark.parametrize("version", VERSIONS)
def test_its_state_is_all_of_it(version: int, tmp_path: Path) -> None:
    machine = machine_of_effect("hose_hysteresis")
    force = drive_force(machine, 0.3)
    half = len(force) // 2
    path = exported(machine, version, tmp_path)
    with slave_of(path, tmp_path / "a") as one, slave_of(path, tmp_path / "b") as other:
        old = version == 2
        one.run(force[:half])
        state = one.fmi.getFMUstate() if old else one.fmi.getFMUState()
        content = one.fmi.serializeFMUstate(state) if old else one.fmi.serializeFMUState(state)
        wanted = one.run(force[half:], first=half)
        copied = other.fmi.deSerializeFMUstate(content) if old else other.fmi.deserializeFMUState(content)
        (other.fmi.setFMUstate if old else other.fmi.setFMUState)(copied)
        np.testing.assert_array_equal(other.run(force[half:], first=half), wanted)
        with pytest.raises(FMICallException):
            (one.fmi.deSerializeFMUstate if old else one.fmi.deserializeFMUState)(b"0" + content[1:])


def test_a_state_of_another_process_is_taken(tmp_path: Path) -> None:
    """Its pointers lead nowhere here: the effects' rows are looked up again."""
    machine = machine_of_effect("hose_hysteresis")
    path = exported(machine, 3, tmp_path)
    force = drive_force(machine, 0.2)
    half = len(force) // 2
    script = (
        "import sys; sys.path[:0] = sys.argv[3:]\n"
        "from pathlib import Path\n"
        "from export_cases import drive_force, machine_of_effect, slave_of\n"
        "force = drive_force(machine_of_effect('hose_hysteresis'), 0.2)\n"
        "with slave_of(Path(sys.argv[1]), Path(sys.argv[2])) as slave:\n"
        "    slave.run(force[: len(force) // 2])\n"
        "    state = slave.fmi.getFMUState()\n"
        "    (Path(sys.argv[2]) / 'state').write_bytes(slave.fmi.serializeFMUState(state))\n"
    )
    run(sys.executable, "-c", script, path, tmp_path / "a", [str(Path(__file__).parent)])
    with slave_of(path, tmp_path / "b") as one, slave_of(path, tmp_path / "c") as other:
        wanted = one.run(force)[half:]
        other.fmi.setFMUState(other.fmi.deserializeFMUState((tmp_path / "a" / "state").read_bytes()))
        np.testing.assert_array_equal(other.run(force[half:], first=half), wanted)


@pytest.mark.parametrize("version", VERSIONS)
def test_what_it_refuses(version: int, tmp_path: Path) -> None:
    machine = machine_of_effect("structural_resonance")
    with slave_of(exported(machine, version, tmp_path), tmp_path / "a") as slave:
        for name, value in (
            ("mass", 0.0), ("mass", math.nan), ("mass", 2.0), ("stiffness_1", -1.0), ("coulomb", math.inf),
            ("start_position", 0.1), ("structural_resonance.frequency_Hz", 1e6), ("position", 0.0),
        ):  # fmt: skip
            before = slave[name]
            with pytest.raises(FMICallException):
                slave[name] = value
            assert slave[name] == before
        with pytest.raises(FMICallException):
            slave.fmi.doStep(0.0, 3.0 * slave.step_s)
        assert np.isfinite(slave.run(drive_force(machine, 0.01))).all()


def test_what_the_plant_cannot_have_is_refused_first(tmp_path: Path) -> None:
    heavy: dict[str, Any] = {"name": "structural_resonance", **EFFECTS["structural_resonance"], "mass_kg": 25.0}
    with pytest.raises(InputError, match="positive part"):
        sgms_mhe.export(machine_with(heavy), "fmu3", tmp_path / "axis.fmu")
    assert not list(tmp_path.iterdir())
