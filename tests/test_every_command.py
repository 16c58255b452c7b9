"""Machine files as `diagnose` writes them, read by other commands: each effect, both kinds of axis, both laws."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from cli_cases import SMALL, done
from export_cases import FORMS, SUFFIX
from package_variants import EFFECTS, GEARED
from sgms_mhe.configuration import load_machine
from sgms_mhe.diagnosis.extension import extend_machine, extension_toml
from sgms_mhe.machine import Kind
from sgms_mhe.model.effects import effect_definition

LAWS: Final = ("sgms", "switching")
KINDS: Final[tuple[Kind, ...]] = ("linear", "rotary")
SIZES: Final = {**EFFECTS, **GEARED, "unbalance": {"amplitude_N": 1.5, "phase_rad": 0.7}}


def specimens() -> Iterator[tuple[str, Kind, str]]:
    """Each effect, each kind of axis and each law that it stands with."""
    for name in SIZES:
        definition = effect_definition(name)
        for kind in definition.kinds:
            yield from ((name, kind, law) for law in LAWS if law == "sgms" or not definition.smooth_only)


def write_base(folder: Path, kind: Kind, law: str) -> Path:
    """The file of a small axis."""
    text = SMALL.replace("[friction]", f'[friction]\nlaw = "{law}"')
    if kind == "rotary":
        text = text.replace("mass = 20.0", 'kind = "rotary"\ninertia = 20.0')
    if law == "switching":
        text = text.replace('integrator = { scheme = "flow" }\n', "")
    path = folder / "small.toml"
    text = text.replace("[estimator]", "max_velocity = 0.05\n[estimator]", 1)
    path.write_text(f"{text}[code]\ntick_budget = 1e9\n")  # backlash takes many substeps
    return path


def write_extended(folder: Path, kind: Kind, law: str, names: list[str], *, alone: bool) -> Path:
    """The file that `diagnose` writes of a small axis with these causes."""
    base = load_machine(write_base(folder, kind, law))
    extended, changes = extend_machine(base, names, {}, [{"name": name, **SIZES[name]} for name in names])
    path = folder / f"{extended.name}.toml"
    path.write_text(extension_toml(base, extended, changes, folder, (), alone=alone))
    return path


@pytest.mark.parametrize(("name", "kind", "law"), [*specimens()])
def test_each_effect_is_checked_and_exported(name: str, kind: Kind, law: str, tmp_path: Path) -> None:
    path = write_extended(tmp_path, kind, law, [name], alone=law == "switching")
    assert f"effect      {name}: " in done("check", path).stdout
    for form in ("mujoco", "modelica", "simscape", "matlab", "twincat-table"):
        out = tmp_path / f"axis{SUFFIX[form]}"
        assert "holds: " in done("export", path, "--to", form, "--out", out).stdout
        assert out.stat().st_size > 100


@pytest.mark.slow
@pytest.mark.parametrize("late", ["force_delay", "actuator_lag"])
def test_late_force_of_elements_at_their_level(late: str, tmp_path: Path) -> None:
    """C and reference agree on which elements at their level stick, which a late force shows."""
    names = ["position_dependent_friction", late, "load_dependent_friction", "drive_efficiency"]
    path, log = write_extended(tmp_path, "rotary", "switching", names, alone=True), tmp_path / "log.csv"
    done("simulate", path, "--trajectory", "mixed", "--duration", "3", "--out", log)
    assert json.loads(done("compare", path, log, "--json").stdout)["agrees"]


@pytest.mark.slow
def test_effects_with_lists_go_through_every_command(tmp_path: Path) -> None:
    kind, law = KINDS[0], LAWS[0]
    names = [
        name
        for name, of_kind, of_law in specimens()
        if (of_kind, of_law) == (kind, law) and any(p.array for p in effect_definition(name).parameters)
    ]
    assert len(names) >= 3
    path = write_extended(tmp_path, kind, law, names, alone=False)
    log, tuned = tmp_path / "log.csv", tmp_path / "tuned.toml"
    done("simulate", path, "--trajectory", "mixed", "--duration", "6", "--out", log)
    machine = json.loads(done("check", path, "--json").stdout)["machine"]
    assert [effect["name"] for effect in machine["effects"]] == names
    for form in FORMS:
        out = tmp_path / f"axis{SUFFIX[form]}"
        assert json.loads(done("export", path, "--to", form, "--out", out, "--log", log, "--json").stdout)["holds"]
    done("generate", path, "--out", tmp_path / "package")
    done("plan", path, "--out", tmp_path / "plan.csv")
    done("inspect", log, "--machine", path)
    assert json.loads(done("predict", path, log, "--out", tmp_path / "p.csv", "--json").stdout)
    for solver in ("c", "ekf"):
        done("estimate", path, log, "--solver", solver, "--out", tmp_path / f"{solver}.csv")
        assert len((tmp_path / f"{solver}.csv").read_text().splitlines()) > 100
    done("compare", path, log)
    done("tune", path, log, "--out", tuned)
    if tuned.exists():
        done("check", tuned)
