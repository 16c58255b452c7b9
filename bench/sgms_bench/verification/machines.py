"""Random machines: every way through the generator, in sizes that no machine file has yet."""

from typing import Any

import numpy as np
from numpy.random import Generator

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects.catalogue import effect_definition, own_effects
from sgms_mhe.model.effects.parameters import EffectParameter
from sgms_mhe.model.scales import scales_of
from sgms_mhe.support.errors import InputError

MOST_ELEMENTS, MOST_INTERVALS, MOST_EFFECTS = 10, 200, 3
BASE_PARAMETERS = ("stiffness", "coulomb", "viscous", "stribeck_ratio", "stribeck_velocity")
ATTEMPTS = 100
"""Most draws are machines; the others are refused for a reason (an effect that does not go with the law)."""


def random_package(seed: int) -> Package:
    """The package of a machine that is its seed's alone."""
    random = np.random.default_rng(seed)
    base = load_machine("etel_xy")
    for _ in range(ATTEMPTS):
        try:
            return emit_package(override_machine(base, _changes(random, base)), selftest=False)
        except InputError:
            continue
    raise ValueError(f"no machine in {ATTEMPTS} draws of seed {seed}")


def _log_uniform(random: Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _changes(random: Generator, base: Machine) -> dict[str, Any]:
    law = str(random.choice(["sgms", "sgms", "switching"]))
    effects = _effects(random, base)
    changes: dict[str, Any] = {
        "name": "fuzzed",
        "friction": _friction(random, law),
        "sampling": _sampling(random, law),
        "estimator": _estimator(random, effects),
        "compensation": _compensation(random),
        "code": {"precision": str(random.choice(["double", "single"]))},
        "effects": effects,
    }
    changes["estimator"]["disturbance"] = _disturbance(random)  # last: the rest is as without it
    return changes


def _friction(random: Generator, law: str) -> dict[str, Any]:
    n = int(random.integers(1, MOST_ELEMENTS + 1))
    fraction = np.round(random.dirichlet(2.0 * np.ones(n)) * 0.9 + 0.1 / n, 4)
    fraction[-1] = round(1.0 - float(fraction[:-1].sum()), 4)
    damped = random.random() < 0.3
    friction: dict[str, Any] = {
        "law": law,
        "stiffness": [_log_uniform(random, 3e3, 3e5) for _ in range(n)],
        "fraction": [float(nu) for nu in fraction],
        "micro_viscous": [float(random.uniform(0.0, 60.0)) if damped else 0.0 for _ in range(n)],
        "viscous": float(random.choice([0.0, 20.0])),
        "coulomb": _log_uniform(random, 0.5, 40.0),
        "stribeck_ratio": float(random.choice([0.0, 0.12, 0.6])),
        "stribeck_velocity": _log_uniform(random, 1e-4, 1e-2),
    }
    if law == "sgms":
        friction["smoothing"] = {"lambda": float(random.choice([15.0, 35.0, 60.0]))}
    return friction


def _sampling(random: Generator, law: str) -> dict[str, Any]:
    samples = int(random.choice([1, 5, 10, 20, 100]))
    scheme = str(random.choice(["flow", "flow", "rk4"]))
    integrator: dict[str, Any] = {} if law == "switching" else {"scheme": scheme}
    if random.random() < 0.6:  # merged samples, or several substeps
        integrator["substeps"] = int(
            random.choice([s for s in (1, 2, 5, 10, 20, 100, 200) if samples % s == 0 or s % samples == 0])
        )
    # Runge-Kutta steps at 1 m/s are thousands a sample.
    fastest = 1.0 if law == "switching" or scheme == "flow" else 0.02
    return {
        "update_rate": 10000.0 / samples,
        "max_velocity": _log_uniform(random, 0.002, fastest),
        "velocity_cutoff": float(random.choice([100.0, 500.0, 3000.0])),
        "integrator": integrator,
    }


def _effects(random: Generator, base: Machine) -> list[dict[str, Any]]:
    count = int(random.choice([0, 0, 1, MOST_EFFECTS]))
    names = random.choice(own_effects(base.plant.kind), size=count, replace=False)
    return [{"name": str(name), **_values(random, str(name), base)} for name in names]


def _values(random: Generator, name: str, base: Machine) -> dict[str, float]:
    """Numbers of an effect, of a size that matters."""

    def value(p: EffectParameter) -> float:
        size = p.size(scales_of(base)) * _log_uniform(random, 0.3, 3.0)
        return float(np.clip(p.none + size if p.role == "size" else p.default, p.lower, p.upper))

    return {p.name: value(p) for p in effect_definition(name).parameters}


def _estimator(random: Generator, effects: list[dict[str, Any]]) -> dict[str, Any]:
    count = int(random.integers(1, len(BASE_PARAMETERS) + 1))
    parameters = [str(name) for name in random.choice(BASE_PARAMETERS, size=count, replace=False)]
    for effect in effects[:1]:
        sizes = [p.name for p in effect_definition(effect["name"]).parameters if p.is_size]
        parameters += [f"{effect['name']}.{sizes[0]}"] if sizes and random.random() < 0.5 else []
    bounded = [name for name in parameters if random.random() < 0.5 and name in BASE_PARAMETERS]
    return {
        "kind": str(random.choice(["mhe", "mhe", "ekf"])),
        "horizon": round(_log_uniform(random, 1.0, MOST_INTERVALS)),
        "relinearise": str(random.choice(["all", "auto", "auto", "newest"])),
        "parameters": parameters,
        "bounds": {name: [0.2, 5.0] for name in bounded},
        "arrival_cost": {"update": str(random.choice(["riccati", "riccati", "fixed"]))},
        "noise": {
            "measurement": _log_uniform(random, 0.01, 2.0),
            "parameter": _log_uniform(random, 0.02, 1.0),
            "parameter_drift": float(random.choice([0.0, 0.002, 0.02])),
            "state_as": str(random.choice(["force", "deflection"])),
        },
    }


def _compensation(random: Generator) -> dict[str, Any]:
    chosen: dict[str, Any] = {
        "delay": float(random.choice([210e-6, 1e-2])),
        "limit": float(random.choice([5.0, 60.0])),
        "hold": float(random.choice([5e-6, 1e-3])),
        "ramp": float(random.choice([0.01, 1.0])),
    }
    return {key: value for key, value in chosen.items() if random.random() < 0.5}


def _disturbance(random: Generator) -> dict[str, float]:
    """Errors that the estimator takes out: of each key its default, more often than not."""
    drawn = {
        "mass": _log_uniform(random, 1e-3, 1.0),
        "gain": _log_uniform(random, 1e-3, 1.0),
        "force": _log_uniform(random, 0.01, 50.0),
        "length": _log_uniform(random, 1e-6, 0.1),
    }
    return {key: value for key, value in drawn.items() if random.random() < 0.3}
