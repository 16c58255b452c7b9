"""Effects that other distributions bring: one that works, through every command, and those that are broken."""

import json
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sgms_mhe
from cli_cases import SMALL, run
from sgms_mhe.configuration import load_machine
from sgms_mhe.host.provenance import digest_of_sources
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.model.effects import (
    EFFECT_NAMES,
    broken_effects,
    cause_names,
    effect_definition,
    effect_names,
    separating_moves,
)
from sgms_mhe.model.effects.catalogue import forget_distributions
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Motion
from sgms_mhe.support.errors import InputError

EXAMPLE = Path(__file__).parents[1] / "examples" / "magnetic_preload"
NAME = "magnetic_preload"

EFFECT = f"""
[[effects]]
name = "{NAME}"
force_N = 1.5
reach_m = 0.001
centre_m = 0.001
"""
AXIS = SMALL.replace('"small"', '"preloaded"').replace('"coulomb"]', f'"{NAME}.force_N"]') + EFFECT
PLAIN = SMALL.replace('"small"', '"plain"')


def installed(site: Path, name: str, version: str, entries: dict[str, str]) -> None:
    """What an installer leaves beside a distribution's modules."""
    folder = site / f"{name.replace('-', '_')}-{version}.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = [f"{effect} = {place}" for effect, place in entries.items()]
    (folder / "entry_points.txt").write_text("\n".join(["[sgms_mhe.effects]", *lines]) + "\n")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of installed distributions, empty at first; what is put there is known from the next look on."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    before = set(sys.modules)
    forget_distributions()
    yield folder
    for module in set(sys.modules) - before:
        if (getattr(sys.modules[module], "__file__", None) or "").startswith(str(folder)):
            del sys.modules[module]
    forget_distributions()


@pytest.fixture
def example(site: Path) -> Path:
    """The example, installed as its own project file says."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())
    name, version = project["project"]["name"], project["project"]["version"]
    for module in project["tool"]["setuptools"]["py-modules"]:
        shutil.copy(EXAMPLE / f"{module}.py", site)
    installed(site, name, version, project["project"]["entry-points"]["sgms_mhe.effects"])
    return site


@pytest.fixture
def axis(tmp_path: Path) -> Path:
    path = tmp_path / "preloaded.toml"
    path.write_text(AXIS)
    return path


# --- one that works ---------------------------------------------------------------------------------------------


def test_example_is_an_effect_like_any_other(example: Path) -> None:
    assert effect_names() == (*EFFECT_NAMES, NAME) and NAME in cause_names() and not broken_effects()
    assert effect_definition(NAME).parameter("force_N").is_size
    assert separating_moves("position_spring", NAME)


def test_example_goes_through_the_machine_file(example: Path, axis: Path) -> None:
    machine = load_machine(axis)
    assert machine.effects[0].parameters == {"force_N": 1.5, "reach_m": 0.001, "centre_m": 0.001}
    checked = run("check", axis)
    assert checked.exit_code == 0 and f"{NAME}: force_N 1.5, reach_m 0.001, centre_m 0.001" in checked.stdout
    schema = json.loads(run("schema").stdout)
    assert {"type": "number"} in schema["$defs"]["Effect"]["additionalProperties"]["anyOf"]
    axis.write_text(AXIS.replace("reach_m", "reach"))
    refused = run("check", axis)
    assert refused.exit_code == 2 and "reach_m" in refused.stderr
    axis.write_text(AXIS.replace("reach_m = 0.001", "reach_m = 0.0"))
    assert "a number from 1e-06 on" in run("check", axis).stderr


def test_example_without_its_distribution_is_unknown(site: Path, axis: Path) -> None:
    refused = run("check", axis)
    assert refused.exit_code == 2 and NAME in refused.stderr and "force_ripple" in refused.stderr


@pytest.mark.slow
def test_example_is_simulated_generated_estimated_and_compared(example: Path, axis: Path, tmp_path: Path) -> None:
    log, package = tmp_path / "log.csv", tmp_path / "package"
    assert run("simulate", axis, "--out", log).exit_code == 0
    assert run("generate", axis, "--out", package).exit_code == 0
    assert any(f"{NAME}.force_N" in path.read_text() for path in package.iterdir())
    compared = run("compare", axis, log)
    assert compared.exit_code == 0, compared.output
    # The plant's force is written a second time: what the model leaves is the law's difference, not the effect.
    predicted = tmp_path / "predicted.csv"
    assert run("predict", axis, log, "--out", predicted).exit_code == 0
    table = np.genfromtxt(predicted, delimiter=",", names=True)
    rest = table["friction_measured_N"] - table["friction_N"]
    assert np.nanstd(rest[len(rest) // 10 :]) < 0.15


def test_plant_has_the_force_of_the_example(example: Path, axis: Path) -> None:
    machine = load_machine(axis)
    motion = Motion(machine.sampling.rate)
    motion.wait(0.1)
    motion.move_by(0.004, 0.05, 2.0, 100.0)
    run_ = simulate_axis(machine, motion.trajectory("stroke"))
    assert run_.truth is not None
    wanted = 1.5 * np.tanh((run_.truth.position_m - 0.001) / 0.001)
    np.testing.assert_allclose(run_.truth.effect_force_N, wanted, atol=1e-9)
    scaled = simulate_axis(machine, motion.trajectory("stroke"), scale={f"{NAME}.force_N": 2.0})
    assert scaled.truth is not None
    assert np.abs(scaled.truth.effect_force_N).max() == pytest.approx(3.0, rel=0.01)


def diagnosed(axis: Path, folder: Path) -> tuple[dict[str, Any], Machine]:
    """The only cause in a simulated log of an axis, for a machine file that knows of no effect, and its extension."""
    log, plain = folder / "log.csv", folder / "plain.toml"
    plain.write_text(PLAIN)
    assert run("simulate", axis, "--out", log).exit_code == 0
    found = run("diagnose", plain, log, "--out", folder, "--json")
    assert found.exit_code == 0, found.output
    diagnosis = json.loads((folder / "diagnosis.json").read_text())
    assert diagnosis["verdict"] == "explained"
    (cause,) = diagnosis["causes"]
    return cause, load_machine(folder / diagnosis["extended_machine"])


LEAST = """
from sgms_mhe.model.effects import EffectDefinition, EffectParameter, Excitation


def contribute(axis, p, _):
    axis.add_force(p["force_N"] * (axis.position / 0.004) ** 3)


DEFINITION = EffectDefinition(
    name="hard_spring",
    summary="a spring that hardens",
    parameters=(EffectParameter("force_N", 0.0, 0.1, "force at 4 mm", unit="coulomb"),),
    contribute=contribute,
    excitation=Excitation("travel"),
    confused_with={"position_spring": "travel twice as far"},
    moves=("travel",),
    plant_force=lambda position, velocity, time, p: p["force_N"] * (position / 0.004) ** 3,
)
"""


@pytest.mark.slow
def test_least_definition_is_searched_by_its_derivative(site: Path, tmp_path: Path) -> None:
    (site / "hard_spring.py").write_text(LEAST)
    installed(site, "hard-spring", "0.1", {"hard_spring": "hard_spring:DEFINITION"})
    forget_distributions()
    axis = tmp_path / "axis.toml"
    axis.write_text(SMALL + '[[effects]]\nname = "hard_spring"\nforce_N = 1.2\n')
    cause, _ = diagnosed(axis, tmp_path)
    assert cause["name"] == "hard_spring" and cause["parameters"]["force_N"] == pytest.approx(1.2, rel=0.03)


def test_export_prints_its_equation_and_has_no_c_of_it(example: Path, axis: Path) -> None:
    exported = sgms_mhe.export(axis, "modelica")
    assert NAME in exported.holds[-1] and f"parameter Real {NAME}_" in exported.text
    with pytest.raises(InputError, match="effects of this package"):
        sgms_mhe.export(axis, "fmu3")


def test_digest_covers_the_source_of_the_effects_in_use(example: Path, axis: Path) -> None:
    plain, with_effect = digest_of_sources(), digest_of_sources([NAME])
    assert digest_of_sources(EFFECT_NAMES) == plain != with_effect
    module = example / "magnetic_preload.py"
    module.write_text(module.read_text() + "# another word\n")
    assert digest_of_sources() == plain and digest_of_sources([NAME]) not in (plain, with_effect)
    (example / "magnetic_preload-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: magnetic-preload\nVersion: 1.1\n"
    )
    edited = digest_of_sources([NAME])
    forget_distributions()
    assert digest_of_sources([NAME]) != edited


# --- those that are broken --------------------------------------------------------------------------------------

GOOD = (EXAMPLE / "magnetic_preload.py").read_text(encoding="utf-8").replace(NAME, "pull")

BROKEN = {
    "raises": ("raise RuntimeError('no licence')", "RuntimeError: no licence"),
    "exits": ("raise SystemExit('bye')", "SystemExit: bye"),
    "lacks it": ("", "has no attribute 'DEFINITION'"),
    "imports what is not there": ("import gremlins", "No module named 'gremlins'"),
    "is of another version": (GOOD.replace("summary=", "headline="), "unexpected keyword argument 'headline'"),
    "is no definition": ("DEFINITION = {'name': 'pull'}", "an EffectDefinition; this is of type dict"),
    "has another name": (GOOD.replace('name="pull"', 'name="push"'), "a definition whose name is pull"),
    "has no unit": (GOOD.replace("reach_m", "reach"), "a name that ends in its unit (_N_s2_m2"),
    "has a wrong default": (GOOD.replace('"reach_m", 0.01,', '"reach_m", -0.01,'), "reach_m.default = -0.01"),
    "has no size": (GOOD.replace('"force_N", 0.0,', '"force_N", 1.0,'), "a size whose default is `none`"),
    "knows unknown rivals": (GOOD.replace('"force_ripple":', '"gremlins":'), "confused_with = 'gremlins'"),
    "has no stage": (GOOD.replace("linear=True", 'linear=True, stage="bow"'), "stage = 'bow': one of signal"),
    "has no moves": (GOOD.replace('moves=("travel",)', "moves=()"), "moves = (): at least one of loops"),
    "has states of its own": (GOOD.replace("linear=True", 'states=("pull",)'), "the states that it contributes, ()"),
    "searches elsewhere": (GOOD.replace("tests=20.0", 'exact="mass_kg"'), "search = 'mass_kg'"),
    "is never nothing": (GOOD.replace('add_force(p["force_N"]', 'add_force(1.0 + p["force_N"]'), "nothing where all"),
    "cannot contribute": (GOOD.replace('p["reach_m"])', 'p["range_m"])'), "KeyError: 'range_m'"),
    "has wrong types": (GOOD.replace('moves=("travel",)', "moves=7"), "a definition with the types of its fields"),
}  # fmt: skip


@pytest.mark.parametrize("how", BROKEN)
def test_broken_effect_is_named_with_its_distribution(site: Path, tmp_path: Path, how: str) -> None:
    source, said = BROKEN[how]
    (site / "pull_of_magnets.py").write_text(source)
    installed(site, "pull-of-magnets", "0.3", {"pull": "pull_of_magnets:DEFINITION"})
    forget_distributions()
    # Where it is not used nothing is different.
    assert effect_names() == EFFECT_NAMES and effect_definition("force_ripple").name == "force_ripple"
    (error,) = broken_effects()
    assert "pull-of-magnets 0.3" in str(error) and said in str(error)
    machine = tmp_path / "axis.toml"
    machine.write_text(SMALL + '[[effects]]\nname = "pull"\n')
    refused = run("check", machine)
    assert refused.exit_code == 2 and said in refused.stderr and "pull-of-magnets 0.3" in refused.stderr
    assert str(machine) in refused.stderr and "Traceback" not in refused.output


def test_all_effects_are_used_but_broken_ones(site: Path, tmp_path: Path) -> None:
    installed(site, "pull-of-magnets", "0.3", {"pull": "pull_of_magnets:DEFINITION"})
    forget_distributions()
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    planned = run("plan", path, "--out", tmp_path / "plan.csv")
    assert planned.exit_code == 0 and "left out: pull-of-magnets 0.3" in planned.stderr


def test_own_names_stay_own(example: Path) -> None:
    own = effect_definition("force_ripple")
    installed(example, "another-ripple", "2.0", {"force_ripple": "magnetic_preload:DEFINITION"})
    installed(example, "worn-guide", "2.1", {"coulomb": "magnetic_preload:DEFINITION"})
    forget_distributions()
    assert effect_definition("force_ripple") is own and effect_names() == (*EFFECT_NAMES, NAME)
    said = " ".join(str(error) for error in broken_effects())
    assert "another-ripple 2.0" in said and "worn-guide 2.1" in said and "a name that sgms-mhe does not use" in said


def test_name_of_two_distributions_is_nobodys(example: Path, axis: Path) -> None:
    installed(example, "other-magnets", "4.0", {NAME: "magnetic_preload:DEFINITION"})
    forget_distributions()
    assert effect_names() == EFFECT_NAMES
    refused = run("check", axis)
    assert refused.exit_code == 2 and "magnetic-preload 1.0" in refused.stderr and "other-magnets 4.0" in refused.stderr


def test_failure_at_the_machines_numbers_is_bad_input(site: Path, tmp_path: Path) -> None:
    picky = GOOD.replace("_: Mapping[str, float]) -> None", "nominal: Mapping[str, float]) -> None")
    check = "    if nominal['force_N'] > 1.0:\n        raise ValueError('too strong')\n"
    picky = picky.replace("    axis.add_force", f"{check}    axis.add_force")
    (site / "pull_of_magnets.py").write_text(picky)
    installed(site, "pull-of-magnets", "0.3", {"pull": "pull_of_magnets:DEFINITION"})
    forget_distributions()
    path = tmp_path / "axis.toml"
    path.write_text(SMALL + '[[effects]]\nname = "pull"\nforce_N = 2.0\n')
    with pytest.raises(InputError, match=r"effect pull.*ValueError: too strong"):
        build_model(load_machine(path))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("    plant_force=_plant_force,\n", ""), "one that brings a `plant_force`"),
        (("math.tanh(", "math.fanh("), "AttributeError"),
    ],
)
def test_plant_without_a_force_refuses(site: Path, tmp_path: Path, change: tuple[str, str], said: str) -> None:
    assert change[0] in GOOD
    (site / "pull_of_magnets.py").write_text(GOOD.replace(*change))
    installed(site, "pull-of-magnets", "0.3", {"pull": "pull_of_magnets:DEFINITION"})
    forget_distributions()
    path = tmp_path / "axis.toml"
    path.write_text(SMALL + '[[effects]]\nname = "pull"\nforce_N = 1.0\n')
    refused = run("simulate", path, "--out", tmp_path / "log.csv")
    assert refused.exit_code == 2 and said in refused.stderr and not (tmp_path / "log.csv").exists()
