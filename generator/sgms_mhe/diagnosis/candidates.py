"""The search: for every effect of the catalogue the force that it would add, and the sizes that fit it best.

To first order an effect adds columns to the model's derivatives: columns in the sizes that it is linear in, given the
few numbers that it is not linear in (pitch, frequency, time constant). Those are tried on grids; everything that the
free
parameters of the model explain is projected out first. What comes out is where a refit of the effect's own definition
starts; nothing is decided on these columns alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft
from scipy.signal import lfilter

from sgms_mhe.diagnosis.evidence import Nuisance, score_test
from sgms_mhe.diagnosis.fitting import (
    FASTEST_STRIBECK,
    CompiledFit,
    Extra,
    Fit,
    Workshop,
    longest_pitch,
    lowest_frequency,
)
from sgms_mhe.diagnosis.residuals import Recording
from sgms_mhe.model.effects import EFFECT_NAMES, effect_definition

Array = NDArray[np.float64]
Values = dict[str, float]

TWO_PI: Final = 2.0 * math.pi
FINEST_PITCH: Final = 1500.0  # of the travel
PITCH_BAND: Final = 0.3  # of the rate of the fit: faster ripples are not in the signals any more
REST: Final = 1e-9
BINS_PER_PERIOD: Final = 6.0
STIFFER: Final = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8)
"""Factors on all stiffnesses that fits may start from."""
SHOWN: Final = 1e-3  # significance of a rise of friction towards low speed that a fit starts from


@dataclass(frozen=True)
class Motion:
    """What columns are computed from; all (m,).

    `level`: f_C d(friction)/d(f_C) [N], what the friction changes by when its level changes by 100 %; `damping`:
    sigma_v [N s/m] (a typical value where the machine has none); `friction`: of the model [N].
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    force: Array
    friction: Array
    level: Array
    damping: float
    mass: float
    rate: float
    used: NDArray[np.bool_]

    @property
    def travel(self) -> float:
        """Range of position on used rows [m]."""
        return float(np.ptp(self.position[self.used]))

    @property
    def speed(self) -> float:
        """Largest speed on used rows [m/s]."""
        return float(np.max(np.abs(self.velocity[self.used])))

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return float(self.time[-1])


@dataclass(frozen=True)
class Proposal:
    """Where the search for one effect ended.

    Attributes:
        name: effect.
        parameters: to start its refit from.
        columns: force per unit of its linear sizes on used rows, nuisance projected out (rows used, k).
        coefficients: the sizes (k).
        energy: sum of squares that it explains [N^2].
        tests: how many independent trials the search amounts to.
        p_value: robust score test, times `tests`.
        feasible: whether the sizes are physically possible.
    """

    name: str
    parameters: Mapping[str, float]
    columns: Array
    coefficients: Array
    energy: float
    tests: float
    p_value: float
    feasible: bool

    @property
    def extra(self) -> Extra:
        """The effect for a refit."""
        return Extra(self.name, self.parameters)


def motion_of(recording: Recording, fit: Fit) -> Motion:
    """Signals and the model's sensitivities at a fit."""
    columns = fit.model.columns
    coulomb = next(i for i, c in enumerate(columns) if c.group == "coulomb")
    viscous = next(i for i, c in enumerate(columns) if c.group == "viscous")
    return Motion(
        time=recording.time,
        position=recording.position,
        velocity=recording.velocity,
        acceleration=recording.acceleration,
        force=recording.force,
        friction=recording.friction - fit.residual,
        level=fit.slopes[:, coulomb] * fit.theta[coulomb],
        damping=columns[viscous].si(fit.theta[viscous]) or columns[viscous].nominal,
        mass=recording.machine.plant.mass,
        rate=recording.rate,
        used=recording.used,
    )


def search(
    workshop: Workshop, fit: Fit, names: Sequence[str], free: Nuisance, residual: Array | None = None
) -> list[Proposal]:
    """Search every named effect in the residual of a fit; `free`: directions of its parameters on used rows.

    `residual` (m): instead of the fit's own.
    """
    recording = workshop.recording
    motion = motion_of(recording, fit)
    e = free.project((fit.residual if residual is None else residual)[recording.used])
    found = []
    for name in names:
        if name not in EFFECT_NAMES:
            continue
        if name in _HARMONICS:
            # Slow trends have more energy than they deserve: a short period gets a proposal of its own.
            found += [p for fine in (False, True) if (p := _search_harmonic(name, motion, recording, free, e, fine))]
            continue
        elif name == "step_disturbance":
            proposal = _search_step(motion, recording, free, e)
        elif name == "dwell_dependence":
            proposal = _search_dwell(workshop, fit, free, e)
        elif name in _COLUMNS:
            proposal = _search_grid(name, motion, recording, free, e)
        else:
            proposal = _search_compiled(name, workshop, fit, motion, free, e)
        if proposal is not None and name in _EXACT:
            proposal = _exact(proposal, workshop, fit, free, e)
        if proposal is not None:
            found.append(proposal)
    return found


_EXACT: Final[Mapping[str, str]] = {
    "asymmetric_coulomb": "ratio",
    "micro_viscous": "damping_N_s_m",
}
"""Effects whose force is proportional to a size, but whose columns are rough where elements stick."""


def _exact(proposal: Proposal, workshop: Workshop, fit: Fit, free: Nuisance, e: Array) -> Proposal:
    """The proposal with its column from the compiled model's derivative at size zero."""
    size = _EXACT[proposal.name]
    extras = (*fit.extras, Extra(proposal.name, {**proposal.parameters, size: 0.0}))
    workshop = workshop.suited(extras)
    recording = workshop.recording
    model = workshop.model(extras)
    theta = workshop.start(model, extras, fit)
    _, slopes = model.run(recording, theta)
    group = f"+{len(fit.extras)}"
    index = next(i for i, c in enumerate(model.columns) if c.group == group and c.name == size)
    if slopes is None or not np.all(np.isfinite(slopes[:, index])):
        return proposal
    Z = free.project(slopes[recording.used][:, [index]] / model.columns[index].scale)

    def parameters(found: Array) -> Values:
        return {**proposal.parameters, size: float(found[0])}

    return _proposal(proposal.name, recording, Z, e, proposal.tests, parameters)


def _search_dwell(workshop: Workshop, fit: Fit, free: Nuisance, e: Array) -> Proposal | None:
    """Derivatives in the ratio at zero, over time constants and lengths, from one compiled model.

    The level's rise dies away within the way over which the elements come up to it: nothing short of the model itself
    says what is left.
    """
    name, workshop = "dwell_dependence", workshop.suited(fit.extras)
    recording = workshop.recording
    friction = workshop.machine.friction
    way = max(nu * friction.coulomb / k for nu, k in zip(friction.fraction, friction.stiffness, strict=True))
    lengths, times = (0.1 * way, 0.4 * way, 1.6 * way), (0.04, 0.12, 0.4, 1.2)
    group = f"+{len(fit.extras)}"
    model = workshop.model((*fit.extras, Extra(name, {"time_constant_s": times[0], "length_m": lengths[0]})))
    index = next(i for i, c in enumerate(model.columns) if c.group == group and c.name == "ratio")
    best: tuple[float, Values, Array] | None = None
    for length in lengths:
        for time in times:
            values = {"ratio": 0.0, "time_constant_s": time, "length_m": length}
            theta = workshop.start(model, (*fit.extras, Extra(name, values)), fit)
            _, slopes = model.run(recording, theta)
            if slopes is None or not np.all(np.isfinite(slopes[:, index])):
                continue
            Z = free.project(slopes[recording.used][:, [index]] / model.columns[index].scale)
            energy = _energy(Z, e)
            if best is None or energy > best[0]:
                best = energy, values, Z
    if best is None or best[0] <= 0.0:
        return None
    return _proposal(name, recording, best[2], e, 6.0, lambda found: {**best[1], "ratio": float(found[0])})


def degenerate(name: str, parameters: Mapping[str, float], motion: Motion) -> bool:
    """Whether an effect's parameters make it another, simpler one over this motion."""
    if name == "hose_hysteresis":  # a spring
        return parameters["force_N"] > 0.7 * motion.travel * abs(parameters["stiffness_N_m"])
    if name == "eddy_current_damping":  # viscous friction
        return parameters["corner_velocity_m_s"] > 2.0 * motion.speed
    if name in ("friction_drift", "viscous_drift"):  # a wrong level
        return parameters["time_constant_s"] < 0.01 * motion.duration
    return False


def stribeck_start(recording: Recording, fit: Fit, free: Nuisance) -> Values:
    """Ratio and velocity to start from where the machine file knows of no rise of friction towards low speed.

    Empty where the record shows none.
    """
    motion = motion_of(recording, fit)
    e = free.project(fit.residual[recording.used])
    speed = np.abs(motion.velocity[motion.used])
    velocities = np.geomspace(3e-4, FASTEST_STRIBECK, 12) * motion.speed
    best: tuple[float, Values] = (0.0, {})
    for velocity in velocities:
        Z = free.project((motion.level[motion.used] * np.exp(-((speed / velocity) ** 2)))[:, None])
        p, size = score_test(recording, Z, e)
        energy = _energy(Z, e)
        if p * len(velocities) < SHOWN and size[0] > 0.0 and energy > best[0]:
            best = energy, {"stribeck_ratio": float(size[0]), "stribeck_velocity": float(velocity)}
    return best[1]


def stiffness_start(workshop: Workshop, extras: Sequence[Extra], material: float) -> Values:
    """Stiffnesses to start from, all by one factor off the machine's; empty where none leaves `material` [N] less."""
    workshop = workshop.suited(extras)
    recording, model = workshop.recording, workshop.model(extras)
    theta = workshop.start(model, extras)
    common = np.array([c.group == "stiffness" for c in model.columns])
    found: dict[float, float] = {}
    for factor in STIFFER:
        friction, _ = model.run(recording, np.where(common, factor * theta, theta), derivatives=False)
        found[factor] = float(np.mean((recording.friction - friction)[recording.used] ** 2))
    best = min(found, key=lambda factor: found[factor])
    if not found[best] < found[1.0] - material**2:
        return {}
    return {c.name: c.si(best * float(t)) for c, t in zip(model.columns, theta, strict=True) if c.group == "stiffness"}


# --- effects that are linear given a few numbers ----------------------------------------------------------------

Columns = Callable[[Motion, Values], Array]


@dataclass(frozen=True)
class _Linear:
    """Columns of an effect over a grid, and its parameters from the sizes found."""

    columns: Columns
    parameters: Callable[[Motion, Values, Array], Values]
    grid: Callable[[Motion], list[Values]] = lambda _: [{}]
    tests: float = 1.0


def _one(name: str) -> Callable[[Motion, Values, Array], Values]:
    """The only size is the parameter of that name."""
    return lambda _, values, size: {**values, name: float(size[0])}


def _sign(velocity: Array) -> Array:
    return np.asarray(np.sign(np.where(np.abs(velocity) > REST, velocity, 0.0)))


def _settling(motion: Motion, values: Values) -> Array:
    return np.asarray(1.0 - np.exp(-motion.time / values["time_constant_s"]))


def _times(motion: Motion) -> list[Values]:
    return [{"time_constant_s": share * motion.duration} for share in (0.03, 0.08, 0.2, 0.4, 0.8, 2.0)]


def _dahl(motion: Motion, length: float) -> Array:
    """Force of a unit Dahl element along the motion: dF/dq = (1 - F sign(v)) / length."""
    moved = np.diff(motion.position, prepend=motion.position[:1])
    keep = np.exp(-np.abs(moved) / length)
    return _first_order(keep, np.sign(moved) * (1.0 - keep))


def _first_order(keep: Array, add: Array) -> Array:
    """x[k] = keep[k] x[k-1] + add[k] from 0."""
    x, result = 0.0, np.empty(len(keep))
    for k, (a, b) in enumerate(zip(keep.tolist(), add.tolist(), strict=True)):
        x = a * x + b
        result[k] = x
    return result


def _lagged(signal: Array, time_constant: float, rate: float) -> Array:
    """First-order lag, bilinear."""
    k = 2.0 * time_constant * rate
    b, a = np.array([1.0, 1.0]) / (1.0 + k), np.array([1.0, (1.0 - k) / (1.0 + k)])
    return np.asarray(lfilter(b, a, signal - signal[0]) + signal[0])


def _hanging(motion: Motion, values: Values) -> Array:
    """Acceleration of a hanging mass minus that of the axis, (2 d w s + w^2) / (s^2 + 2 d w s + w^2) - 1, bilinear."""
    d, f = values["damping_ratio"], values["frequency_Hz"]
    w = TWO_PI * f
    c = w / math.tan(min(0.49 * math.pi, w / (2.0 * motion.rate)))  # prewarped at the frequency itself
    a0, a1, a2 = c * c + 2 * d * w * c + w * w, 2 * (w * w - c * c), c * c - 2 * d * w * c + w * w
    # minus s^2 over the same denominator
    b = -np.array([c * c, -2 * c * c, c * c]) / a0
    return np.asarray(lfilter(b, [1.0, a1 / a0, a2 / a0], motion.acceleration))


def _resonances(motion: Motion) -> list[Values]:
    top = 0.35 * motion.rate
    count = 1 + max(8, round(math.log(top / 4.0) / math.log(1.07)))
    return [{"frequency_Hz": float(f), "damping_ratio": d} for f in np.geomspace(4.0, top, count) for d in (0.02, 0.08)]


_COLUMNS: Final[Mapping[str, _Linear]] = {
    "constant_offset": _Linear(lambda m, _: np.ones((len(m.time), 1)), _one("force_N")),
    "position_spring": _Linear(
        lambda m, _: np.column_stack((m.position, np.ones(len(m.time)))),
        lambda _, __, size: {
            "stiffness_N_m": float(size[0]),
            "centre_m": float(-size[1] / size[0]) if size[0] != 0.0 else 0.0,
        },
    ),
    "hose_hysteresis": _Linear(
        lambda m, p: _dahl(m, p["length"])[:, None],
        lambda _, p, size: {"force_N": float(size[0]), "stiffness_N_m": float(size[0]) / p["length"]},
        lambda m: [{"length": float(x)} for x in m.travel * np.geomspace(0.003, 1.0, 9)],
        tests=4.0,
    ),
    "asymmetric_coulomb": _Linear(lambda m, _: (m.level * _sign(m.velocity))[:, None], _one("ratio")),
    "asymmetric_viscous": _Linear(lambda m, _: np.abs(m.velocity)[:, None], _one("difference_N_s_m")),
    "friction_drift": _Linear(lambda m, p: (m.level * _settling(m, p))[:, None], _one("ratio"), _times, tests=3.0),
    "viscous_drift": _Linear(
        lambda m, p: (m.damping * m.velocity * _settling(m, p))[:, None], _one("ratio"), _times, tests=3.0
    ),
    "mass_mismatch": _Linear(lambda m, _: m.acceleration[:, None], _one("mass_kg")),
    "force_gain": _Linear(
        lambda m, _: m.force[:, None], lambda _, __, size: {"gain": 1.0 / (1.0 - min(0.9, float(size[0])))}
    ),
    "force_delay": _Linear(lambda m, _: -np.gradient(m.force)[:, None] * m.rate, _one("delay_s")),
    "actuator_lag": _Linear(
        lambda m, p: ((m.force - _lagged(m.force, p["time_constant_s"], m.rate)) / p["time_constant_s"])[:, None],
        lambda _, __, size: {"time_constant_s": float(size[0])},
        lambda m: [{"time_constant_s": x / m.rate} for x in (0.1, 1.0, 3.0, 10.0, 30.0)],
        tests=2.0,
    ),
    "quadratic_drag": _Linear(lambda m, _: (m.velocity * np.abs(m.velocity))[:, None], _one("coefficient_N_s2_m2")),
    "eddy_current_damping": _Linear(
        lambda m, p: (m.velocity / (1.0 + (m.velocity / p["corner_velocity_m_s"]) ** 2))[:, None],
        _one("damping_N_s_m"),
        lambda m: [{"corner_velocity_m_s": float(x)} for x in m.speed * np.geomspace(0.02, 1.0, 8)],
        tests=3.0,
    ),
    "structural_resonance": _Linear(lambda m, p: _hanging(m, p)[:, None], _one("mass_kg"), _resonances, tests=40.0),
    # Replaced by the compiled derivative.
    "micro_viscous": _Linear(lambda m, _: np.gradient(m.level)[:, None] * m.rate, _one("damping_N_s_m")),
}


def _search_grid(name: str, motion: Motion, recording: Recording, free: Nuisance, e: Array) -> Proposal | None:
    kind = _COLUMNS[name]
    best: tuple[float, Values, Array] | None = None
    for values in kind.grid(motion):
        Z = free.project(kind.columns(motion, values)[motion.used])
        energy = _energy(Z, e)
        if name == "actuator_lag" and energy > 0.0:
            # A lag is its own size: the one whose coefficient comes closest to its time constant counts.
            size = float((Z.T @ e)[0] / (Z.T @ Z)[0, 0])
            energy *= 1.0 / (1.0 + math.log(max(size, 1e-9) / values["time_constant_s"]) ** 2)
        if best is None or energy > best[0]:
            best = energy, values, Z
    if best is None or best[0] <= 0.0:
        return None
    return _proposal(name, recording, best[2], e, kind.tests, lambda size: kind.parameters(motion, best[1], size))


def _search_step(motion: Motion, recording: Recording, free: Nuisance, e: Array) -> Proposal | None:
    """All instants at once: sums over what follows each of them."""
    time = motion.time[motion.used]
    after = np.arange(len(time), 0, -1.0)
    numerator = np.cumsum(e[::-1])[::-1]
    inside = np.cumsum(free.basis[::-1], axis=0)[::-1]
    denominator = after - np.sum(inside**2, axis=1)
    edge = max(20, len(time) // 20)
    energy = np.where(denominator > 1e-3 * after, numerator**2 / np.maximum(denominator, 1e-9), 0.0)
    energy[:edge] = energy[-edge:] = 0.0
    best = int(np.argmax(energy))
    if energy[best] <= 0.0:
        return None
    # The mean over a row changes in its middle: the step is at the row's beginning.
    at = float(time[best]) - 0.5 / motion.rate
    Z = free.project((time >= time[best]).astype(np.float64)[:, None])
    return _proposal("step_disturbance", recording, Z, e, 30.0, lambda size: {"force_N": float(size[0]), "time_s": at})


def _energy(Z: Array, e: Array) -> float:
    b = Z.T @ e
    H = Z.T @ Z
    if not np.all(np.isfinite(H)) or float(np.trace(H)) <= 0.0:
        return 0.0
    return float(b @ np.linalg.lstsq(H, b, rcond=1e-10)[0])


def _proposal(
    name: str,
    recording: Recording,
    Z: Array,
    e: Array,
    tests: float,
    parameters: Callable[[Array], Values],
) -> Proposal:
    p, size = score_test(recording, Z, e)
    values = parameters(size)
    feasible = True
    clipped = {}
    for parameter in effect_definition(name).parameters:
        value = values.get(parameter.name, parameter.default)
        feasible &= bool(parameter.lower <= value <= parameter.upper) and math.isfinite(value)
        clipped[parameter.name] = value
    return Proposal(name, clipped, Z, size, _energy(Z, e), tests, min(1.0, p * tests), feasible)


# --- effects that are periodic ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Harmonic:
    """A sine in a coordinate: columns Im(g E) and Re(g E) with E = exp(i k x), g = sum_j c_j(k) w_j.

    Attributes:
        coordinate: "position" or "time".
        weights: w_j (m) each.
        factors: c_j of k.
        period: name of the parameter that k = 2 pi / period (or 2 pi frequency) is found for.
        size: name of the amplitude.
    """

    coordinate: str
    weights: Callable[[Motion], list[Array]]
    factors: Callable[[Motion, Array], list[NDArray[np.complex128]]]
    period: str
    size: str


def _ones(k: Array) -> NDArray[np.complex128]:
    ones: NDArray[np.complex128] = np.ones(len(k), dtype=np.complex128)
    return ones


_HARMONICS: Final[Mapping[str, _Harmonic]] = {
    "force_ripple": _Harmonic(
        "position", lambda m: [np.ones(len(m.time))], lambda _, k: [_ones(k)], "pitch_m", "amplitude_N"
    ),
    "force_constant_ripple": _Harmonic("position", lambda m: [-m.force], lambda _, k: [_ones(k)], "pitch_m", "ratio"),
    "position_dependent_friction": _Harmonic(
        "position", lambda m: [m.level], lambda _, k: [_ones(k)], "pitch_m", "ratio"
    ),
    # The encoder reads d too much: u - m a changes by -m d2d/dt2, the model's viscous force by sigma_v dd/dt.
    "encoder_periodic_error": _Harmonic(
        "position",
        lambda m: [m.velocity**2, m.mass * m.acceleration + m.damping * m.velocity],
        lambda m, k: [m.mass * k**2 * _ones(k), -1j * k * _ones(k)],
        "pitch_m",
        "amplitude_m",
    ),
    "periodic_disturbance": _Harmonic(
        "time", lambda m: [np.ones(len(m.time))], lambda _, k: [_ones(k)], "frequency_Hz", "amplitude_N"
    ),
}


def _search_harmonic(
    name: str, motion: Motion, recording: Recording, free: Nuisance, e: Array, fine: bool
) -> Proposal | None:
    """The best period: of those that the record covers six times or more (`fine`), or of the longer ones."""
    kind = _HARMONICS[name]
    used = motion.used
    in_time = kind.coordinate == "time"
    x = (motion.time if in_time else motion.position)[used]
    span = float(np.ptp(x))
    if span <= 0.0:
        return None
    weights = [w[used] for w in kind.weights(motion)]
    speed = np.abs(motion.velocity[used])
    if in_time:
        bands = [(lowest_frequency(recording), 0.45 * motion.rate)]
    else:
        edges = 1.0 / longest_pitch(recording) * 2.0 ** np.arange(0, math.ceil(math.log2(FINEST_PITCH)) + 1)
        bands = [(float(low), float(high)) for low, high in pairwise(edges)]
    split = 4.0 * bands[0][0]
    bands = [(max(low, split), high) for low, high in bands if high > split] if fine else [(bands[0][0], split)]
    best: tuple[float, float, Array] | None = None
    tests = 0.0
    limit = min(PITCH_BAND * motion.rate, 0.7 * recording.machine.sampling.velocity_cutoff)
    for low, high in bands:
        seen = np.ones(len(x)) if in_time else (speed * high < limit).astype(np.float64)
        if seen.mean() < 0.2 or (not in_time and float((speed * seen).sum()) / motion.rate * low < 1.0):
            continue
        kappa, energy = _harmonic_energies(kind, motion, x, [w * seen for w in weights], (low, high), free, e)
        tests += (high - low) * span
        peak = int(np.argmax(energy))
        if best is None or energy[peak] > best[0]:
            best = float(energy[peak]), float(kappa[peak]), seen
    if best is None:
        return None
    _, kappa_best, seen = best
    step = 1.0 / (4.0 * span)

    def columns(kappa: float) -> Array:
        k = np.array([TWO_PI * kappa])
        g = sum(c[0] * w for c, w in zip(kind.factors(motion, k), weights, strict=True)) * seen
        E = g * np.exp(1j * k[0] * x)
        return free.project(np.column_stack((E.imag, E.real)))

    for width in (step, 0.25 * step, 0.06 * step):
        trial = kappa_best + width * np.linspace(-1.0, 1.0, 9)
        trial = np.maximum(trial, bands[0][0])
        kappa_best = float(trial[int(np.argmax([_energy(columns(t), e) for t in trial]))])

    def parameters(size: Array) -> Values:
        period = kappa_best if in_time else 1.0 / kappa_best
        return {
            kind.size: float(np.hypot(size[0], size[1])),
            kind.period: period,
            "phase_rad": float(np.arctan2(size[1], size[0])),
        }

    return _proposal(name, recording, columns(kappa_best), e, max(1.0, tests), parameters)


def _harmonic_energies(
    kind: _Harmonic,
    motion: Motion,
    x: Array,
    weights: list[Array],
    band: tuple[float, float],
    free: Nuisance,
    e: Array,
) -> tuple[Array, Array]:
    """Wavenumbers of a band, four over the span of x apart or closer, and the energy that each one's columns explain.

    Nuisance projected out; FFTs over bins of x, six to the shortest period: what binning loses of a sine (5 %) it loses
    of what is projected out too.
    """
    bin_width = 1.0 / (BINS_PER_PERIOD * band[1])
    index = ((x - x.min()) / bin_width).astype(np.int64)
    count = int(index.max()) + 1
    length = int(next_fast_len(4 * count, real=True))
    grid = 1.0 / (length * bin_width)
    first, last = math.ceil(band[0] / grid), max(math.ceil(band[0] / grid) + 1, math.ceil(band[1] / grid))
    wanted = np.arange(first, last)
    kappa: Array = np.asarray(wanted * grid, dtype=np.float64)
    factors = kind.factors(motion, TWO_PI * kappa)

    def transform(series: Array, at: NDArray[np.int64]) -> NDArray[np.complex128]:
        """sum over rows of series exp(2 pi i kappa x) up to the phase of the first bin, which cancels in energies."""
        sums = np.bincount(index, weights=series, minlength=count)
        return np.asarray(np.conj(rfft(sums, length)[at]))

    def along(series: Array) -> NDArray[np.complex128]:
        return np.asarray(sum(c * transform(w * series, wanted) for c, w in zip(factors, weights, strict=True)))

    target = along(e)
    basis = [along(free.basis[:, j]) for j in range(free.basis.shape[1])]
    square = np.zeros(len(kappa))
    double = np.zeros(len(kappa), dtype=np.complex128)
    for i, (ci, wi) in enumerate(zip(factors, weights, strict=True)):
        for cj, wj in zip(factors[i:], weights[i:], strict=True):
            both = 1.0 if wi is wj else 2.0
            square += both * float(wi @ wj) * np.real(ci * np.conj(cj))
            double += both * ci * cj * transform(wi * wj, 2 * wanted)
    ss, cc, sc = 0.5 * (square - double.real), 0.5 * (square + double.real), 0.5 * double.imag
    s, c = target.imag.copy(), target.real.copy()
    for b in basis:
        # e has no part along the basis, so only the Gram matrix changes.
        ss -= b.imag**2
        cc -= b.real**2
        sc -= b.imag * b.real
    determinant = ss * cc - sc**2
    floor = 1e-3 * np.maximum(square, 1e-300) ** 2
    energy = (cc * s**2 - 2.0 * sc * s * c + ss * c**2) / np.maximum(determinant, floor * 0.01)
    good = (ss > 0.0) & (cc > 0.0) & (determinant > 0.01 * floor)
    return kappa, np.asarray(np.where(good, energy, 0.0), dtype=np.float64)


# --- effects whose force only their own equations give ----------------------------------------------------------

_TRIALS: Final[Mapping[str, Callable[[Motion], list[Values]]]] = {
    "backlash": lambda m: [{"gap_m": float(x)} for x in (1e-6, 3e-6, 1e-5, 3e-5, 1e-4) if x < 0.3 * m.travel],
    "frictional_lag": lambda m: [{"time_constant_s": x} for x in (1e-3, 4e-3, 16e-3, 64e-3)],
}


def _search_compiled(
    name: str, workshop: Workshop, fit: Fit, motion: Motion, free: Nuisance, e: Array
) -> Proposal | None:
    """Run the effect's own model at a few sizes; its column is the change of the force."""
    workshop = workshop.suited(fit.extras)
    recording = workshop.recording
    at_rest = workshop.model(fit.extras)
    theta = workshop.start(at_rest, fit.extras, fit)
    without, _ = at_rest.run(recording, theta, derivatives=False)
    best: tuple[float, Values, Array] | None = None
    trials = _TRIALS[name](motion)
    for values in trials:
        if name == "backlash":
            force = _behind_gap(recording, at_rest, theta, motion, values["gap_m"])
        else:
            extras = (*fit.extras, Extra(name, values))
            model = workshop.model(extras)
            force, _ = model.run(recording, workshop.start(model, extras, fit), derivatives=False)
        if not np.all(np.isfinite(force)):
            continue
        Z = free.project((force - without)[motion.used][:, None])
        energy = _energy(Z, e)
        if energy > 0.0:
            # The trial's own size is the right one where its coefficient is 1.
            size = float((Z.T @ e)[0] / (Z.T @ Z)[0, 0])
            energy *= 1.0 / (1.0 + math.log(max(size, 1e-9)) ** 2)
        if best is None or energy > best[0]:
            best = energy, values, Z
    if best is None or best[0] <= 0.0:
        return None
    key = next(iter(best[1]))
    power = 0.5

    def parameters(size: Array) -> Values:
        factor = float(size[0])
        return {key: best[1][key] * (math.copysign(abs(factor) ** power, factor) if factor != 0.0 else 0.0)}

    return _proposal(name, recording, best[2], e, float(len(trials)), parameters)


def _behind_gap(recording: Recording, model: CompiledFit, theta: Array, motion: Motion, gap: float) -> Array:
    """Friction (m) that moves behind a gap: the model along the motion without what crosses the gap.

    Cheaper than the effect's own equations, whose steps a small gap makes many; good enough to start a refit from.
    """
    signals = recording.signals
    push = np.repeat(motion.friction - motion.damping * motion.velocity, recording.factor)
    moved = (signals.velocity[: len(push)] * recording.machine.sampling.step).tolist()
    engaged = np.empty(len(moved))
    side, left = 1, 0.0  # way left to the side that the mass moves towards
    for k, (step, force) in enumerate(zip(moved, push.tolist(), strict=True)):
        if side > 0 and step < 0.0 and force <= 0.0:
            side, left = 0, gap  # measured from the minus side
        elif side < 0 and step > 0.0 and force >= 0.0:
            side, left = 0, 0.0
        if side == 0:
            left += step
            if left > gap:
                side, step = 1, left - gap
            elif left < 0.0:
                side, step = -1, left
            else:
                step = 0.0
        engaged[k] = step
    velocity = signals.velocity.copy()
    velocity[: len(engaged)] = engaged * recording.machine.sampling.rate
    shifted = replace(recording, signals=replace(signals, velocity=velocity))
    return model.run(shifted, theta, derivatives=False)[0]
