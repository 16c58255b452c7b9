"""Machines whose packages, together, take every way through the generator."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from c_packages import elements, scheme
from reference_cases import linear_model
from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.model import Model

TOY = str(Path(__file__).parent / "golden" / "toy.toml")


@dataclass(frozen=True)
class Variant:
    """A package: a machine file and what is changed in it, or a model of its own; with self-test vectors or without."""

    changes: Mapping[str, Any] = field(default_factory=dict)
    machine: str = "etel_xy"
    selftest: bool = False
    model: Callable[[], Model] | None = None

    @cached_property
    def package(self) -> Package:
        """The package as the generator makes it now."""
        if self.model is not None:
            model = self.model()
            return emit_package(model.machine, model, selftest=self.selftest)
        return emit_package(override_machine(load_machine(self.machine), self.changes), selftest=self.selftest)


EFFECTS: dict[str, dict[str, Any]] = {
    "force_ripple": {"amplitude_N": 0.6, "pitch_m": 0.004, "phase_rad": 0.7},
    "force_constant_ripple": {"ratio": 0.05, "pitch_m": 0.004, "phase_rad": 0.7},
    "constant_offset": {"force_N": 0.5},
    "position_spring": {"stiffness_N_m": 60.0, "centre_m": 0.002},
    "hose_hysteresis": {"stiffness_N_m": 800.0, "force_N": 0.8},
    "asymmetric_coulomb": {"ratio": 0.15},
    "asymmetric_viscous": {"difference_N_s_m": 12.0},
    "position_dependent_friction": {"ratio": 0.2, "pitch_m": 0.004, "phase_rad": 0.7},
    "friction_drift": {"ratio": 0.3, "time_constant_s": 1.0},
    "viscous_drift": {"ratio": 0.5, "time_constant_s": 1.0},
    "mass_mismatch": {"mass_kg": 1.5},
    "force_gain": {"gain": 1.07},
    "force_delay": {"delay_s": 4e-4},
    "actuator_lag": {"time_constant_s": 5e-4},
    "quadratic_drag": {"coefficient_N_s2_m2": 300.0},
    "eddy_current_damping": {"damping_N_s_m": 15.0, "corner_velocity_m_s": 0.03},
    "encoder_periodic_error": {"amplitude_m": 5e-7, "pitch_m": 1e-3, "phase_rad": 0.7},
    "structural_resonance": {"frequency_Hz": 60.0, "damping_ratio": 0.03, "mass_kg": 3.0},
    "periodic_disturbance": {"amplitude_N": 0.4, "frequency_Hz": 13.0, "phase_rad": 0.7},
    "step_disturbance": {"force_N": 0.5, "time_s": 1.2043},
    "backlash": {"gap_m": 2e-5},
    "frictional_lag": {"time_constant_s": 0.02},
    "viscous_lag": {"time_constant_s": 0.02},
    "dwell_dependence": {"ratio": 0.3, "time_constant_s": 0.3, "length_m": 1e-4},
    "micro_viscous": {"damping_N_s_m": 30.0},
    "learned_residual": {
        "place_cells": 2,
        "place_low_m": -0.01,
        "place_high_m": 0.02,
        "travel_cells": 1,
        "travel_length_m": 1e-3,
        "force_N": [0.1 * ((7 * k) % 11 - 5) for k in range(20)],
    },
    "position_map": {"pitch_m": 0.004, "order": [1, 2, 6], "sine_N": [0.5, 0.1, 0.15], "cosine_N": [0.2, -0.3, 0.05]},
    "friction_curve": {"speed_m_s": [0.002, 0.02], "forward_N": [1.2, 0.8], "backward_N": [0.8, 0.4], "end_m_s": 0.2},
}
"""Every effect that any axis may have, of a size that matters."""

GEARED: dict[str, dict[str, float]] = {
    "unbalance": {"amplitude_Nm": 1.5, "phase_rad": 0.7},
    "load_dependent_friction": {"ratio": 0.1, "rise_ratio": 0.05},
    "drive_efficiency": {"efficiency_ratio": 0.8},
}
"""The effects of axes that turn alone, likewise."""

BASE_PARAMETERS = ("stiffness", "coulomb", "viscous", "stribeck_ratio", "stribeck_velocity")
FORCES = ("force_ripple", "constant_offset", "position_spring", "quadratic_drag")
UPSTREAM = ("dwell_dependence", "frictional_lag", "backlash")

INTEGRATORS: dict[str, dict[str, Any]] = {
    "flow": scheme("flow"),
    "flow, many steps below the gate": scheme("flow", slow_displacement=0.003),
    "flow, 2 merged": scheme("flow", substeps=50),
    "flow, 5 merged": scheme("flow", substeps=20),
    "flow, 10 merged": scheme("flow", substeps=10, slow_displacement=0.03),
    "flow, all merged": scheme("flow", substeps=1),
    "rk4": scheme("rk4"),
    "rk4, two substeps": scheme("rk4", substeps=200),
    "rk4, fine": scheme("rk4", displacement=0.01),
    "rk4, 4 merged": scheme("rk4", substeps=25),
}
"""Tables `sampling`."""

ESTIMATORS: dict[str, dict[str, Any]] = {
    "all": {"relinearise": "all"},
    "newest": {"relinearise": "newest"},
    "ekf": {"kind": "ekf"},
    "fixed": {"arrival_cost": {"update": "fixed"}},
}
"""Tables `estimator`, beside that of the default: relinearise = "auto", with the Riccati equation."""


def _entries(*names: str) -> list[dict[str, Any]]:
    return [{"name": name, **EFFECTS.get(name, GEARED.get(name, {}))} for name in names]


def _estimating(*parameters: str, **more: Any) -> dict[str, Any]:
    return {"parameters": list(parameters), **more}


def _integration() -> dict[str, Variant]:
    variants = {name: Variant({"sampling": sampling}) for name, sampling in INTEGRATORS.items()}
    for name in ("flow", "flow, 5 merged", "flow, all merged", "rk4", "rk4, 4 merged"):
        for kind, estimator in ESTIMATORS.items():
            variants[f"{name}, {kind}"] = Variant({"sampling": INTEGRATORS[name], "estimator": estimator})
    variants |= {
        "sample an update": Variant({"sampling": {"update_rate": 10000.0, **scheme("flow")}}),
        "five samples an update": Variant({"sampling": {"update_rate": 2000.0, **scheme("rk4")}}),
        "flow, two substeps, with states": Variant(
            {"sampling": scheme("flow", substeps=200), "effects": _entries("hose_hysteresis")}
        ),
        "flow, coarse, with states": Variant(
            {"sampling": scheme("flow", displacement=0.2), "effects": _entries("hose_hysteresis")}
        ),
        "slow": Variant({"sampling": {"max_velocity": 0.01}}),
        "gentle smoothing": Variant(
            {"friction": {"smoothing": {"zeta": 0.8, "lambda": 15.0, "gamma": 20.0}}, "sampling": scheme("rk4")}
        ),
        "sharp smoothing": Variant({"friction": {"smoothing": {"lambda": 60.0}}}),
        "no rise towards low speed": Variant({"friction": {"stribeck_ratio": 0.0}}),
        "no viscous friction": Variant({"friction": {"viscous": 0.0}}),
    }
    return variants


def _elements() -> dict[str, Variant]:
    variants = {}
    for n in (1, 2, 10):
        friction = {"friction": elements(n)}
        variants |= {
            f"n_z {n}": Variant(friction),
            f"n_z {n}, all": Variant({**friction, "estimator": ESTIMATORS["all"]}),
            f"n_z {n}, newest, 5 merged": Variant(
                {**friction, "sampling": INTEGRATORS["flow, 5 merged"], "estimator": {"relinearise": "newest"}}
            ),
            f"n_z {n}, ekf": Variant({**friction, "estimator": {"kind": "ekf"}}),
        }
    damped = {"micro_viscous": [50.0, 20.0, 10.0, 5.0]}
    partly = {"micro_viscous": [50.0, 0.0, 10.0, 0.0]}
    return variants | {
        "micro-viscous": Variant({"friction": damped}),
        "micro-viscous, fixed": Variant({"friction": damped, "estimator": ESTIMATORS["fixed"]}),
        "micro-viscous, all": Variant({"friction": damped, "estimator": ESTIMATORS["all"]}),
        "micro-viscous, ekf, 5 merged": Variant(
            {"friction": damped, "estimator": {"kind": "ekf"}, "sampling": INTEGRATORS["flow, 5 merged"]}
        ),
        "two elements micro-viscous": Variant({"friction": partly}),
        "two elements micro-viscous, rk4": Variant({"friction": partly, "sampling": scheme("rk4")}),
    }


def _estimation() -> dict[str, Variant]:
    variants = {
        f"estimates {name}": Variant({"estimator": _estimating(name)}) for name in (*BASE_PARAMETERS[1:], "fraction")
    }
    bounds = {"stiffness": [0.9, 1.05], "coulomb": [0.5, 2.0]}
    for n in (1, 2, 5, 40):
        variants[f"horizon {n}"] = Variant({"estimator": {"horizon": n}})
    for name, kind in ESTIMATORS.items():
        variants[f"{name}, horizon 2"] = Variant({"estimator": {"horizon": 2, **kind}})
        variants[f"{name}, deflection"] = Variant({"estimator": {"noise": {"state_as": "deflection"}, **kind}})
        variants[f"{name}, all parameters"] = Variant({"estimator": _estimating(*BASE_PARAMETERS, **kind)})
    return variants | {
        "all parameters": Variant({"estimator": _estimating(*BASE_PARAMETERS)}),
        "coulomb, viscous": Variant({"estimator": _estimating("coulomb", "viscous")}),
        "bounds of two": Variant({"estimator": {"parameters": ["stiffness", "coulomb"], "bounds": bounds}}),
        "bounds of two, 5 merged": Variant(
            {
                "estimator": {"parameters": ["stiffness", "coulomb"], "bounds": bounds},
                "sampling": INTEGRATORS["flow, 5 merged"],
            }
        ),
        "deflection": Variant({"estimator": {"noise": {"state_as": "deflection"}}}),
        "uncertain mass": Variant({"estimator": {"disturbance": {"mass": 0.01, "gain": 0.01}}}, selftest=True),
        "uncertain mass, single, ekf": Variant(
            {
                "estimator": {"kind": "ekf", "disturbance": {"mass": 0.01}},
                "code": {"precision": "single"},
                "compensation": {"delay": 210e-6, "limit": 20.0, "hold": 5e-6},
            }
        ),
        "uncertain mass beside one, 5 merged": Variant(
            {
                "estimator": {"disturbance": {"mass": 0.01}},
                "effects": _entries("mass_mismatch"),
                "sampling": INTEGRATORS["flow, 5 merged"],
            }
        ),
        "place force": Variant({"estimator": {"disturbance": {"force": 0.2}}}, selftest=True),
        "place force, all": Variant(
            {"estimator": {**ESTIMATORS["all"], "disturbance": {"force": 0.2, "length": 5e-3}}}
        ),
        "place force and mass, single, ekf": Variant(
            {
                "estimator": {"kind": "ekf", "disturbance": {"force": 0.2, "mass": 0.01}},
                "code": {"precision": "single"},
                "compensation": {"delay": 210e-6, "limit": 20.0, "hold": 5e-6},
            }
        ),
        "accuracy": Variant({"code": {"accuracy": 1e-3}}, selftest=True),
        "accuracy, 5 merged": Variant({"code": {"accuracy": 1e-3}, "sampling": INTEGRATORS["flow, 5 merged"]}),
        "accuracy, viscous, measurements at ends": Variant(
            {
                "code": {"accuracy": 1e-4},
                "estimator": _estimating("viscous", "coulomb"),
                "sampling": {"update_rate": 1000.0},
            }
        ),
        "no drift": Variant({"estimator": {"noise": {"parameter_drift": 0.0}}}),
        "all, fixed": Variant({"estimator": {**ESTIMATORS["all"], **ESTIMATORS["fixed"]}}),
        "newest, fixed, horizon 1": Variant(
            {"estimator": {"relinearise": "newest", "horizon": 1, **ESTIMATORS["fixed"]}}
        ),
        "linear model": Variant(model=linear_model, selftest=True),
        "linear model, fixed, bounds": Variant(
            model=lambda: linear_model(bounds={"stiffness": (0.5, 2.0)}, arrival_cost={"update": "fixed"})
        ),
        "linear model, auto": Variant(model=lambda: linear_model(relinearise="auto")),
    }


def _effects() -> dict[str, Variant]:
    variants = {}
    for name, parameters in EFFECTS.items():
        freed = _estimating("stiffness", *(f"{name}.{parameter}" for parameter in parameters))
        variants[name] = Variant({"effects": _entries(name), "estimator": freed})
    combined: dict[str, tuple[str, ...]] = {
        "states": ("hose_hysteresis", "structural_resonance"),
        "upstream": UPSTREAM,
        "time": ("periodic_disturbance", "step_disturbance", "friction_drift", "viscous_drift"),
        "lags": ("force_delay", "actuator_lag", "encoder_periodic_error"),
        "levels": ("asymmetric_coulomb", "position_dependent_friction", "micro_viscous", "force_gain"),
    }
    for title, names in combined.items():
        effects = {"effects": _entries(*names)}
        variants |= {
            f"effects: {title}": Variant(effects),
            f"effects: {title}, 5 merged": Variant({**effects, "sampling": INTEGRATORS["flow, 5 merged"]}),
            f"effects: {title}, newest, rk4": Variant(
                {**effects, "estimator": ESTIMATORS["newest"], "sampling": INTEGRATORS["rk4"]}
            ),
            f"effects: {title}, ekf": Variant({**effects, "estimator": {"kind": "ekf"}}),
        }
    ripples = [{**EFFECTS["force_ripple"], "name": "force_ripple", "pitch_m": pitch} for pitch in (0.032, 0.001)]
    all_main = ["stiffness", "constant_offset.force_N", "backlash.gap_m", "dwell_dependence.ratio", "force_gain.gain"]
    return variants | {
        "two ripples": Variant(
            {
                "effects": ripples,
                "estimator": {
                    "parameters": ["stiffness", "force_ripple.amplitude_N", "force_ripple_2.amplitude_N"],
                    "bounds": {"force_ripple_2.amplitude_N": [0.1, 3.0]},
                },
            }
        ),
        "two hoses": Variant({"effects": _entries("hose_hysteresis", "hose_hysteresis")}),
        "forces": Variant({"effects": _entries(*FORCES)}),
        "every effect": Variant({"effects": _entries(*EFFECTS), "estimator": _estimating(*all_main)}),
        "every effect, all": Variant(
            {"effects": _entries(*EFFECTS), "estimator": _estimating(*all_main, **ESTIMATORS["all"])}
        ),
        "every effect, fixed, rk4, 4 merged": Variant(
            {
                "effects": _entries(*EFFECTS),
                "estimator": _estimating(*all_main, **ESTIMATORS["fixed"]),
                "sampling": INTEGRATORS["rk4, 4 merged"],
            }
        ),
        "position map, from its table": Variant({"effects": _entries("position_map")}),
        "learned residual, from its table": Variant({"effects": _entries("learned_residual")}),
        "friction curve, of fixed numbers": Variant({"effects": _entries("friction_curve")}),
        "friction curve that follows late": Variant({"effects": _entries("friction_curve", "viscous_lag")}),
        "dwell dependence, n_z 10": Variant({"effects": _entries("dwell_dependence"), "friction": elements(10)}),
        "frictional lag, n_z 1": Variant({"effects": _entries("frictional_lag"), "friction": elements(1)}),
    }


def _geared() -> dict[str, Variant]:
    """Levels that hang on acceleration and position, on their own and together."""
    freed = {
        name: _estimating("stiffness", *(f"{name}.{parameter}" for parameter in parameters))
        for name, parameters in GEARED.items()
    }
    variants = {
        name: Variant({"effects": _entries(name), "estimator": estimator}, "etel_xy_rotary")
        for name, estimator in freed.items()
    }
    merged = INTEGRATORS["flow, 5 merged"]
    kept: dict[str, dict[str, Any]] = {
        "": {},
        ", 5 merged": {"sampling": merged},
        ", newest, rk4": {"estimator": ESTIMATORS["newest"], "sampling": INTEGRATORS["rk4"]},
        ", ekf": {"estimator": {"kind": "ekf"}},
        ", switching, 5 merged": {"friction": {"law": "switching"}, "sampling": {"integrator": {"substeps": 20}}},
        ", compensation": {"compensation": {"delay": 210e-6, "limit": 20.0, "hold": 5e-6}},
        ", single": {"code": {"precision": "single"}},
    }
    together = {"effects": _entries(*GEARED)}
    return variants | {
        f"geared{name}": Variant({**together, **changes}, "etel_xy_rotary") for name, changes in kept.items()
    }


def _compensation() -> dict[str, Variant]:
    late = {"delay": 210e-6, "ramp": 0.05, "limit": 20.0, "hold": 5e-6}
    effects = {"effects": _entries("force_ripple", "force_delay", "asymmetric_coulomb")}
    kept: dict[str, dict[str, Any]] = {
        "": {},
        ", rk4": {"sampling": scheme("rk4")},
        ", flow, 5 merged": {"sampling": INTEGRATORS["flow, 5 merged"]},
        ", ekf": {"estimator": {"kind": "ekf"}},
        ", n_z 10": {"friction": elements(10)},
        ", micro-viscous": {"friction": {"micro_viscous": [50.0, 20.0, 10.0, 5.0]}},
        ", effects": effects,
        ", upstream": {"effects": _entries(*UPSTREAM)},
        ", states": {"effects": _entries("hose_hysteresis", "structural_resonance", "actuator_lag")},
    }
    variants = {f"compensation{name}": Variant({"compensation": late, **changes}) for name, changes in kept.items()}
    return variants | {
        "compensation off": Variant({"compensation": {**late, "enabled": False}}),
        "compensation, longest delay": Variant({"compensation": {"delay": 0.1}}),
        "compensation, limit alone": Variant({"compensation": {"limit": 5.0}}),
        "compensation, hold alone": Variant({"compensation": {"hold": 1e-5}}),
        "compensation, ramp alone": Variant({"compensation": {"ramp": 1.0}}),
    }


def _switching() -> dict[str, Variant]:
    """Elements that switch, sample by sample and merged, their levels with states and parameters of their own."""
    merged = {"integrator": {"substeps": 20}}
    levels = ("dwell_dependence", "frictional_lag", "asymmetric_coulomb", "encoder_periodic_error", "hose_hysteresis")
    kept: dict[str, dict[str, Any]] = {
        "": {},
        ", 5 merged": {"sampling": merged},
        ", all": {"estimator": ESTIMATORS["all"]},
        ", 5 merged, all": {"estimator": ESTIMATORS["all"], "sampling": merged},
        ", ekf": {"estimator": {"kind": "ekf"}},
        ", all parameters, 5 merged": {"estimator": _estimating(*BASE_PARAMETERS), "sampling": merged},
        ", levels": {"effects": _entries(*levels), "estimator": _estimating("stiffness", "asymmetric_coulomb.ratio")},
        ", levels, 5 merged": {"effects": _entries(*levels), "sampling": merged},
        ", compensation": {"compensation": {"delay": 210e-6, "limit": 20.0, "hold": 5e-6}},
    }
    return {
        f"switching{name}": Variant({**changes, "friction": {"law": "switching"}}) for name, changes in kept.items()
    }


LOOP = {"torque_constant": 20.0, "resistance": 2.0, "supply": 48.0, "gain": 32.0, "gain_unit": 12.0}
LOOP |= {"kind": "position_loop"}
"""A loop with what it has to have; the next one has all that it may have besides."""
LOOP_WITH_ALL = {**LOOP, "start": 0.03, "clamp": 0.4, "delay": 7e-4, "speed_limit": 0.2}


def _commanded() -> dict[str, Variant]:
    """Axes whose command is no force: drives with all keys and with the least of them, in both precisions."""
    voltage = {"kind": "voltage", "torque_constant": 20.0, "resistance": 2.0}
    single = {"code": {"precision": "single"}}
    return {
        "position loop": Variant({"drive": LOOP}),
        "position loop, single": Variant({"drive": LOOP, **single}),
        "position loop with all": Variant({"drive": LOOP_WITH_ALL}, selftest=True),
        "position loop with all, single": Variant({"drive": LOOP_WITH_ALL, **single}, selftest=True),
        "voltage": Variant({"drive": voltage}, selftest=True),
        "voltage with all, single": Variant(
            {"drive": {**voltage, "supply": 48.0, "clamp": 0.9, "delay": 4e-4}, **single}
        ),
    }


def _single(variants: Mapping[str, Variant]) -> dict[str, Variant]:
    """What a precision may change, in single precision: one of each kind of code."""
    names = """
        flow; flow, 2 merged; flow, 5 merged; flow, all merged; rk4; rk4, 4 merged; flow, ekf; flow, all; flow, newest;
        flow, fixed; flow, 5 merged, all; flow, 5 merged, ekf; rk4, newest; sample an update; sharp smoothing; n_z 1;
        n_z 2, all; n_z 10; n_z 10, newest, 5 merged; micro-viscous; two elements micro-viscous, rk4; horizon 1;
        horizon 40; all parameters; bounds of two, 5 merged; deflection; every effect;
        every effect, fixed, rk4, 4 merged; effects: states, 5 merged; effects: upstream, 5 merged;
        effects: upstream, newest, rk4; effects: time, ekf; effects: lags; compensation; compensation, flow, 5 merged;
        compensation, ekf;
        compensation, upstream; compensation off; switching, 5 merged; switching, levels; switching, compensation
    """
    chosen = [" ".join(name.split()) for name in names.split(";")]
    return {
        f"{name}, single": Variant(
            {**variants[name].changes, "code": {"precision": "single"}}, variants[name].machine, variants[name].selftest
        )
        for name in chosen
    }


def _machines() -> dict[str, Variant]:
    """Whole packages, self-test vectors included, of the committed machines and of small variants."""
    committed = (
        "emps",
        "etel_xy",
        "etel_xy_compensation",
        "etel_xy_controller",
        "etel_xy_paper",
        "etel_xy_rotary",
        "etel_xy_switching",
    )
    variants = {f"machine {name}": Variant(machine=name, selftest=name != "etel_xy_paper") for name in committed}
    small: dict[str, dict[str, Any]] = {
        "": {},
        ", single": {"code": {"precision": "single"}},
        ", ekf": {"estimator": {"kind": "ekf"}},
        ", auto": {"estimator": {"relinearise": "auto", "horizon": 4}},
        ", newest": {"estimator": {"relinearise": "newest", "horizon": 4}},
        ", fixed": {"estimator": {"arrival_cost": {"update": "fixed"}, "noise": {"state_as": "deflection"}}},
        ", flow": {"sampling": {"integrator": {"scheme": "flow", "substeps": 1}}},
        ", states": {"effects": _entries("hose_hysteresis", "dwell_dependence")},
        ", time": {"effects": _entries("periodic_disturbance", "friction_drift")},
    }
    return variants | {f"toy{name}": Variant(changes, TOY, selftest=True) for name, changes in small.items()}


def _all() -> dict[str, Variant]:
    double = _integration() | _elements() | _estimation() | _effects() | _geared() | _compensation() | _switching()
    return double | _single(double) | _commanded() | _machines()


VARIANTS: Mapping[str, Variant] = _all()
"""Every variant by its title."""
