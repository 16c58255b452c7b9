"""The machine file: what is read, what is filled in, and what is refused and how."""

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from cli_cases import run
from sgms_mhe.configuration import drop_disturbance, load_machine, override_machine
from sgms_mhe.machine import BASE_PARAMETERS, Tables, estimable_names, json_schema
from sgms_mhe.machine.writing import toml_extends
from sgms_mhe.model import build_model
from sgms_mhe.support.errors import InputError, MachineWarning

pytestmark = pytest.mark.core

MINIMAL = """
name = "axis"
[plant]
mass = 20.0
[friction]
stiffness = [3e4, 1e4]
fraction = [0.25, 0.75]
coulomb = 4.0
"""


def write(folder: Path, text: str, name: str = "machine.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def refused(path: Path | str) -> InputError:
    with pytest.raises(InputError) as caught:
        load_machine(path)
    return caught.value


# --- what is read -----------------------------------------------------------------------------------------------


def test_etel_xy_holds_table_one_of_the_paper() -> None:
    machine = load_machine("etel_xy")
    friction, smoothing = machine.friction, machine.friction.smoothing
    assert machine.plant.moved == 20.0
    assert friction.stiffness == (120e3, 25e3, 7.1e3, 7.9e3)
    assert friction.fraction == (0.067, 0.056, 0.047, 0.83)
    assert (friction.viscous, friction.coulomb) == (20.0, 4.0)
    assert (friction.stribeck_ratio, friction.stribeck_velocity) == (0.12, 1e-3)
    assert (smoothing.zeta, smoothing.lambda_, smoothing.gamma) == (0.9, 35.0, 35.0)
    assert friction.n_z == 4
    assert machine.sampling.samples_per_update == 100
    assert machine.sampling.step == 1e-4
    assert machine.sampling.integrator.scheme == "flow"
    assert machine.estimator.arrival_cost.update == "riccati"


def test_etel_xy_paper_differs_only_in_the_estimator() -> None:
    plain, paper = load_machine("etel_xy"), load_machine("etel_xy_paper")
    assert paper.plant == plain.plant
    assert paper.friction == plain.friction
    integrator, estimator = paper.sampling.integrator, paper.estimator
    assert (integrator.scheme, integrator.substeps, integrator.displacement) == ("rk4", 100, 0.03)
    assert (estimator.horizon, estimator.parameters) == (20, ("stiffness",))
    assert estimator.noise.model_dump() == {
        "measurement": 0.5,
        "state": 0.1,
        "parameter": 0.05,
        "parameter_drift": 0.0,
        "initial_state": 1.0,
        "state_as": "deflection",
        "colour": 1.0,
        "self_scaling": False,
    }
    assert paper.sampling.readings_per_update == 1
    assert estimator.arrival_cost.update == "fixed"


def test_emps_holds_the_published_fit() -> None:
    machine = load_machine("emps")
    assert (machine.plant.moved, machine.friction.coulomb, machine.friction.viscous) == (95.1089, 20.3935, 203.5034)
    assert machine.sampling.samples_per_update == 10
    assert machine.log is not None and machine.log.force_N is not None
    assert (machine.log.force_N.variable, machine.log.force_N.scale) == ("vir", 35.15065188248547)
    assert [(effect.name, effect.parameters) for effect in machine.effects] == [
        ("constant_offset", {"force_N": -3.1648})
    ]


def test_every_shipped_machine_loads_under_its_file_name(repo_root: Path) -> None:
    paths = sorted((repo_root / "machines").glob("*.toml"))
    assert len(paths) >= 3
    assert [load_machine(path).name for path in paths] == [path.stem for path in paths]


def test_defaults_are_resolved(tmp_path: Path) -> None:
    machine = load_machine(write(tmp_path, MINIMAL))
    assert machine.friction.micro_viscous == (0.0, 0.0)
    assert machine.friction.viscous == 0.0
    assert machine.sampling.integrator.model_dump() == {
        "scheme": "flow",
        "substeps": 100,
        "displacement": 0.1,
        "slow_displacement": 0.02,
    }
    assert machine.estimator.bounds == {}
    assert machine.log is None
    assert machine.effects == ()


@pytest.mark.parametrize(
    ("sampling", "substeps", "displacement"),
    [
        ("rate = 1000.0", 10, 0.1),
        ("rate = 8000\nupdate_rate = 250", 32, 0.1),
        ('integrator = { scheme = "rk4" }', 100, 0.03),
        ('integrator = { scheme = "rk4", substeps = 300, displacement = 0.02 }', 300, 0.02),
    ],
)
def test_integrator_defaults_follow_rates_and_scheme(
    tmp_path: Path, sampling: str, substeps: int, displacement: float
) -> None:
    cutoff = "velocity_cutoff = 100.0"
    integrator = load_machine(write(tmp_path, f"{MINIMAL}[sampling]\n{cutoff}\n{sampling}\n")).sampling.integrator
    assert (integrator.substeps, integrator.displacement) == (substeps, displacement)


@pytest.mark.parametrize(
    ("written", "scheme"),
    [
        ("", "flow"),
        ("[sampling]\nintegrator = { substeps = 20 }\n", "flow"),
        ("[friction.smoothing]\nzeta = 0.5\nlambda = 3.0\ngamma = 3.0\n", "rk4"),
        ('[friction]\nlaw = "switching"\n', "clip"),
    ],
)
def test_default_scheme_is_the_one_that_the_law_allows(tmp_path: Path, written: str, scheme: str) -> None:
    text = MINIMAL.replace("[friction]\n", written) if "law" in written else MINIMAL + written
    assert load_machine(write(tmp_path, text)).sampling.integrator.scheme == scheme


def test_numbers_may_be_written_as_integers(tmp_path: Path) -> None:
    mass = load_machine(write(tmp_path, MINIMAL.replace("20.0", "20"))).plant.moved
    assert isinstance(mass, float)
    assert mass == 20.0


def test_machine_is_frozen() -> None:
    machine = load_machine("etel_xy")
    with pytest.raises(ValidationError):
        machine.plant.moved = 1.0  # type: ignore[misc]


def test_byte_order_mark_and_crlf_are_read(tmp_path: Path) -> None:
    path = tmp_path / "machine.toml"
    path.write_bytes(b"\xef\xbb\xbf" + MINIMAL.replace("\n", "\r\n").encode())
    assert load_machine(path).name == "axis"


# --- where it is found ------------------------------------------------------------------------------------------


def test_machine_is_found_by_name_path_and_stem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, repo_root: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    shipped = repo_root / "machines" / "etel_xy"
    assert load_machine("etel_xy").source.resolve() == shipped.with_suffix(".toml")
    assert load_machine(str(shipped)).source.resolve() == shipped.with_suffix(".toml")
    (tmp_path / "etel_xy").mkdir()  # a generated folder of that name is not a machine file
    assert load_machine("etel_xy").source.resolve() == shipped.with_suffix(".toml")
    (tmp_path / "machines").mkdir()
    own = write(tmp_path / "machines", MINIMAL, "etel_xy.toml")
    assert load_machine("etel_xy").source.resolve() == own.resolve()


@pytest.mark.parametrize("name", ["no_such_machine", "no/such/machine.toml", "", ".", "nul\0byte"])
def test_unknown_machine_is_refused(name: str) -> None:
    assert "a machine file that exists" in refused(name).allowed


def test_unknown_name_lists_the_known_ones() -> None:
    shipped = (
        r"\bemps, etel_xy, etel_xy_compensation, etel_xy_controller, etel_xy_paper, etel_xy_rotary, etel_xy_switching\b"
    )
    assert re.search(shipped, refused("etel_yx").allowed)


# --- extends ----------------------------------------------------------------------------------------------------


def test_extends_merges_tables_and_replaces_arrays(tmp_path: Path) -> None:
    write(tmp_path, MINIMAL + "viscous = 7.0\n[estimator.noise]\nstate = 0.03\n", "base.toml")
    write(tmp_path, 'extends = "base"\n[friction]\nstiffness = [9e4]\nfraction = [1.0]\n', "middle.toml")
    path = write(tmp_path, 'extends = "middle.toml"\nname = "top"\n[estimator.noise]\nmeasurement = 2.0\n')
    machine = load_machine(path)
    assert (machine.name, machine.plant.moved, machine.friction.viscous) == ("top", 20.0, 7.0)
    assert machine.friction.stiffness == (9e4,)
    assert machine.friction.micro_viscous == (0.0,)
    assert (machine.estimator.noise.state, machine.estimator.noise.measurement) == (0.03, 2.0)
    assert machine.source == path


def test_a_base_that_has_changed_since_is_said(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    base = write(tmp_path, MINIMAL, "base.toml")
    lines = "\n".join(toml_extends(load_machine(base), tmp_path))
    top = write(tmp_path, f'{lines}\nname = "top"\n[friction]\nviscous = 3.0\n')
    above = write(tmp_path, f'extends = "{top.name}"\nname = "above"\n', "above.toml")
    # Neither comments nor layout, names or what logs are called change what the file says of the axis.
    renamed = MINIMAL.replace('"axis"', '"renamed"').replace("20.0", "20.0  # kg")
    base.write_text(f"{renamed}[log]\ntime_s = 't'\n[diagnosis]\nmaterial = 0.01\n", encoding="utf-8")
    assert load_machine(above).friction.viscous == 3.0
    assert not recwarn.list
    base.write_text(MINIMAL.replace("4.0", "4.5"), encoding="utf-8")
    for file in (top, above):
        with pytest.warns(
            MachineWarning, match=r"machine\.toml: extends_digest = '[0-9a-f]{16}', but .* has '"
        ) as told:
            assert load_machine(file).friction.coulomb == 4.5
        assert len(told) == 1
    done = run("check", above)
    assert done.exit_code == 0
    assert done.stderr.count("extends_digest") == 1
    assert "extends_digest" not in run("--quiet", "check", above).stderr


@pytest.mark.parametrize("head", ["extends_digest = 'a'", "extends = 'etel_xy'\nextends_digest = 7"])
def test_a_digest_of_no_base_is_refused(tmp_path: Path, head: str) -> None:
    assert refused(write(tmp_path, f"{head}\n{MINIMAL}")).where == "extends_digest"


def test_extends_prefers_its_own_folder(tmp_path: Path) -> None:
    write(tmp_path, MINIMAL, "etel_xy.toml")
    assert load_machine(write(tmp_path, 'extends = "etel_xy"\n')).name == "axis"


@pytest.mark.parametrize("chain", [["a"], ["a", "b"], ["a", "b", "c"]])
def test_extends_in_a_circle_is_refused(tmp_path: Path, chain: list[str]) -> None:
    for name, parent in zip(chain, chain[1:] + chain[:1], strict=True):
        write(tmp_path, f'extends = "{parent}"\n', f"{name}.toml")
    error = refused(tmp_path / "a.toml")
    assert error.source == str(tmp_path / f"{chain[-1]}.toml")
    assert error.where == "extends"


@pytest.mark.parametrize("parent", ['"absent"', '""', "3", "[]", '["etel_xy"]', "{}"])
def test_bad_extends_is_refused(tmp_path: Path, parent: str) -> None:
    assert refused(write(tmp_path, f"extends = {parent}\n")).where == "extends"


def test_error_names_the_file_that_holds_the_value(tmp_path: Path) -> None:
    base = write(tmp_path, MINIMAL.replace("20.0", "-20.0"), "base.toml")
    top = write(tmp_path, 'extends = "base"\n[friction]\ncoulomb = 3.0\n')
    assert refused(top).source == str(base)
    assert f"in {top}, which extends it" in refused(top).allowed
    top.write_text('extends = "base"\n[plant]\nmass = -1.0\n', encoding="utf-8")
    assert refused(top).source == str(top)


def test_clash_with_an_inherited_key_names_both_files(tmp_path: Path) -> None:
    base = write(tmp_path, MINIMAL, "base.toml")
    top = write(tmp_path, 'extends = "base"\nfriction.stiffness = [1e4]\n')
    error = refused(top)
    assert (error.source, error.where, error.value) == (str(base), "friction.fraction", [0.25, 0.75])
    assert "1 numbers, as many as stiffness has" in error.allowed
    assert str(top) in error.allowed


# --- effects ----------------------------------------------------------------------------------------------------

RIPPLE = '[[effects]]\nname = "force_ripple"\n'


def test_effect_parameters_are_filled_in_the_registry_order(tmp_path: Path) -> None:
    text = 'extends = "etel_xy"\n[[effects]]\nphase_rad = 0.7\nname = "force_ripple"\namplitude_N = 1\n'
    (effect,) = load_machine(write(tmp_path, text)).effects
    assert list(effect.parameters.items()) == [("amplitude_N", 1.0), ("pitch_m", 0.032), ("phase_rad", 0.7)]


def test_second_effect_of_a_name_is_numbered(tmp_path: Path) -> None:
    wanted = '[estimator]\nparameters = ["coulomb", "force_ripple.amplitude_N", "force_ripple_2.pitch_m"]\n'
    text = f'extends = "etel_xy"\n{wanted}{RIPPLE}{RIPPLE}pitch_m = 0.016\n'
    machine = load_machine(write(tmp_path, text))
    assert [effect.label for effect in machine.effects] == ["force_ripple", "force_ripple_2"]
    names = estimable_names(machine.effects)
    assert names[: len(BASE_PARAMETERS)] == BASE_PARAMETERS and names[-1] == "force_ripple_2.phase_rad"
    assert "force_ripple_3" in refused(write(tmp_path, text.replace("ripple_2.", "ripple_3."))).value  # type: ignore[operator]


@pytest.mark.parametrize("key", ['"force_ripple.amplitude_N"', "force_ripple.amplitude_N"])
def test_bounds_of_an_effect_may_be_written_with_and_without_quotes(tmp_path: Path, key: str) -> None:
    text = f'extends = "etel_xy"\n{RIPPLE}[estimator.bounds]\n{key} = [0, 3]\n'
    assert load_machine(write(tmp_path, text)).estimator.bounds == {
        "stiffness": (0.2, 5.0),
        "force_ripple.amplitude_N": (0.0, 3.0),
    }


def test_an_uncertain_mass_is_estimated_beside_the_parameters(tmp_path: Path) -> None:
    """Mass and gain are one error in motion: their deviations add in squares; what the file says of it stands."""
    text = 'extends = "etel_xy"\n[estimator.disturbance]\nmass = 0.03\ngain = 0.04\n'
    machine = load_machine(write(tmp_path, text))
    model = build_model(machine)
    assert machine.estimator.parameters == ("stiffness", "mass_mismatch.mass_kg")
    assert machine.estimator.prior["mass_mismatch.mass_kg"] == pytest.approx(0.05 * 20.0)
    assert model.signal_names[-1] == "mean_acceleration" and len(model.signal_names) == 6
    assert machine.digest != override_machine(machine, {"estimator": {"disturbance": {"gain": 0.0}}}).digest

    own = '[estimator.prior]\nmass_mismatch.mass_kg = 0.2\n[[effects]]\nname = "mass_mismatch"\nmass_kg = 1.5\n'
    stated = load_machine(write(tmp_path, text + own))
    assert stated.estimator.prior == {"mass_mismatch.mass_kg": 0.2}
    assert [(effect.label, dict(effect.parameters)) for effect in stated.effects] == [
        ("mass_mismatch", {"mass_kg": 1.5})
    ]

    rotary = load_machine(write(tmp_path, 'extends = "etel_xy_rotary"\n[estimator.disturbance]\nmass = 0.03\n'))
    assert "mass_mismatch.inertia_kg_m2" in rotary.as_dict()["estimator"]["parameters"]


def test_a_mass_that_is_certain_changes_nothing(tmp_path: Path) -> None:
    """Also where a file says so: the axis, its signals and its digest are those of a file without the table."""
    plain = load_machine("etel_xy")
    certain = override_machine(plain, {"estimator": {"disturbance": {"mass": 0.0, "gain": 0.0}}})
    assert certain.digest == plain.digest and len(build_model(certain).signal_names) == 5
    uncertain = override_machine(plain, {"estimator": {"disturbance": {"mass": 0.01}}})
    assert drop_disturbance(uncertain).digest == plain.digest and drop_disturbance(plain) is plain


def test_priors_are_of_each_kind_of_parameter(tmp_path: Path) -> None:
    """Over nominal for the friction law, in its unit for an effect; drift in proportion; others have the default."""
    text = (
        f'extends = "etel_xy"\n{RIPPLE}amplitude_N = 0.5\n[[effects]]\nname = "constant_offset"\n[estimator]\n'
        'parameters = ["stiffness", "coulomb", "force_ripple.amplitude_N", "constant_offset.force_N"]\n'
        "[estimator.prior]\ncoulomb = 0.1\nforce_ripple.amplitude_N = 0.2\nconstant_offset.force_N = 0.6\n"
    )
    model = build_model(load_machine(write(tmp_path, text)))
    prior = dict(zip([p.column for p in model.parameters], zip(model.prior, model.drift, strict=True), strict=True))
    scale = {p.column: p.scale for p in model.parameters}
    assert prior["stiffness_4"] == pytest.approx((0.4, 0.002))
    assert prior["coulomb"] == pytest.approx((0.1, 0.0005))
    assert prior["force_ripple.amplitude_N"] == pytest.approx((0.4, 0.002))
    assert prior["constant_offset.force_N"][0] * scale["constant_offset.force_N"] == pytest.approx(0.6)


# --- what is refused --------------------------------------------------------------------------------------------

# (lines that extend etel_xy, key that the error names, part of what it says is allowed)
BAD_VALUES = [
    # wrong magnitudes
    ("plant.mass = -20.0", "plant.mass", "greater than 0"),
    ("plant.mass = 0.0", "plant.mass", "[kg]"),
    ("plant.mass = 2e9", "plant.mass", "1e+06"),
    ("friction.coulomb = 0.0", "friction.coulomb", "greater than 0"),
    ("friction.viscous = -1.0", "friction.viscous", "greater than or equal to 0"),
    ("friction.stribeck_ratio = -0.1", "friction.stribeck_ratio", "greater than or equal to 0"),
    ("friction.stribeck_velocity = 0.0", "friction.stribeck_velocity", "[m/s, rad/s]"),
    ("friction.smoothing.zeta = 1.0", "friction.smoothing.zeta", "less than 1"),
    ("friction.smoothing.lambda = -35.0", "friction.smoothing.lambda", "greater than 0"),
    ("friction.stiffness = [120e3, -25e3, 7.1e3, 7.9e3]", "friction.stiffness[2]", "greater than 0"),
    ("friction.micro_viscous = [0.0, 0.0, -1.0, 0.0]", "friction.micro_viscous[3]", "greater than or equal to 0"),
    ("sampling.max_velocity = 0.0", "sampling.max_velocity", "[m/s, rad/s]"),
    ("sampling.rate = 0.0", "sampling.rate", "[Hz]"),
    ("sampling.update_rate = -100.0", "sampling.update_rate", "greater than 0"),
    ("estimator.horizon = 0", "estimator.horizon", "greater than or equal to 1"),
    ("estimator.noise.measurement = 0.0", "estimator.noise.measurement", "[N, N m]"),
    ("estimator.noise.state = 0.0", "estimator.noise.state", "greater than 0"),
    ("estimator.noise.parameter_drift = -0.1", "estimator.noise.parameter_drift", "greater than or equal to 0"),
    # numbers that are none
    ("plant.mass = nan", "plant.mass", "finite"),
    ("plant.mass = inf", "plant.mass", "finite"),
    ("friction.viscous = nan", "friction.viscous", "finite"),
    ("friction.stiffness = [120e3, inf, 7.1e3, 7.9e3]", "friction.stiffness[2]", "finite"),
    ("friction.micro_viscous = [nan, 0.0, 0.0, 0.0]", "friction.micro_viscous[1]", "finite"),
    ("estimator.bounds.stiffness = [0.5, inf]", "estimator.bounds.stiffness[2]", "finite"),
    ("estimator.bounds.stiffness = [nan, 2.0]", "estimator.bounds.stiffness[1]", "finite"),
    # wrong types
    ('plant.mass = "20"', "plant.mass", "valid number"),
    ("plant.mass = true", "plant.mass", "valid number"),
    ("plant.mass = [20.0]", "plant.mass", "valid number"),
    ("plant.mass = 2024-01-01", "plant.mass", "valid number"),
    ("plant = 20.0", "plant", "a table"),
    ("friction.smoothing = []", "friction.smoothing", "a table"),
    ("friction.stiffness = 120e3", "friction.stiffness", "N/m"),
    ('friction.stiffness = "1234"', "friction.stiffness", "N/m"),
    ("friction.stiffness = []", "friction.stiffness", "at least 1"),
    ("estimator.horizon = 20.0", "estimator.horizon", "valid integer"),
    ("estimator.horizon = true", "estimator.horizon", "valid integer"),
    ('estimator.parameters = "stiffness"', "estimator.parameters", "any of stiffness"),
    ("estimator.bounds = [0.2, 5.0]", "estimator.bounds", "a table"),
    ("estimator.bounds.stiffness = 5.0", "estimator.bounds.stiffness", "valid tuple"),
    ("effects = 3", "effects", "what the axis has"),
    ("name = 3", "name", "valid string"),
    # choices
    ('sampling.integrator.scheme = "rk45"', "sampling.integrator.scheme", "'rk4', 'flow' or 'clip'"),
    ('sampling.integrator.scheme = "rk2"', "sampling.integrator.scheme", "'rk4', 'flow' or 'clip'"),
    ('estimator.kind = "ukf"', "estimator.kind", "'mhe' or 'ekf'"),
    ('estimator.relinearise = "some"', "estimator.relinearise", "'all', 'auto' or 'newest'"),
    ('estimator.arrival_cost.update = "kalman"', "estimator.arrival_cost.update", "'riccati' or 'fixed'"),
    ('estimator.noise.state_as = "velocity"', "estimator.noise.state_as", "'force' or 'deflection'"),
    ('code.precision = "half"', "code.precision", "'double' or 'single'"),
    # unknown keys
    ("plant.mas = 20.0", "plant.mas", "did you mean mass?"),
    ("plants.mass = 20.0", "plants", "did you mean plant?"),
    ("friction.smoothing.lambda_ = 35.0", "friction.smoothing.lambda_", "did you mean lambda?"),
    ("sampling.integrator.steps = 5", "sampling.integrator.steps", "scheme, substeps, displacement, slow_displacement"),
    ('sampling.integrator.velocity = "linear"', "sampling.integrator.velocity", "scheme, substeps, displacement"),
    ("estimator.noise.sigma = 0.5", "estimator.noise.sigma", "measurement, state"),
    ("colour = 3", "colour", "extends"),
    # between keys
    ("friction.fraction = [0.067, 0.056, 0.047, 0.84]", "friction.fraction", "sum to 1 (here 1.01)"),
    ("friction.fraction = [0.1, 0.2, 0.7]", "friction.fraction", "4 numbers"),
    ("friction.micro_viscous = [0.0]", "friction.micro_viscous", "4 numbers"),
    ("sampling.update_rate = 1e-308", "sampling.update_rate", "at most 100000 samples per update"),
    ("sampling.update_rate = 0.01", "sampling.update_rate", "at most 100000 samples per update"),
    ("sampling.integrator.scheme = 'flow'\nfriction.smoothing.gamma = 0.5", "sampling.integrator.scheme", "rk4"),
    ("sampling.integrator.scheme = 'flow'\nfriction.smoothing.zeta = 1e-9", "sampling.integrator.scheme", "rk4"),
    ("sampling.update_rate = 300.0", "sampling.update_rate", "divides rate = 10000 Hz"),
    ("sampling.update_rate = 20000.0", "sampling.update_rate", "divides rate"),
    ("sampling.velocity_cutoff = 5000.0", "sampling.velocity_cutoff", "< rate / 2 = 5000 Hz"),
    ("sampling.velocity_cutoff = 0.5", "sampling.velocity_cutoff", ">= 1 Hz"),
    ("sampling.integrator.substeps = 0", "sampling.integrator.substeps", "greater than or equal to 1"),
    ("sampling.integrator.substeps = 30", "sampling.integrator.substeps", "rate / update_rate = 100"),
    ("sampling.integrator.substeps = 150", "sampling.integrator.substeps", "rate / update_rate = 100"),
    ("estimator.parameters = []", "estimator.parameters", "at least 1"),
    ('estimator.parameters = ["mass"]', "estimator.parameters[1]", "stiffness, fraction, coulomb, viscous"),
    ('estimator.parameters = ["coulomb", "coulomb"]', "estimator.parameters", "each parameter once"),
    (
        'estimator.parameters = ["coulomb", "viscous"]\nfriction.viscous = 0.0',
        "estimator.parameters[2]",
        "friction.viscous",
    ),
    ("estimator.prior.stiffness = 0.0", "estimator.prior.stiffness", "greater than 0"),
    ("estimator.prior.coulomb = [0.1, 0.2]", "estimator.prior.coulomb", "valid number"),
    ("estimator.prior.mass = 0.01", "estimator.prior.mass", "a key out of stiffness"),
    ("estimator.prior.constant_offset.force_N = 0.5", "estimator.prior.constant_offset.force_N", "a key out of"),
    ("estimator.disturbance.mass = -0.01", "estimator.disturbance.mass", "greater than or equal to 0"),
    ("estimator.disturbance.gain = 1.5", "estimator.disturbance.gain", "less than or equal to 1"),
    ("estimator.disturbance.coulomb = 0.1", "estimator.disturbance.coulomb", "unknown key"),
    ("estimator.bounds.stiffness = [1.0, 5.0]", "estimator.bounds.stiffness", "low < 1 < high"),
    ("estimator.bounds.stiffness = [0.2, 1.0]", "estimator.bounds.stiffness", "low < 1 < high"),
    ("estimator.bounds.stiffness = [-0.2, 5.0]", "estimator.bounds.stiffness[1]", "greater than or equal to 0"),
    ("estimator.bounds.stiffness = [0.2, 1.0, 5.0]", "estimator.bounds.stiffness", "at most 2"),
    ("estimator.bounds.mass = [0.5, 2.0]", "estimator.bounds.mass", "a key out of stiffness"),
    (
        'estimator.bounds = { "effect.a" = [0.5, 2.0], effect = { a = [0.5, 2.0] } }',
        "estimator.bounds.effect.a",
        "given twice",
    ),
    # names that become C
    ('name = "2axes"', "name", "C identifier"),
    ('name = "etel-xy"', "name", "C identifier"),
    ('name = "étel"', "name", "C identifier"),
    ('name = "_axis"', "name", "C identifier"),
    ('name = ""', "name", "C identifier"),
    ('name = "axis\\n"', "name", "C identifier"),
    ('name = "double"', "name", "keyword"),
    ('name = "sgms"', "name", "the runtime"),
    ('name = "sgms_flow"', "name", "the runtime"),
    ('name = "SGMS"', "name", "the runtime"),
    ('name = "math"', "name", "has for itself"),
    ('name = "int32"', "name", "has for itself"),
    ('name = "element1"', "name", "has for itself"),
    (f'name = "{"a" * 49}"', "name", "at most 48"),
    ('description = "ends */ here"', "description", "comment marks"),
    ('description = "two\\nlines"', "description", "one printable line"),
    # effects
    ('effects = [{ name = "magic" }]', "effects[1].name", "force_ripple"),
    ("effects = [{ amplitude_N = 1.0 }]", "effects[1].name", "required key is missing"),
    ("effects = [1.0]", "effects[1]", "a table"),
    (
        'effects = [{ name = "force_ripple" }, { name = "force_ripple", amplitude = 1.0 }]',
        "effects[2].amplitude",
        "amplitude_N",
    ),
    ('effects = [{ name = "force_ripple", amplitude_N = "1" }]', "effects[1].amplitude_N", "valid number"),
    ('effects = [{ name = "force_ripple", pitch_m = nan }]', "effects[1].pitch_m", "number"),
    ('effects = [{ name = "force_ripple", pitch_m = -0.032 }]', "effects[1].pitch_m", "number from 1e-06"),
    # log
    ("log.time = 't'", "log.time", "did you mean time_s?"),
    ("diagnosis.materiel = 0.1", "diagnosis.materiel", "did you mean material?"),
    ("diagnosis.search_rate = 500.0", "diagnosis.search_rate", "a constant of the diagnosis since 0.2"),
    ("diagnosis.material = -0.1", "diagnosis.material", "RMS gain that matters"),
    ("diagnosis.rounds = 2.5", "diagnosis.rounds", "integer"),
    ("log.force_N = 3", "log.force_N", "a table"),
    ("log.force_N = ''", "log.force_N.variable", "at least 1"),
    ("log.force_N = {}", "log.force_N.variable", "required key is missing"),
    ("log.force_N = { variable = 'u', scale = 0.0 }", "log.force_N.scale", "other than 0"),
    ("log.force_N = { variable = 'u', scale = inf }", "log.force_N.scale", "finite"),
    ("log.force_N = { variable = 'u', unit = 'mm' }", "log.force_N.unit", "N, mN, kN"),
    ("log.force_N = { variable = 'u', gain = 2.0 }", "log.force_N.gain", "variable, scale, offset, unit"),
]


@pytest.mark.parametrize(("lines", "where", "allowed"), BAD_VALUES, ids=[case[0] for case in BAD_VALUES])
def test_bad_value_is_refused_with_file_key_value_and_what_is_allowed(
    tmp_path: Path, lines: str, where: str, allowed: str
) -> None:
    path = write(tmp_path, f'extends = "etel_xy"\n{lines}\n')
    error = refused(path)
    assert error.where == where
    assert allowed in error.allowed
    assert error.source == str(path)
    assert str(error).startswith(f"{path}: {where}")


@pytest.mark.parametrize("missing", ["name", "mass", "stiffness", "fraction", "coulomb"])
def test_missing_key_is_named(tmp_path: Path, missing: str) -> None:
    error = refused(write(tmp_path, re.sub(rf"^{missing} = .*\n", "", MINIMAL, flags=re.MULTILINE)))
    assert error.where.split(".")[-1] == missing
    assert "required" in error.allowed


@pytest.mark.parametrize("table", ["plant", "friction"])
def test_missing_table_is_named(tmp_path: Path, table: str) -> None:
    text = re.sub(rf"\[{table}\]\n(\w.*\n)*", "", MINIMAL)
    assert refused(write(tmp_path, text)).where == table


@pytest.mark.parametrize("digits", [40, 400, 6000])
def test_integers_beyond_every_float_are_refused(tmp_path: Path, digits: int) -> None:
    error = refused(write(tmp_path, MINIMAL.replace("20.0", "9" * digits)))
    assert error.where in ("plant.mass", "file")


def test_value_is_quoted(tmp_path: Path) -> None:
    error = refused(write(tmp_path, MINIMAL.replace("20.0", "-3.5")))
    assert error.value == -3.5
    assert "plant.mass = -3.5" in str(error)


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("name = 'a'\n[plant\nmass = 1\n", "line 2"),
        ("name = 'a'\nname = 'b'\n", "line 2"),
        ("a\n", "line 1"),
        ("x = {", "last line"),
        ("x = " + "[" * 100_000, "file"),
    ],
)
def test_toml_syntax_error_names_the_line(tmp_path: Path, text: str, where: str) -> None:
    error = refused(write(tmp_path, text))
    assert error.where == where
    assert error.allowed.startswith("TOML syntax")


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    ["a" + ".a" * 20_000 + " = 1\n", "[a" + ".a" * 20_000 + "]\n", "[code]\na" + ".a" * 900 + " = 1\n"],
    ids=["keys", "table", "below the limit of recursion"],
)
def test_deep_nesting_is_refused_in_few_words(tmp_path: Path, text: str) -> None:
    error = refused(write(tmp_path, text))
    assert "nested at most" in error.allowed
    assert len(str(error)) < 400


@pytest.mark.parametrize("text", [f"x = {[0] * 5000}\n", "x" * 5000 + " = 1\n"], ids=["value", "key"])
def test_long_values_are_repeated_in_part(tmp_path: Path, text: str) -> None:
    assert len(str(refused(write(tmp_path, text)))) < 1000


def test_unreadable_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "machine.toml"
    path.write_bytes(b'name = "\xff"\n')
    assert "UTF-8" in refused(path).allowed
    path.write_bytes(b"")
    assert "required" in refused(path).allowed
    assert "a machine file that exists" in refused(tmp_path).allowed


# --- digest, override, schema -----------------------------------------------------------------------------------


def test_digest_depends_on_content_alone(tmp_path: Path) -> None:
    base = load_machine(write(tmp_path, MINIMAL))
    assert re.fullmatch("[0-9a-f]{64}", base.digest)
    (tmp_path / "elsewhere").mkdir()
    spelled_out = MINIMAL.replace("3e4", "30_000").replace("[plant]", "# moved\n[plant]") + "viscous = 0.0\n"
    assert load_machine(write(tmp_path / "elsewhere", spelled_out, "b.toml")).digest == base.digest
    assert load_machine(write(tmp_path, f"extends = 'machine'\n{MINIMAL}", "c.toml")).digest == base.digest
    changed = load_machine(write(tmp_path, MINIMAL.replace("20.0", "20.000000001"), "d.toml"))
    assert changed.digest != base.digest


def test_override_is_what_an_extending_file_says(tmp_path: Path) -> None:
    machine = load_machine("etel_xy")
    other = override_machine(machine, {"sampling": {"rate": 5000.0, "integrator": {"scheme": "rk4"}}})
    assert (other.sampling.integrator.substeps, other.sampling.integrator.displacement) == (50, 0.03)
    text = 'extends = "etel_xy"\n[sampling]\nrate = 5000.0\nintegrator = { scheme = "rk4" }\n'
    assert other.digest == load_machine(write(tmp_path, text)).digest
    assert override_machine(machine, {}).digest == machine.digest
    assert machine.sampling.rate == 10000.0
    with pytest.raises(InputError, match=r"plant\.mass = -1"):
        override_machine(machine, {"plant": {"mass": -1}})


def test_an_accuracy_of_zero_is_that_of_a_file_without_it(tmp_path: Path) -> None:
    """Its packages hold the digest of before; any other number is content, beyond a tenth of the noise none."""
    machine = load_machine("etel_xy")
    assert override_machine(machine, {"code": {"accuracy": 0.0}}).digest == machine.digest
    rounded = override_machine(machine, {"code": {"accuracy": 1e-3}})
    assert rounded.digest != machine.digest and rounded.as_dict()["code"]["accuracy"] == 1e-3
    for refused_one in (-1e-3, 0.2):
        with pytest.raises(InputError, match=r"code\.accuracy"):
            override_machine(machine, {"code": {"accuracy": refused_one}})


def test_choices_of_a_diagnosis_are_no_part_of_what_is_emitted() -> None:
    machine = load_machine("etel_xy")
    changed = override_machine(machine, {"diagnosis": {"material": 0.01}})
    assert changed.diagnosis.changed == {"material": 0.01}
    assert changed.as_dict()["diagnosis"]["material"] == 0.01
    assert changed.digest == machine.digest


def _tables(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    yield model
    for field in model.model_fields.values():
        for kind in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from _tables(kind)


def test_every_field_states_its_default_and_every_number_its_unit() -> None:
    for table in _tables(Tables):
        for name, field in table.model_fields.items():
            assert field.description, (table, name)
            assert re.search("default|required", field.description), (table, name)
            if field.annotation in (int, float):
                assert re.search(r" \[[^\]]+\]; ", field.description), (table, name)


def test_described_defaults_are_the_defaults() -> None:
    checked = 0
    for table in _tables(Tables):
        for field in table.model_fields.values():
            stated = re.search(r"; default ([-\d.e]+)$", field.description or "")
            if stated and isinstance(field.default, int | float):
                assert math.isclose(float(stated.group(1)), field.default)
                checked += 1
    assert checked >= 15


def test_schema_is_json_and_knows_the_file_s_keys() -> None:
    schema: dict[str, Any] = json.loads(json.dumps(json_schema()))
    assert set(schema["properties"]) == {*Tables.model_fields, "extends", "extends_digest"}
    assert schema["additionalProperties"] is False
    smoothing = schema["$defs"]["Smoothing"]["properties"]
    assert set(smoothing) == {"zeta", "lambda", "gamma"}
    assert "[kg]" in schema["$defs"]["Plant"]["properties"]["mass"]["description"]
    number = {"type": "number"}
    values = schema["$defs"]["Effect"]["additionalProperties"]["anyOf"]
    assert values == [number, {"items": number, "type": "array"}]
