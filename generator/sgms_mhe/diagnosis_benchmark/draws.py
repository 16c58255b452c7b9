"""What is hidden in a log: drawn from (seed, index) alone, sized by the force that it adds, and fair.

The size of a cause is the force it adds to the measured friction along the motion, exceeded in a fiftieth of the log,
over the Coulomb level: for a ripple its amplitude, for what acts after reversals only what it reaches there. Fair means
that the log meets the excitation that the cause's own description asks for, and that after a refit of the base model's
numbers at least `VISIBLE` of its force is left to be seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sgms_mhe.diagnosis.excitation import measures
from sgms_mhe.diagnosis.fitting import cached_package
from sgms_mhe.diagnosis_benchmark.foreign import FOREIGN
from sgms_mhe.diagnosis_benchmark.motions import STYLES, WEAK_STYLES, deflection, draw_motion
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import override_machine
from sgms_mhe.model.effects import BASE_CAUSES, EFFECT_NAMES, cause, effect_definition
from sgms_mhe.plant.simulation import AxisConfig, simulate_axis
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.signals.chain import Signals, settle_samples, signals_from_log
from sgms_mhe.signals.logs import Log

if TYPE_CHECKING:
    from sgms_mhe.machine import Machine

Array = NDArray[np.float64]
Values = dict[str, float]

KINDS: Final = (
    "single", "clean", "single", "base", "single", "clean", "double", "single", "foreign", "clean",
    "single", "double", "single", "clean", "base", "single", "foreign", "single", "clean", "weak",
)  # fmt: skip
"""What the draws are, in turn: any number of draws from the first on is balanced."""
LEAST_SIZE: Final = 0.05
"""Sizes from here on count in the rates; smaller ones show where finding ends."""
VISIBLE: Final = 0.3
SECONDS: Final = (10.0, 16.0)
ATTEMPTS: Final = 25
_RARE: Final = 4.0  # largest force of a foreign cause, over its size
_RATE: Final = 500.0  # of projections


@dataclass(frozen=True)
class Hidden:
    """One hidden cause: `parameters` of an effect, or `factors` on base parameters; `size`, `visible` as above."""

    name: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    size: float = math.nan
    visible: float = math.nan


@dataclass(frozen=True)
class Draw:
    """One log of the benchmark.

    Attributes:
        index: of the draw.
        kind: single, base (a wrong number), double, clean, foreign (outside the catalogue), weak (the log cannot tell).
        hidden: the causes; of a foreign force its name and size.
        machine_changes: of the machine that is diagnosed, over the one given.
        style, seconds, motion_seed: of the motion.
        law, force_noise_N, encoder_noise_m, encoder_resolution_m, noise_seed: of the simulated axis.
    """

    index: int
    kind: str
    hidden: tuple[Hidden, ...]
    machine_changes: Mapping[str, Any]
    style: str
    seconds: float
    motion_seed: int
    law: str
    force_noise_N: float
    encoder_noise_m: float
    encoder_resolution_m: float
    noise_seed: int

    @property
    def truth(self) -> tuple[str, ...]:
        """Names that a diagnosis should find."""
        return () if self.kind in ("clean", "foreign") else tuple(h.name for h in self.hidden)

    @property
    def size(self) -> float:
        """Of the smallest hidden cause; NaN where none is hidden."""
        return min((h.size for h in self.hidden), default=math.nan)

    def to_json(self) -> dict[str, Any]:
        """Plain content."""
        content: dict[str, Any] = asdict(self)
        return content

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Draw:
        """The draw of `to_json`."""
        return cls(**{**content, "hidden": tuple(Hidden(**h) for h in content["hidden"])})


def make_draw(machine: Machine, seed: int, index: int) -> Draw:
    """Draw number `index` of a series."""
    random = np.random.default_rng([seed, index])
    kind = KINDS[index % len(KINDS)]
    cycle, place = divmod(index, len(KINDS))
    number = cycle * KINDS.count(kind) + KINDS[:place].count(kind)  # of its kind
    for _ in range(ATTEMPTS):
        draw = _attempt(machine, kind, number, seed, index, random)
        if draw is not None:
            return draw
    # Nothing fair was found: the log of a clean axis takes the place.
    return _frame(machine, "clean", index, random, _style(random))


def machine_of(machine: Machine, draw: Draw) -> Machine:
    """The machine that the draw's log is diagnosed with."""
    return override_machine(machine, draw.machine_changes) if draw.machine_changes else machine


def simulate_draw(machine: Machine, draw: Draw) -> tuple[Log, float]:
    """The log, and the RMS of its friction's noise over means of ten samples [N] (NaN where the log is distorted)."""
    axis = machine_of(machine, draw)
    config = AxisConfig(
        law=draw.law,  # type: ignore[arg-type]
        force_noise_N=draw.force_noise_N,
        encoder_noise_m=draw.encoder_noise_m,
        encoder_resolution_m=draw.encoder_resolution_m,
        seed=draw.noise_seed,
    )
    foreign = draw.kind == "foreign"
    effects = [(h.name, h.parameters) for h in draw.hidden if h.parameters and not foreign]
    scale: Values = {}
    for hidden in draw.hidden:
        scale |= dict(hidden.factors)
    run = simulate_axis(axis, _motion(axis, draw), config, hidden_effects=effects, scale=scale)
    log = replace(run.log, source=f"draw_{draw.index}.csv")
    if foreign:
        # The controller holds the reference against it: the force it takes shows in the log, the motion does not.
        log = replace(log, force_N=log.force_N + foreign_force(axis, draw, draw.hidden[0]))
    return log, _noise(axis, run.log, run.truth) if not effects else math.nan


def foreign_force(machine: Machine, draw: Draw, hidden: Hidden) -> Array:
    """The foreign force along the draw's reference (n) [N]."""
    motion = _motion(machine, draw)
    force = FOREIGN[hidden.name](
        np.random.default_rng([draw.noise_seed, 7]), motion.time_s, motion.position_m, motion.velocity_m_s
    )
    return np.asarray(force * (hidden.size * machine.friction.coulomb / _peak(force)))


# --- drawing ----------------------------------------------------------------------------------------------------


def _attempt(machine: Machine, kind: str, number: int, seed: int, index: int, random: Generator) -> Draw | None:
    if kind == "clean":
        return _frame(machine, kind, index, random, _style(random))
    if kind == "weak":
        return _weak(machine, index, number, random)
    draw = _frame(machine, kind, index, random, _style(random))
    if kind == "foreign":
        hidden = Hidden(list(FOREIGN)[number % len(FOREIGN)], size=_size(random, 0.1))
        draw = replace(draw, hidden=(hidden,))
        plain = _prescribed(machine, _motion(machine, draw), Hidden(""))
        force = foreign_force(machine, draw, hidden)
        if np.abs(force).max() > _RARE * hidden.size * machine.friction.coulomb:
            return None  # hardly ever there: its size says nothing
        left = _visible(machine, _sensitivities(machine, plain), force)
        return replace(draw, hidden=(replace(hidden, visible=left),)) if left >= 0.6 else None
    if kind == "base":
        return _with_causes(machine, draw, (_in_turn(tuple(BASE_CAUSES), number, seed),), random)
    if kind == "single":
        name = _in_turn(EFFECT_NAMES, number, seed)
        return _with_causes(machine, draw, (name,), random)
    first, second = random.choice(EFFECT_NAMES, 2, replace=False).tolist()
    if second in cause(first).confused_with or first in cause(second).confused_with:
        return None
    return _with_causes(machine, draw, (first, second), random)


def _in_turn(names: tuple[str, ...], number: int, seed: int) -> str:
    """Every name once before any comes again, in an order that changes with every round."""
    cycle, place = divmod(number, len(names))
    return str(np.random.default_rng([seed, 10**6 + cycle]).permutation(names)[place])


def _frame(machine: Machine, kind: str, index: int, random: Generator, style: str) -> Draw:
    """A draw without causes: motion, law and noise."""
    coulomb, mass = machine.friction.coulomb, machine.plant.mass
    # What the encoder's noise makes of the inertial force behind the filters, roughly.
    gain = 0.3 * mass * (2.0 * math.pi * machine.sampling.velocity_cutoff) ** 2
    return Draw(
        index=index,
        kind=kind,
        hidden=(),
        machine_changes={},
        style=style,
        seconds=float(random.uniform(*SECONDS)),
        motion_seed=int(random.integers(2**31)),
        law=str(random.choice(["sgms", "maxwell_slip"])),
        force_noise_N=coulomb * _log_uniform(random, 0.004, 0.06),
        encoder_noise_m=coulomb * _log_uniform(random, 0.001, 0.02) / gain,
        encoder_resolution_m=coulomb * _log_uniform(random, 0.001, 0.03) / gain,
        noise_seed=int(random.integers(2**31)),
    )


def _style(random: Generator) -> str:
    return str(random.choice(STYLES, p=[0.55, 0.15, 0.15, 0.15]))


def _with_causes(machine: Machine, draw: Draw, names: tuple[str, ...], random: Generator) -> Draw | None:
    if "frictional_lag" in names:
        # With little Stribeck effect there is little to lag.
        ratio = max(0.4, machine.friction.stribeck_ratio)
        draw = replace(draw, machine_changes={"name": "lagging", "friction": {"stribeck_ratio": ratio}})
    axis = machine_of(machine, draw)
    motion = _motion(axis, draw)
    plain = _prescribed(axis, motion, Hidden(""))
    found, columns = measures(plain, axis), _sensitivities(axis, plain)
    causes, forces = [], []
    for name in names:
        sized = _sized(axis, motion, plain, name, _size(random), random)
        if sized is None or cause(name).excitation.unmet(found, sized[0].parameters):
            return None
        causes.append(sized[0])
        forces.append(sized[1])
    for k, hidden in enumerate(causes):
        others = np.stack([f for j, f in enumerate(forces) if j != k], axis=1) if len(forces) > 1 else None
        left = _visible(axis, columns, forces[k], others)
        # A wrong number is itself what the projection takes out.
        if hidden.name in EFFECT_NAMES and left < VISIBLE:
            return None
        causes[k] = replace(hidden, visible=left)
    return replace(draw, hidden=tuple(causes))


def _weak(machine: Machine, index: int, number: int, random: Generator) -> Draw | None:
    style = WEAK_STYLES[number % len(WEAK_STYLES)]
    draw = replace(_frame(machine, "weak", index, random, style), law="sgms")
    if style == "still":
        return draw
    names = {
        "presliding": ("quadratic_drag", "eddy_current_damping", "asymmetric_viscous"),
        "one_way": ("constant_offset", "asymmetric_coulomb"),
    }[style]
    name = str(random.choice(names))
    damping = machine.friction.coulomb / machine.sampling.max_velocity
    sizes = {
        "quadratic_drag": {"coefficient_N_s2_m2": damping / machine.sampling.max_velocity},
        "eddy_current_damping": {
            "damping_N_s_m": damping,
            "corner_velocity_m_s": 0.3 * machine.sampling.max_velocity,
        },
        "asymmetric_viscous": {"difference_N_s_m": 0.5 * damping},
        "constant_offset": {"force_N": 0.2 * machine.friction.coulomb},
        "asymmetric_coulomb": {"ratio": 0.2},
    }
    return replace(draw, hidden=(Hidden(name, sizes[name]),))


# --- parameters and sizes ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Scene:
    """What parameters are drawn from."""

    machine: Machine
    travel: float
    speed: float
    seconds: float
    random: Generator

    def sign(self) -> float:
        return float(self.random.choice([-1.0, 1.0]))

    def phase(self) -> float:
        return float(self.random.uniform(-math.pi, math.pi))

    def pitch(self) -> float:
        return self.travel / _log_uniform(self.random, 2.2, 30.0)

    def time(self) -> float:
        return self.seconds * _log_uniform(self.random, 0.1, 0.6)


Shape = Callable[[_Scene, float], Values]
"""(scene, size x) -> parameters; x counts in the unit that `_SHAPES` states and is found by trial."""


def _periodic(amplitude: str, *, unit: Callable[[Machine], float]) -> Callable[[_Scene], tuple[Shape, float]]:
    def start(scene: _Scene) -> tuple[Shape, float]:
        pitch, phase = scene.pitch(), scene.phase()
        return (
            lambda s, x: {amplitude: x * unit(s.machine), "pitch_m": pitch, "phase_rad": phase},
            1.0,
        )

    return start


def _one(parameter: str, unit: Callable[[_Scene], float], *, signed: bool = True, offset: float = 0.0) -> Any:
    def start(scene: _Scene) -> tuple[Shape, float]:
        sign = scene.sign() if signed else 1.0
        return lambda s, x: {parameter: offset + sign * x * unit(s)}, 1.0

    return start


def _settling(scene: _Scene) -> tuple[Shape, float]:
    tau, sign = scene.time(), scene.sign()
    return lambda _, x: {"ratio": sign * min(x, 0.9 if sign < 0 else 5.0), "time_constant_s": tau}, 1.0


def _spring(scene: _Scene) -> tuple[Shape, float]:
    sign = scene.sign()
    return lambda s, x: {"stiffness_N_m": sign * x * s.machine.friction.coulomb / s.travel, "centre_m": 0.0}, 1.0


def _hose(scene: _Scene) -> tuple[Shape, float]:
    length = scene.travel * _log_uniform(scene.random, 0.03, 0.2)
    return (
        lambda s, x: {
            "stiffness_N_m": x * s.machine.friction.coulomb / length,
            "force_N": x * s.machine.friction.coulomb,
        },
        1.0,
    )


def _eddy(scene: _Scene) -> tuple[Shape, float]:
    corner = scene.speed * _log_uniform(scene.random, 0.08, 0.35)
    return (
        lambda s, x: {"damping_N_s_m": 2.0 * x * s.machine.friction.coulomb / corner, "corner_velocity_m_s": corner},
        1.0,
    )


def _resonance(scene: _Scene) -> tuple[Shape, float]:
    top = min(150.0, 0.25 * scene.machine.sampling.velocity_cutoff)
    frequency, damping = _log_uniform(scene.random, 12.0, max(20.0, top)), _log_uniform(scene.random, 0.01, 0.06)
    return (
        lambda s, x: {
            "frequency_Hz": frequency,
            "damping_ratio": damping,
            "mass_kg": min(x, 4.0) * 0.1 * s.machine.plant.mass,
        },
        1.0,
    )


def _pulse(scene: _Scene) -> tuple[Shape, float]:
    frequency, phase = _log_uniform(scene.random, 0.5, 80.0), scene.phase()
    return (
        lambda s, x: {"amplitude_N": x * s.machine.friction.coulomb, "frequency_Hz": frequency, "phase_rad": phase},
        1.0,
    )


def _step(scene: _Scene) -> tuple[Shape, float]:
    at, sign = scene.seconds * float(scene.random.uniform(0.25, 0.75)), scene.sign()
    return lambda s, x: {"force_N": sign * x * s.machine.friction.coulomb, "time_s": at}, 1.0


def _ageing(scene: _Scene) -> tuple[Shape, float]:
    tau, length = (
        _log_uniform(scene.random, 0.05, 0.3),
        _log_uniform(scene.random, 0.3, 2.0) * deflection(scene.machine),
    )
    return lambda _, x: {"ratio": min(x, 3.0), "time_constant_s": tau, "length_m": length}, 1.0


def _coulomb(scene: _Scene) -> float:
    return scene.machine.friction.coulomb


_SHAPES: Final[Mapping[str, Callable[[_Scene], tuple[Shape, float]]]] = {
    "force_ripple": _periodic("amplitude_N", unit=lambda m: m.friction.coulomb),
    "force_constant_ripple": _periodic("ratio", unit=lambda _: 0.1),
    "constant_offset": _one("force_N", _coulomb),
    "position_spring": _spring,
    "hose_hysteresis": _hose,
    "asymmetric_coulomb": _one("ratio", lambda _: 1.0),
    "asymmetric_viscous": _one("difference_N_s_m", lambda s: _coulomb(s) / s.speed),
    "position_dependent_friction": _periodic("ratio", unit=lambda _: 1.0),
    "friction_drift": _settling,
    "viscous_drift": _settling,
    "mass_mismatch": _one("mass_kg", lambda s: 0.1 * s.machine.plant.mass),
    "force_gain": _one("gain", lambda _: 0.1, offset=1.0),
    "force_delay": _one("delay_s", lambda s: s.machine.sampling.step, signed=False),
    "actuator_lag": _one("time_constant_s", lambda s: s.machine.sampling.step, signed=False),
    "quadratic_drag": _one("coefficient_N_s2_m2", lambda s: _coulomb(s) / s.speed**2),
    "eddy_current_damping": _eddy,
    "encoder_periodic_error": _periodic("amplitude_m", unit=lambda _: 1e-7),
    "structural_resonance": _resonance,
    "periodic_disturbance": _pulse,
    "step_disturbance": _step,
    "backlash": _one("gap_m", lambda s: 0.1 * deflection(s.machine), signed=False),
    "frictional_lag": _one("time_constant_s", lambda _: 0.01, signed=False),
    "dwell_dependence": _ageing,
    "micro_viscous": _one("damping_N_s_m", lambda s: _coulomb(s) / s.speed, signed=False),
}
_SATURATION: Final = 40.0  # how far x may go from its start


def _sized(
    machine: Machine, motion: Trajectory, plain: Signals, name: str, size: float, random: Generator
) -> tuple[Hidden, Array] | None:
    """A cause whose force has that size, and the force; None where it cannot be had."""
    if name in BASE_CAUSES:
        return _wrong_number(machine, motion, plain, name, size, random)
    scene = _Scene(
        machine,
        float(np.ptp(motion.position_m)),
        float(np.abs(motion.velocity_m_s).max()),
        motion.duration_s,
        random,
    )
    shape, x = _SHAPES[name](scene)
    goal = size * machine.friction.coulomb
    hidden, force, peak = Hidden(name), plain.friction, 0.0
    for _ in range(5):
        hidden = Hidden(name, _within_limits(name, shape(scene, x)))
        force = _prescribed(machine, motion, hidden).friction - plain.friction
        peak = _peak(force)
        if peak > 0.0 and abs(peak / goal - 1.0) < 0.1:
            break
        x = min(_SATURATION, x * min(10.0, max(0.1, goal / max(peak, 1e-12))))
    if not 0.5 < peak / goal < 2.0:
        return None
    return replace(hidden, size=peak / machine.friction.coulomb), force


def _within_limits(name: str, values: Values) -> Values:
    limits = {p.name: (p.lower, p.upper) for p in effect_definition(name).parameters}
    return {key: min(max(value, limits[key][0]), limits[key][1]) for key, value in values.items()}


def _wrong_number(
    machine: Machine, motion: Trajectory, plain: Signals, name: str, size: float, random: Generator
) -> tuple[Hidden, Array] | None:
    factors: Values = {}
    if name == "stiffness":
        factor = float(np.exp(random.choice([-1.0, 1.0]) * random.uniform(0.3, 0.8)))
        factors = {f"stiffness_{k + 1}": factor for k in range(len(machine.friction.stiffness))}
    elif name == "stribeck":
        if machine.friction.stribeck_ratio == 0.0:
            return None
        factors = {"stribeck_ratio": 1.0 + size / machine.friction.stribeck_ratio}
    elif name == "viscous":
        if machine.friction.viscous == 0.0:
            return None
        speed = float(np.abs(motion.velocity_m_s).max())
        change = size * machine.friction.coulomb / (machine.friction.viscous * speed)
        factors = {"viscous": 1.0 + max(-0.8, change * float(random.choice([-1.0, 1.0])))}
    else:
        factors = {"coulomb": 1.0 + size * float(random.choice([-1.0, 1.0]))}
    hidden = Hidden(name, factors=factors)
    force = _prescribed(machine, motion, hidden).friction - plain.friction
    return replace(hidden, size=_peak(force) / machine.friction.coulomb), force


def _prescribed(machine: Machine, motion: Trajectory, hidden: Hidden) -> Signals:
    """Signals of an axis that follows the motion exactly, without noise."""
    lag = hidden.name == "actuator_lag"  # no force makes a prescribed motion: its log is worked out here
    effects = [(hidden.name, hidden.parameters)] if hidden.parameters and not lag else []
    config = AxisConfig(control="prescribed", encoder_resolution_m=0.0, force_noise_N=0.0, substeps=2)
    log = simulate_axis(machine, motion, config, hidden_effects=effects, scale=hidden.factors, truth=False).log
    if lag:
        # The logged force leads: u = lagged + T d(lagged)/dt makes the motion.
        force = log.force_N
        log = replace(
            log, force_N=force + hidden.parameters["time_constant_s"] * np.gradient(force, 1.0 / machine.sampling.rate)
        )
    return signals_from_log(log, machine)


def _peak(force: Array) -> float:
    """What the force exceeds in a fiftieth of the log, the start left out."""
    return float(np.quantile(np.abs(force[len(force) // 50 :]), 0.98))


def _size(random: Generator, least: float = 0.02) -> float:
    """Over the Coulomb level: a quarter of the draws below `LEAST_SIZE`, unless all have to be larger."""
    if least < LEAST_SIZE and random.uniform() < 0.2:
        return _log_uniform(random, least, LEAST_SIZE)
    return _log_uniform(random, max(least, 1.15 * LEAST_SIZE), 0.5)


def _log_uniform(random: Generator, low: float, high: float) -> float:
    return float(math.exp(random.uniform(math.log(low), math.log(high))))


# --- what is left to be seen ------------------------------------------------------------------------------------


_models: Final[dict[str, CompiledModel]] = {}
"""Compiled once per process and machine."""


def _visible(machine: Machine, columns: Array, force: Array, others: Array | None = None) -> float:
    """Share of a force (RMS) that neither the base model's numbers (`columns`) nor other forces can take over."""
    factor = max(1, round(machine.sampling.rate / _RATE))
    start = settle_samples(machine) // factor + 2

    def reduced(series: Array) -> Array:
        m = len(series) // factor
        return np.asarray(series[: m * factor].reshape(m, factor, *series.shape[1:]).mean(axis=1))[start:]

    f, free = reduced(force), reduced(columns)
    if others is not None:
        free = np.hstack((free, reduced(others)))
    scale = np.linalg.norm(free, axis=0)
    q, r = np.linalg.qr(free[:, scale > 0.0] / scale[scale > 0.0])
    q = q[:, np.abs(np.diag(r)) > 1e-8]
    norm = float(np.linalg.norm(f))
    return float(np.linalg.norm(f - q @ (q.T @ f))) / norm if norm > 0.0 else 0.0


def _sensitivities(machine: Machine, plain: Signals) -> Array:
    """Derivatives of friction in the base model's numbers along a motion (n, k)."""
    slopes = _model(machine).predict(plain, derivatives=True).d_friction
    if slopes is None:
        raise RuntimeError("a prediction without derivatives")
    return slopes


def _model(machine: Machine) -> CompiledModel:
    if machine.digest not in _models:
        friction, sampling = machine.friction, machine.sampling
        names = ["stiffness", "coulomb"]
        names += [n for n in ("viscous", "stribeck_ratio") if getattr(friction, n) != 0.0]
        substeps = max(sampling.integrator.substeps, sampling.samples_per_update)
        changes = {
            "name": "base_numbers",
            "estimator": {"parameters": names},
            "sampling": {"integrator": {"substeps": substeps}},
            "code": {"precision": "double"},
        }
        plain = override_machine(machine, changes)
        _models[machine.digest] = CompiledModel(plain, cached_package(plain))
    return _models[machine.digest]


def _motion(machine: Machine, draw: Draw) -> Trajectory:
    return draw_motion(draw.style, machine, draw.seconds, np.random.default_rng(draw.motion_seed))


def _noise(machine: Machine, log: Log, truth: Any) -> float:
    """RMS of what noise alone makes of measured friction, over means of ten samples [N]."""
    true = replace(log, position_m=truth.position_m, force_N=truth.force_N)
    noise = signals_from_log(log, machine).friction - signals_from_log(true, machine).friction
    noise = noise[settle_samples(machine) + 1 :]
    factor = max(1, round(machine.sampling.rate / 1000.0))
    means = noise[: len(noise) // factor * factor].reshape(-1, factor).mean(axis=1)
    return float(np.sqrt(np.mean(means**2)))
