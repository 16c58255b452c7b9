"""Machines, signals and a linear model that the tests of the reference solvers share."""

import hashlib
import pickle
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from sgms_mhe.configuration import load_machine, make_machine, override_machine
from sgms_mhe.machine import Machine
from sgms_mhe.model import FreeParameter, Model, StateSpec
from sgms_mhe.reference import estimate_reference
from sgms_mhe.reference.integrator import ReferenceIntegrator
from sgms_mhe.reference.linearised import Linearised
from sgms_mhe.signals.chain import Signals
from sgms_mhe.signals.estimates import Estimates

Array = NDArray[np.float64]


def variant(machine: str = "etel_xy", **tables: dict[str, Any]) -> Machine:
    """A shipped machine that relinearises all, with some keys of its tables replaced."""
    shipped = load_machine(machine)
    content = shipped.as_dict(by_alias=True)
    content["estimator"]["relinearise"] = "all"
    for table, keys in tables.items():
        content[table] |= keys
    return make_machine(content, shipped.source)


def with_integrator(machine: Machine | None = None, **integrator: Any) -> Machine:
    """A machine with another integrator; its defaults as in a machine file."""
    machine = machine or load_machine("etel_xy")
    content = machine.as_dict(by_alias=True)
    content["sampling"]["integrator"] = integrator
    return make_machine(content, machine.source)


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


_estimates: dict[str, Estimates] = {}


def estimate_once(machine: Machine, signals: Signals) -> Estimates:
    """Return what the reference makes of signals, run once for all precisions of the axis's C."""
    axis = override_machine(machine, {"code": {"precision": "double"}})
    key = hashlib.sha256(pickle.dumps((axis.digest, signals))).hexdigest()
    if key not in _estimates:
        _estimates[key] = estimate_reference(axis, signals)
    return _estimates[key]


def arrays(intervals: Linearised) -> tuple[Array, ...]:
    """All arrays of linearised intervals: ends and their sensitivities, then the readings inside and theirs."""
    return (*intervals[:3], *intervals.inner)


def simulate(integrator: ReferenceIntegrator, signals: Signals, theta: Array, x0: Array | None = None) -> Array:
    """Node states of a record at constant parameters (updates + 1, n_x)."""
    plan = integrator.plan(signals)
    x = np.zeros((len(plan.path) + 1, integrator.model.n_x))
    x[0] = 0.0 if x0 is None else x0
    for k in range(len(plan.path)):
        x[k + 1] = integrator.intervals(plan, k, x[k : k + 1], theta).x1[0]
    return x


def lines(velocity: Array, merged: int) -> tuple[Array, Array]:
    """Mean and half the change (steps,) of the least-squares line through each step's samples, by numpy's fit."""
    tau = (2.0 * np.arange(merged) + 1.0) / merged - 1.0
    mean, change = np.polynomial.polynomial.polyfit(tau, velocity[1:].reshape(-1, merged).T, 1)
    return mean, change


def along_lines(machine: Machine, mean: Array, change: Array, h: float, chi: Array) -> tuple[Array, Array, Array]:
    """Converged chi1, dchi1/dchi0 and rho dchi1/drho (steps, n_z) of elements at nominal parameters, one step each.

    RK4 at a displacement of 0.003 in complex arithmetic, whose imaginary part carries one derivative; steps are split
    where the velocity changes sign, and others in the middle.
    """
    friction = machine.friction
    zeta, lambda_, gamma = friction.smoothing.zeta, friction.smoothing.lambda_, friction.smoothing.gamma
    nominal = np.array(friction.stiffness) / (np.array(friction.fraction) * friction.coulomb)

    def rhs(y: Array, v: Array, rho: Array) -> Array:
        r = y / (1.0 + friction.stribeck_ratio * np.exp(-((v / friction.stribeck_velocity) ** 2)))
        eta = 1.0 - 0.5 * np.tanh(lambda_ * (r + zeta)) + 0.5 * np.tanh(lambda_ * (r - zeta))
        eta = eta * (0.5 + 0.5 * np.tanh(gamma * v / friction.stribeck_velocity * r))
        return rho * (v - np.abs(v) * eta * r)

    mean, change = mean[:, None], change[:, None]
    reverses = np.abs(change) > np.abs(mean)
    split = np.where(reverses, -mean / np.where(reverses, change, 1.0), 0.0)
    fastest = float(np.max(np.abs(mean) + np.abs(change)))
    count = int(np.ceil(fastest * h * nominal.max() / 0.003))

    def through(y: Array, rho: Array) -> Array:
        for begin, width in ((-1.0, 1.0 + split), (split, 1.0 - split)):
            step = 0.5 * h * width / count
            for s in range(count):
                v0, vm, v1 = (mean + change * (begin + width * part / count) for part in (s, s + 0.5, s + 1.0))
                k1 = rhs(y, v0, rho)
                k2 = rhs(y + 0.5 * step * k1, vm, rho)
                k3 = rhs(y + 0.5 * step * k2, vm, rho)
                y = y + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rhs(y + step * k3, v1, rho))
        return y

    tiny = 1e-30
    by_chi = through(chi + 1j * tiny, nominal)
    by_rho = through(chi + 0j, nominal * (1.0 + 1j * tiny))
    return by_chi.real, by_chi.imag / tiny, by_rho.imag / tiny


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
            sampling={"rate": 100.0, "update_rate": 20.0, "velocity_cutoff": 5.0}, estimator={"bounds": {}} | estimator
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
