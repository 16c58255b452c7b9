"""Machines, signals and a linear model that the tests of the reference solvers share."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from sgms_mhe.kinematics import Signals
from sgms_mhe.machine import Machine, load_machine
from sgms_mhe.model import FreeParameter, Model, StateSpec
from sgms_mhe.reference.integrator import Integrator

Array = NDArray[np.float64]


def variant(machine: str = "etel_xy", **tables: dict[str, Any]) -> Machine:
    """A shipped machine with some keys of its tables replaced."""
    content = load_machine(machine).model_dump()
    smoothing = content["friction"]["smoothing"]
    smoothing["lambda"] = smoothing.pop("lambda_")
    for table, keys in tables.items():
        content[table] |= keys
    return Machine.model_validate(content)


def with_integrator(machine: Machine | None = None, **integrator: Any) -> Machine:
    """A machine with another integrator; its defaults as in a machine file."""
    content = (machine or load_machine("etel_xy")).model_dump()
    smoothing = content["friction"]["smoothing"]
    smoothing["lambda"] = smoothing.pop("lambda_")
    content["sampling"]["integrator"] = integrator
    return Machine.model_validate(content)


def moving(velocity: Array, rate: float = 10000.0, friction: Array | None = None) -> Signals:
    """Signals of a motion [m/s], friction valid everywhere."""
    n = len(velocity)
    zeros = np.zeros(n)
    return Signals(
        time=np.arange(n) / rate,
        position=np.cumsum(velocity) / rate,
        velocity=np.asarray(velocity, dtype=float),
        acceleration=np.gradient(velocity) * rate,
        force=zeros,
        friction=zeros if friction is None else friction,
        valid=np.ones(n, dtype=bool),
        missing=np.zeros(n, dtype=bool),
    )


def simulate(integrator: Integrator, signals: Signals, theta: Array, x0: Array | None = None) -> Array:
    """Node states of a record at constant parameters (updates + 1, n_x)."""
    plan = integrator.plan(signals)
    x = np.zeros((len(plan.path) + 1, integrator.model.n_x))
    x[0] = 0.0 if x0 is None else x0
    for k in range(len(plan.path)):
        x[k + 1] = integrator.intervals(plan, k, x[k : k + 1], theta).x1[0]
    return x


def friction_at_samples(model: Model, signals: Signals, nodes: Array, theta: Array) -> Array:
    """Friction record whose entries at the nodes are the model's output, zero between them."""
    samples = model.machine.sampling.samples_per_update
    friction = np.zeros(len(signals))
    output, chi = model.function("output"), model.function("from_node")
    for k, x in enumerate(nodes):
        s = k * samples
        w = [signals.position[s], signals.velocity[s], signals.acceleration[s], signals.force[s], signals.time[s]]
        friction[s] = float(output(chi(x, theta), w, theta))
    return friction


def linear_model(**estimator: Any) -> Model:
    """A model that is linear in (chi, theta) at a given motion: two coupled states and one alone, three parameters."""
    machine = with_integrator(
        variant(
            sampling={"rate": 100.0, "update_rate": 20.0, "velocity_cutoff": 5.0},
            estimator={"bounds": {}} | estimator,
        ),
        scheme="rk4",
        displacement=0.5,
    )
    chi, x, theta, w = ca.SX.sym("chi", 3), ca.SX.sym("x", 3), ca.SX.sym("theta", 3), ca.SX.sym("w", 5)
    v = w[1]
    rhs = ca.vertcat(
        -2.0 * chi[0] + 3.0 * v * chi[2] + theta[0] * v,
        -v * v * chi[1] + 2.0 * (theta[1] - 1.0) + v,
        -1.0 * chi[2] - 0.5 * chi[0] + 0.3 * theta[2],
    )
    states = tuple(
        StateSpec(name, element, 4.0, 3.0, noise, 0.7)
        for name, element, noise in (("a", 0, 0.05), ("b", None, 0.02), ("c", None, 0.1))
    )
    bounds = estimator.get("bounds", {}).get("stiffness", (-np.inf, np.inf))
    scale = ca.DM([1.5, 1.0, 2.0])
    return Model(
        machine=machine,
        states=states,
        parameters=tuple(FreeParameter("stiffness", f"p_{i}", 2.0, 2.0, *bounds) for i in range(3)),
        chi=chi,
        x=x,
        theta=theta,
        w=w,
        rhs=rhs,
        to_node=scale * chi,
        from_node=x / scale,
        output=3.0 * chi[0] - chi[1] + 0.5 * v * chi[2] + theta[2] * v + 0.2 * theta[0],
        feed_forward=3.0 * chi[0] - chi[1] + 0.5 * v * chi[2] + theta[2] * v + 0.2 * theta[0],
        deflection=1e-5 * chi[0],
        level=1.0 + 0.0 * v,
        rho=ca.SX(1.0) + 0.0 * theta[0],
        names=({}, {}, {}),
    )
