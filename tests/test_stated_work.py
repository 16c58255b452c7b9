"""The work that a package states: never less than what is counted, whatever comes in; and the budget of a tick."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from c_packages import PROBES, Array, build, machine, run, scheme, written
from package_variants import EFFECTS, VARIANTS
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.budget import OPERATION_RATE
from sgms_mhe.emission.element_law import flow_of
from sgms_mhe.emission.least_squares_work import box_least_squares
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.emission.variant import variant_of
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.support.errors import InputError

Tool = Callable[[str], str]

SMALL = {"sampling": {"max_velocity": 0.004}, "estimator": {"horizon": 6}}
"""Runge-Kutta steps at 1 m/s are thousands a sample: counted, they take minutes."""
MACHINES: dict[str, dict[str, Any]] = {
    "etel_xy": {},
    "etel_xy_compensation": {},
    "etel_xy_controller": {},
    "etel_xy_switching": {},
    "emps": {},
    "etel_xy_paper": {"sampling": {"max_velocity": 0.1}, "estimator": {"horizon": 4}},
}
SHAPES = (
    "flow, ekf", "flow, 10 merged", "flow, all merged, all", "rk4", "rk4, all", "rk4, 4 merged",
    "effects: states, 5 merged", "effects: upstream, newest, rk4", "effects: upstream", "effects: time, ekf",
    "effects: levels", "dwell_dependence", "backlash", "every effect, single",
    "n_z 10, newest, 5 merged", "n_z 1, ekf", "horizon 1", "micro-viscous", "sample an update", "bounds of two",
    "fixed, all parameters", "compensation, longest delay", "compensation, rk4",
    "compensation, flow, 5 merged, single", "switching", "switching, 5 merged, all",
    "switching, levels", "switching, levels, 5 merged", "switching, compensation",
    "position loop", "position loop, single", "position loop with all", "position loop with all, single", "voltage",
    "voltage with all, single",
)  # fmt: skip
"""Variants whose work differs in kind."""
LONG = ("every effect, single", "effects: upstream, newest, rk4", "effects: upstream")
MOST_OVER_COUNTED = {"sample": 2.1, "unit": 2.0, "prepare": 2.2, "update": 3.3, "tick": 2.6, "feedback": 1.2}
"""Stated over counted, less the search over all bounds, which no motion asks for."""


def stated(package: Package) -> dict[str, int]:
    """What the public header says."""
    header, config = (package.files[f"{package.machine.name}{end}.h"] for end in ("", "_config"))
    calls = r"^ \*   (tick|sample|prepare|feedback|an update|a command)(?:\(\))? +(\d+)"
    found = dict(re.findall(calls, header, re.MULTILINE))
    lines = re.findall(r"^ \*   .*\d+   .*$", header, re.MULTILINE)
    assert len(found) == 5 + has_drive(package) and all(line in config for line in lines[: len(found)])
    unit = re.search(r"units of at most (\d+)", header)
    assert unit
    return {name.split()[-1]: int(value) for name, value in found.items()} | {"unit": int(unit[1])}


def has_drive(package: Package) -> bool:
    """True where the command is no force."""
    return package.machine.drive.kind != "force"


class Counter:
    """A package whose numbers count what is done with them, as a processor without vectors does it."""

    def __init__(self, package: Package, require_tool: Tool, folder: Path) -> None:
        name, code = package.machine.name, package.machine.code
        source = written(package, folder)
        for path in source.glob("*.[ch]"):
            text = re.sub(r"typedef (?:double|float) (\w*_real);", r"typedef counted \1;", path.read_text())
            text = re.sub(r"__builtin_fabsf?\(", "counted_fabs(", text)
            text = re.sub(r"(#define INVERSE_MOVE) \S+", r"\1 1e30", text)  # every interval has moved too far,
            text = re.sub(r"(#define CLEARLY) \S+", r"\1 0.0", text)  # and the oldest is chosen: the longest sweep
            path.write_text(text)
        number = {"double": "double", "single": "float"}[code.precision]
        definitions = [
            f"-DCOUNTED_NUMBER={number}",
            "-DSGMS_VECTORS=0",
            f"-DSGMS_MACHINE={name}",
            f'-DSGMS_MACHINE_SOURCE="{name}.c"',
            f"-DHAS_UNITS={int(package.machine.estimator.kind == 'mhe')}",
            f"-DHAS_DRIVE={int(has_drive(package))}",
        ]
        self.program = folder / "operations"
        flags = ["-std=c++17", "-O1", "-w", f"-I{PROBES}", f"-I{source}", *definitions]
        build(require_tool("g++"), [PROBES / "operations.cpp"], self.program, flags)

    def most(self, position: Array, force: Array) -> dict[str, int]:
        """The most operations of each call over a motion [m] with its force [N]."""
        samples = self.program.with_name("samples.bin")
        np.column_stack([position, force]).tofile(samples)
        lines = run(self.program, samples).splitlines()
        return {name: int(count) for name, count in (line.split() for line in lines)}


def hard_motions(settings: Machine) -> list[Array]:
    """Motions [m] that ask for much: at max_velocity, below the flow's gate, to and fro, and what no axis does."""
    sampling, friction = settings.sampling, settings.friction
    M, K, speed = sampling.samples_per_update, sampling.merged, sampling.max_velocity
    length = (settings.estimator.horizon + 3) * M
    far = max(nu * friction.coulomb / kappa for nu, kappa in zip(friction.fraction, friction.stiffness, strict=True))
    approach = np.full(min(4 * M, int(80.0 * far / speed * sampling.rate) + 1), 0.05 * speed)
    velocities = [np.concatenate([np.zeros(2 * M), np.full(length, 0.9999 * speed)])]
    if sampling.integrator.scheme == "flow":
        velocities.append(np.concatenate([approach, np.full(length, 0.97 * flow_of(settings).gate_velocity)]))
    k = np.arange(60 * M)
    amplitude = np.repeat(np.geomspace(3e-5, 3.0, 60), M)
    velocities += [amplitude * np.sin(0.9 * np.pi * k / K), 0.02 * amplitude * np.sin(7.0 * k / M)]
    if K > 1:
        turning = 2.0 * np.abs((k + 0.5) / K % 2.0 - 1.0) - 1.0  # in the middle of every step of merged samples
        velocities += [amplitude * np.where(k // K % 2, 1.0, -1.0), amplitude * turning]
    random = np.random.default_rng(1)
    count = max(8 * M, 100)
    steps = np.where(random.random(count) < 0.1, 1e-2, 1e-7) * random.normal(size=count) + 1e-3 * sampling.step
    wild = np.cumsum(steps)
    wild[random.random(count) < 0.02] = np.nan
    wild[-30:-10] = 3.9e6 * (-1.0) ** np.arange(20)
    return [np.cumsum(velocity) * sampling.step for velocity in velocities] + [wild]


def counted(settings: Machine, counter: Counter) -> dict[str, int]:
    """The most operations of each call over all of them."""
    found: list[dict[str, int]] = []
    for position in hard_motions(settings):
        direction = np.sign(np.gradient(np.nan_to_num(position)))
        swing = np.sin(0.05 * np.arange(len(position)))
        found.append(counter.most(position, 4.0 * direction + 3.0 * swing))
    found.append(counter.most(position, 400.0 * swing))  # parameters at their bounds
    return {call: max(most[call] for most in found) for call in found[0]}


def subtract_search(said: dict[str, int], settings: Machine) -> dict[str, int]:
    """Return the stated operations less those of a search over bounds."""
    model = build_model(settings)
    search = box_least_squares(model.n_p) if variant_of(model).bounded else 0
    return {call: most - search * (call in {"tick", "feedback", "update"}) for call, most in said.items()}


@pytest.mark.parametrize("name", list(MACHINES))
def test_stated_work_of_a_machine_holds_and_is_not_far_off(name: str, require_tool: Tool, tmp_path: Path) -> None:
    settings = override_machine(load_machine(name), MACHINES[name])
    package = emit_package(settings, selftest=False, within_budget=True)
    most, said = counted(settings, Counter(package, require_tool, tmp_path)), stated(package)
    assert all(most[call] <= said[call] for call in said), (most, said)
    of_motion = subtract_search(said, settings)
    assert all(of_motion[call] <= limit * most[call] for call, limit in MOST_OVER_COUNTED.items()), (most, said)


@pytest.mark.parametrize(
    "title", [pytest.param(title, marks=pytest.mark.slow) if title in LONG else title for title in SHAPES]
)
def test_stated_work_holds(title: str, require_tool: Tool, tmp_path: Path) -> None:
    variant = VARIANTS[title]
    settings = override_machine(override_machine(load_machine(variant.machine), SMALL), variant.changes)
    package = emit_package(settings, selftest=False)
    most, said = counted(settings, Counter(package, require_tool, tmp_path)), stated(package)
    assert all(most[call] <= said[call] for call in said), (most, said)
    of_motion = subtract_search(said, settings)
    assert all(of_motion[call] <= MOST_OVER_COUNTED[call] * most[call] for call in ("tick", "feedback")), (most, said)
    assert said.get("command", 0) <= 1.6 * most.get("command", 0), (most, said)


# --- the budget ----------------------------------------------------------------------------------------------------


def with_backlash(**changes: Any) -> Machine:
    return machine(effects=[{"name": "backlash", **EFFECTS["backlash"]}], **changes)


def test_what_costs_too_much_is_refused_by_name() -> None:
    with pytest.raises(InputError) as refused:
        emit_package(with_backlash(), selftest=False, within_budget=True)
    message = str(refused.value)
    for said in (
        "code.tick_budget = 100000.0", "the block of backlash", "backlash_place", "498 Runge-Kutta substeps", "100 %",
        "lower sampling.max_velocity (1 m/s)", "raise sampling.integrator.displacement", 'relinearise = "auto"',
    ):  # fmt: skip
        assert said in message


def test_what_the_message_says_helps() -> None:
    changes = {"sampling": {"max_velocity": 1e-3}, "estimator": {"relinearise": "newest"}}
    emit_package(with_backlash(**changes), selftest=False, within_budget=True)
    stated_budget = {"code": {"tick_budget": 1e9}}
    emit_package(with_backlash(**stated_budget), selftest=False, within_budget=True)


def test_elements_that_cost_too_much() -> None:
    with pytest.raises(InputError, match=r'the elements \(states z_1.*1493 Runge-Kutta substeps.*scheme = "flow"'):
        emit_package(machine(sampling=scheme("rk4")), selftest=False, within_budget=True)


def test_default_budget_is_what_a_small_controller_does_in_a_sample() -> None:
    tight = override_machine(load_machine("etel_xy_controller"), {"code": {"tick_budget": 13e3}})
    with pytest.raises(InputError, match=r"code\.tick_budget = 13000\.0"):
        emit_package(tight, selftest=False, within_budget=True)
    emps = load_machine("emps")
    assert emps.code.tick_budget is None
    assert OPERATION_RATE / emps.sampling.rate == 250e3
    longer = override_machine(emps, {"estimator": {"horizon": 60, "relinearise": "all"}})
    with pytest.raises(InputError, match=r"code\.tick_budget = 250000\.0.*2\.5e\+08 operations per second"):
        emit_package(longer, selftest=False, within_budget=True)


def test_substeps_have_a_bound_that_is_a_constant(tmp_path: Path) -> None:
    package = emit_package(with_backlash(), selftest=False)
    assert re.search(r"BLOCK0_MOST_SUBSTEPS = 498,", package.files["etel_xy_config.h"])
    assert "whole < BLOCK0_MOST_SUBSTEPS ? whole : BLOCK0_MOST_SUBSTEPS" in package.files["etel_xy_integrator.h"]
