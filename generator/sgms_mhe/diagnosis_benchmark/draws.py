"""What is hidden in a log: drawn from (seed, index) alone, sized by the force that it adds, and fair.

The size of a cause is the force it adds to the measured friction along the motion, exceeded in a fiftieth of the log,
over the Coulomb level: for a ripple its amplitude, for what acts after reversals only what it reaches there. Fair means
that the log meets the excitation that the cause's own description asks for, and that after a refit of the base model's
numbers at least `VISIBLE` of its force is left to be seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis.excitation import measures
from sgms_mhe.diagnosis.fitting import cached_package
from sgms_mhe.diagnosis_benchmark.foreign import FOREIGN
from sgms_mhe.diagnosis_benchmark.motions import STYLES, WEAK_STYLES, draw_motion
from sgms_mhe.host.compiled import CompiledModel
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import BASE_CAUSES, EFFECT_NAMES, cause, effect_definition
from sgms_mhe.model.effects.specimen import Scene, log_uniform
from sgms_mhe.model.scales import scales_of
from sgms_mhe.plant.simulation import AxisConfig, simulate_axis
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.signals.chain import Signals, settle_samples, signals_from_log
from sgms_mhe.signals.logs import Log

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
        force_noise_N=coulomb * log_uniform(random, 0.004, 0.06),
        encoder_noise_m=coulomb * log_uniform(random, 0.001, 0.02) / gain,
        encoder_resolution_m=coulomb * log_uniform(random, 0.001, 0.03) / gain,
        noise_seed=int(random.integers(2**31)),
    )


def _style(random: Generator) -> str:
    return str(random.choice(STYLES, p=[0.55, 0.15, 0.15, 0.15]))


def _with_causes(machine: Machine, draw: Draw, names: tuple[str, ...], random: Generator) -> Draw | None:
    least = {key: value for name in names for key, value in _least(name).items()}
    if least:
        friction = {key: max(value, getattr(machine.friction, key)) for key, value in least.items()}
        draw = replace(draw, machine_changes={"name": "specimen", "friction": friction})
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
    concealed = {
        name: found
        for name in sorted(EFFECT_NAMES, reverse=True)
        if (specimen := effect_definition(name).specimen) and (found := specimen.concealed) and found.motion == style
    }
    name = str(random.choice(list(concealed)))
    return replace(draw, hidden=(Hidden(name, dict(concealed[name].values(scales_of(machine)))),))


def _least(name: str) -> Mapping[str, float]:
    """What the machine's numbers must at least be for a cause to have something to act on."""
    specimen = effect_definition(name).specimen if name in EFFECT_NAMES else None
    return specimen.least or {} if specimen is not None else {}


# --- parameters and sizes ---------------------------------------------------------------------------------------

_SATURATION: Final = 40.0  # how far x may go from its start


def _sized(
    machine: Machine, motion: Trajectory, plain: Signals, name: str, size: float, random: Generator
) -> tuple[Hidden, Array] | None:
    """A cause whose force has that size, and the force; None where it cannot be had."""
    friction = machine.friction
    numbers = (number.name for base in BASE_CAUSES.values() for number in base.numbers if not number.array)
    scene = Scene(
        scales=scales_of(machine),
        numbers={number: getattr(friction, number) for number in numbers},
        cutoff=machine.sampling.velocity_cutoff,
        travel=float(np.ptp(motion.position_m)),
        speed=float(np.abs(motion.velocity_m_s).max()),
        seconds=motion.duration_s,
        random=random,
    )
    if name in BASE_CAUSES:
        return _wrong_number(machine, motion, plain, name, scene, size)
    specimen = effect_definition(name).specimen
    if specimen is None:
        return None
    parameters, x = specimen.draw(scene), 1.0
    goal = size * friction.coulomb
    hidden, force, peak = Hidden(name), plain.friction, 0.0
    for _ in range(5):
        hidden = Hidden(name, _within_limits(name, parameters(x)))
        force = _prescribed(machine, motion, hidden).friction - plain.friction
        peak = _peak(force)
        if peak > 0.0 and abs(peak / goal - 1.0) < 0.1:
            break
        x = min(_SATURATION, x * min(10.0, max(0.1, goal / max(peak, 1e-12))))
    if not 0.5 < peak / goal < 2.0:
        return None
    return replace(hidden, size=peak / machine.friction.coulomb), force


def _within_limits(name: str, values: Mapping[str, float]) -> Values:
    limits = {p.name: (p.lower, p.upper) for p in effect_definition(name).parameters}
    return {key: min(max(value, limits[key][0]), limits[key][1]) for key, value in values.items()}


def _wrong_number(
    machine: Machine, motion: Trajectory, plain: Signals, name: str, scene: Scene, size: float
) -> tuple[Hidden, Array] | None:
    """A wrong number that changes the force by that size, and the change; None where the machine has none."""
    drawn = BASE_CAUSES[name].factors(scene, size)
    if drawn is None:
        return None
    factors, elements = Values(), len(machine.friction.stiffness)
    for number in BASE_CAUSES[name].numbers:
        if number.name in drawn:
            factors |= dict.fromkeys(number.columns(elements), drawn[number.name])
    hidden = Hidden(name, factors=factors)
    force = _prescribed(machine, motion, hidden).friction - plain.friction
    return replace(hidden, size=_peak(force) / machine.friction.coulomb), force


def _prescribed(machine: Machine, motion: Trajectory, hidden: Hidden) -> Signals:
    """Signals of an axis that follows the motion exactly, without noise."""
    specimen = effect_definition(hidden.name).specimen if hidden.name in EFFECT_NAMES else None
    lead = specimen.leads if specimen is not None else None
    effects = [(hidden.name, hidden.parameters)] if hidden.parameters and lead is None else []
    config = AxisConfig(control="prescribed", encoder_resolution_m=0.0, force_noise_N=0.0, substeps=2)
    log = simulate_axis(machine, motion, config, hidden_effects=effects, scale=hidden.factors, truth=False).log
    if lead is not None:
        # The logged force leads: u = lagged + T d(lagged)/dt makes the motion.
        force = log.force_N
        log = replace(log, force_N=force + hidden.parameters[lead] * np.gradient(force, 1.0 / machine.sampling.rate))
    return signals_from_log(log, machine)


def _peak(force: Array) -> float:
    """What the force exceeds in a fiftieth of the log, the start left out."""
    return float(np.quantile(np.abs(force[len(force) // 50 :]), 0.98))


def _size(random: Generator, least: float = 0.02) -> float:
    """Over the Coulomb level: a quarter of the draws below `LEAST_SIZE`, unless all have to be larger."""
    if least < LEAST_SIZE and random.uniform() < 0.2:
        return log_uniform(random, least, LEAST_SIZE)
    return log_uniform(random, max(least, 1.15 * LEAST_SIZE), 0.5)


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
        # Those that the friction is linear in, or nearly; of a number that is 0 there is no multiple.
        linear = [number.name for base in BASE_CAUSES.values() for number in base.numbers[:1]]
        names = [name for name in linear if getattr(friction, name) != 0.0]
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
