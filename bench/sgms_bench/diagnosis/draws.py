"""Draws of hidden effects: from (seed, index) alone, and fair.

Fair means that the log meets the excitation that the cause's own description asks for, and that after a refit of the
base model's numbers at least `VISIBLE` of its force is left to be seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sgms_bench.diagnosis.axes import DrawnAxis, PlantLaw, draw_axis, machine_file
from sgms_bench.diagnosis.causes import Hidden, Values, draw_size, peak_force, prescribed_signals, sized_cause
from sgms_bench.diagnosis.faults import FAULTS
from sgms_bench.diagnosis.motions import STYLES, WEAK_STYLES, draw_motion
from sgms_bench.diagnosis.specimens import SPECIMENS, log_uniform
from sgms_bench.diagnosis.unmodelled import CURVES, SMOOTH_CURVES, UNMODELLED, curves_over_speed
from sgms_bench.diagnosis.visibility import sensitivities, visible_share
from sgms_mhe.configuration import override_machine
from sgms_mhe.diagnosis.parametrisation import TIMING_MOST
from sgms_mhe.machine import Machine
from sgms_mhe.model.effects import BASE_CAUSES, EFFECT_NAMES, cause, effect_definition, own_effects
from sgms_mhe.model.scales import scales_of
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.recordings.excitation import measure_excitation
from sgms_mhe.recordings.series import row_means
from sgms_mhe.signals.chain import settle_samples, signals_from_log
from sgms_mhe.signals.logs import Log

Array = NDArray[np.float64]

KINDS: Final = (
    "single", "clean", "single", "base", "single", "clean", "double", "single", "unmodelled", "clean",
    "single", "double", "single", "fault", "base", "single", "unmodelled", "triple", "clean", "weak",
)  # fmt: skip
"""What the draws are, in turn: any number of draws from the first on is balanced."""
HIDEABLE: Final = tuple(name for name in EFFECT_NAMES if name in SPECIMENS)
VISIBLE: Final = 0.3
SECONDS: Final = (10.0, 16.0)
ATTEMPTS: Final = 25
OFF_SIZE: Final = 0.25
"""What a size that was asked for may be missed by, of itself."""
ANY_CURVE: Final = tuple(name for name in EFFECT_NAMES if effect_definition(name).any_curve)
"""The effect that names curves over speed of laws that are none of the catalogue."""
_RARE: Final = 4.0  # largest force of an unmodelled cause, over its size
_CURVE_SIZE: Final = (1.0, 4.0)  # of an unmodelled curve over speed
_CURVE_LEFT: Final = 0.01  # least RMS that no sum of the catalogue's curves takes over, over f_C
_CURVE_NOISE: Final = 0.5  # the same over the force's noise
_TOGETHER: Final = {"double": 2, "triple": 3}
_BEYOND_SAMPLING: Final = 1.2
_CLOCK_SIZE: Final = 0.1  # least size of what is hidden where position is a clock


@dataclass(frozen=True)
class Draw:
    """One log of the benchmark.

    Attributes:
        index: of the draw.
        kind: single, base (a wrong number), double, triple, clean, unmodelled (outside the catalogue), weak (the log
            cannot tell), fault (a sign, a unit or a column of the log is wrong).
        axis: that it is of.
        hidden: the causes; of an unmodelled force or a fault its name.
        machine_changes: of the machine that is diagnosed, over the axis's file.
        style, seconds, motion_seed: of the motion.
        force_noise_N, encoder_noise_m, encoder_resolution_m, noise_seed: of the simulated axis.
    """

    index: int
    kind: str
    axis: DrawnAxis
    hidden: tuple[Hidden, ...]
    machine_changes: Mapping[str, Any]
    style: str
    seconds: float
    motion_seed: int
    force_noise_N: float
    encoder_noise_m: float
    encoder_resolution_m: float
    noise_seed: int

    @property
    def truth(self) -> tuple[str, ...]:
        """Names that a diagnosis should find."""
        if self.kind == "unmodelled":
            return ANY_CURVE if self.hidden[0].name in CURVES else ()
        return () if self.kind in ("clean", "fault") else tuple(h.name for h in self.hidden)

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
        hidden = tuple(Hidden(**h) for h in content["hidden"])
        return cls(**{**content, "axis": DrawnAxis(**content["axis"]), "hidden": hidden})


def make_draw(machine: Machine, seed: int, index: int) -> Draw:
    """Draw number `index` of a series."""
    random = np.random.default_rng([seed, index])
    kind = KINDS[index % len(KINDS)]
    cycle, place = divmod(index, len(KINDS))
    number = cycle * KINDS.count(kind) + KINDS[:place].count(kind)  # of its kind
    frame = _Frame(machine, seed, index, random)
    for _ in range(ATTEMPTS):
        draw = _attempt(frame, kind, number)
        if draw is not None:
            return draw
    # Nothing fair was found: the log of a clean axis takes the place.
    return frame.draw("clean", _style(random))


def sized_draw(machine: Machine, seed: int, index: int, name: str, size: float, obeys: PlantLaw) -> Draw | None:
    """A fair log of one cause of that size on an axis of that law; None where none is found."""
    random = np.random.default_rng([seed, index])
    kind = "base" if name in BASE_CAUSES else "single"
    frame = _Frame(machine, seed, index, random)
    for _ in range(ATTEMPTS):
        draw = frame.draw(kind, _style(random), obeys)
        if name in BASE_CAUSES or name in frame.effects(draw):
            found = _hide_causes(frame, draw, (name,), size)
            if found is not None and abs(found.size / size - 1.0) < OFF_SIZE:
                return found
    return None


def machine_of(machine: Machine, draw: Draw) -> Machine:
    """The machine that the draw's log is diagnosed with; `machine`: of the benchmark."""
    file = machine_file(machine, draw.axis)
    return override_machine(file, draw.machine_changes) if draw.machine_changes else file


def simulate_draw(machine: Machine, draw: Draw) -> tuple[Log, float]:
    """The log, and the RMS of its friction's noise over means of ten samples [N] (NaN where the log is distorted)."""
    axis = machine_of(machine, draw)
    config = AxisConfig(
        law=draw.axis.obeys,
        force_noise_N=draw.force_noise_N,
        encoder_noise_m=draw.encoder_noise_m,
        encoder_resolution_m=draw.encoder_resolution_m,
        seed=draw.noise_seed,
    )
    effects = [(h.name, h.parameters) for h in draw.hidden if h.parameters]
    scale: Values = {}
    for hidden in draw.hidden:
        scale |= dict(hidden.factors)
    run = simulate_axis(axis, _motion(axis, draw), config, hidden_effects=effects, scale=scale)
    log = replace(run.log, source=f"draw_{draw.index}.csv")
    if draw.kind == "fault":
        return FAULTS[draw.hidden[0].name](log), math.nan
    if draw.kind == "unmodelled":
        # The controller holds the reference against it: the force it takes shows in the log, the motion does not.
        log = replace(log, force_N=log.force_N + unmodelled_force(axis, draw, draw.hidden[0]))
    return log, _noise(axis, run.log, run.truth) if not effects else math.nan


def unmodelled_force(machine: Machine, draw: Draw, hidden: Hidden) -> Array:
    """The unmodelled force along the draw's reference (n) [N]."""
    motion = _motion(machine, draw)
    force = UNMODELLED[hidden.name](
        np.random.default_rng([draw.noise_seed, 7]), motion.time_s, motion.position_m, motion.velocity_m_s
    )
    return np.asarray(force * (hidden.size * machine.friction.coulomb / peak_force(force)))


# --- drawing ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Frame:
    """Inputs of draws: the machine of the benchmark, their place in the series, and chance."""

    machine: Machine
    seed: int
    index: int
    random: Generator

    def draw(self, kind: str, style: str, obeys: PlantLaw | None = None) -> Draw:
        """One without causes: axis, motion and noise; `obeys`: None for either law."""
        random, axis = self.random, draw_axis(self.random, self.machine)
        machine = machine_file(self.machine, axis)
        coulomb, mass = machine.friction.coulomb, machine.plant.moved
        # What the encoder's noise makes of the inertial force behind the filters, roughly.
        gain = 0.3 * mass * (2.0 * math.pi * machine.sampling.velocity_cutoff) ** 2
        return Draw(
            index=self.index,
            kind=kind,
            axis=axis if obeys is None else replace(axis, obeys=obeys),
            hidden=(),
            machine_changes={},
            style=style,
            seconds=float(random.uniform(*SECONDS)),
            motion_seed=int(random.integers(2**31)),
            force_noise_N=coulomb * log_uniform(random, 0.004, 0.06),
            encoder_noise_m=coulomb * log_uniform(random, 0.001, 0.08) / gain,
            encoder_resolution_m=coulomb * log_uniform(random, 0.001, 0.03) / gain,
            noise_seed=int(random.integers(2**31)),
        )

    def effects(self, draw: Draw) -> tuple[str, ...]:
        """Effects that may be hidden in it: that such an axis has, and that stand with its file's law."""
        machine = machine_of(self.machine, draw)
        names = [name for name in own_effects(machine.plant.kind) if name in HIDEABLE]
        return tuple(n for n in names if not (machine.friction.switches and effect_definition(n).smooth_only))


def _attempt(frame: _Frame, kind: str, number: int) -> Draw | None:
    random = frame.random
    if kind == "weak":
        return _weak(frame, number)
    draw = frame.draw(kind, _style(random))
    if kind == "clean":
        return draw
    if kind == "fault":
        return replace(draw, hidden=(Hidden(list(FAULTS)[number % len(FAULTS)]),))
    if kind == "unmodelled":
        return _draw_unmodelled(frame, draw, number)
    if kind == "base":
        return _hide_causes(frame, draw, (_take_turns(tuple(BASE_CAUSES), number, frame.seed),))
    names = frame.effects(draw)
    if kind == "single":
        # In turn over the whole catalogue: what this axis cannot have is left for another one.
        name = _take_turns(HIDEABLE, number, frame.seed)
        return _hide_causes(frame, draw, (name,)) if name in names else None
    together = random.choice(names, _TOGETHER[kind], replace=False).tolist()
    if any(b in cause(a).confused_with for a in together for b in together if a != b):
        return None
    return _hide_causes(frame, draw, tuple(together))


def _draw_unmodelled(frame: _Frame, draw: Draw, number: int) -> Draw | None:
    axis = machine_of(frame.machine, draw)
    name = list(UNMODELLED)[number % len(UNMODELLED)]
    smooth = name in SMOOTH_CURVES
    size = log_uniform(frame.random, *_CURVE_SIZE) if smooth else draw_size(frame.random, 0.1)
    hidden = Hidden(name, size=size)
    draw = replace(draw, hidden=(hidden,))
    plain = prescribed_signals(axis, _motion(axis, draw), Hidden(""))
    force = unmodelled_force(axis, draw, hidden)
    if np.abs(force).max() > _RARE * hidden.size * axis.friction.coulomb:
        return None  # hardly ever there: its size says nothing
    columns = sensitivities(axis, plain)
    left = visible_share(axis, columns, force, curves_over_speed(plain.velocity) if smooth else None)
    rms = left * float(np.sqrt(np.mean(force**2)))
    fair = rms >= max(_CURVE_LEFT * axis.friction.coulomb, _CURVE_NOISE * draw.force_noise_N) if smooth else left >= 0.6
    return replace(draw, hidden=(replace(hidden, visible=left),)) if fair else None


def _take_turns(names: tuple[str, ...], number: int, seed: int) -> str:
    """Every name once before any comes again, in an order that changes with every round."""
    cycle, place = divmod(number, len(names))
    return str(np.random.default_rng([seed, 10**6 + cycle]).permutation(names)[place])


def _style(random: Generator) -> str:
    return str(random.choice(STYLES, p=[0.55, 0.15, 0.15, 0.15]))


def _hide_causes(frame: _Frame, draw: Draw, names: tuple[str, ...], size: float | None = None) -> Draw | None:
    """The draw with these causes hidden, each of that size (None: drawn), where that is fair."""
    axis = machine_of(frame.machine, draw)
    changes = something_to_act_on(axis, names)
    if changes:
        draw = replace(draw, machine_changes=changes)
        axis = machine_of(frame.machine, draw)
    motion = _motion(axis, draw)
    plain = prescribed_signals(axis, motion, Hidden(""))
    found, columns = measure_excitation(plain, axis), sensitivities(axis, plain)
    causes, forces = [], []
    for name in names:
        wanted = draw_size(frame.random) if size is None else size
        sized = sized_cause(axis, motion, plain, name, wanted, frame.random)
        if sized is None or cause(name).excitation.unmet(found, sized[0].parameters) or _is_sampling(axis, sized[0]):
            return None
        causes.append(sized[0])
        forces.append(sized[1])
    for k, hidden in enumerate(causes):
        others = np.stack([f for j, f in enumerate(forces) if j != k], axis=1) if len(forces) > 1 else None
        left = visible_share(axis, columns, forces[k], others)
        # A wrong number is itself what the projection takes out.
        if hidden.name in EFFECT_NAMES and left < VISIBLE:
            return None
        causes[k] = replace(hidden, visible=left)
    return replace(draw, hidden=tuple(causes))


def _is_sampling(machine: Machine, hidden: Hidden) -> bool:
    """Return True if sampling alone puts force and position as far apart as this cause does, or nearly."""
    least = _BEYOND_SAMPLING * TIMING_MOST * machine.sampling.step
    return any(
        abs(value) < least and effect_definition(hidden.name).parameter(key).timing
        for key, value in hidden.parameters.items()
    )


def _weak(frame: _Frame, number: int) -> Draw | None:
    style = WEAK_STYLES[number % len(WEAK_STYLES)]
    draw = frame.draw("weak", style, obeys="sgms")
    if style == "still":
        return draw
    axis = machine_of(frame.machine, draw)
    if style == "crawl":
        return _clock(frame, draw, axis)
    concealed = {
        name: found
        for name in sorted(frame.effects(draw), reverse=True)
        if (specimen := SPECIMENS.get(name)) and (found := specimen.concealed) and found.motion == style
    }
    name = str(frame.random.choice(list(concealed)))
    return replace(draw, hidden=(Hidden(name, dict(concealed[name].values(scales_of(axis)))),))


def _clock(frame: _Frame, draw: Draw, axis: Machine) -> Draw | None:
    """A sine in position or in time, where one is proportional to the other."""
    sines = [name for name in frame.effects(draw) if effect_definition(name).sine is not None]
    motion = _motion(axis, draw)
    plain = prescribed_signals(axis, motion, Hidden(""))
    name, size = str(frame.random.choice(sines)), draw_size(frame.random, _CLOCK_SIZE)
    sized = sized_cause(axis, motion, plain, name, size, frame.random)
    return None if sized is None else replace(draw, hidden=(sized[0],))


def something_to_act_on(machine: Machine, names: Sequence[str]) -> dict[str, Any]:
    """Changes of a machine whose numbers are too small for these causes to have something to act on; {}: none is."""
    specimens = [SPECIMENS.get(name) for name in names]
    least = {key: value for s in specimens if s is not None for key, value in (s.least or {}).items()}
    friction = {key: max(value, getattr(machine.friction, key)) for key, value in least.items()}
    return {"name": "specimen", "friction": friction} if friction else {}


def _motion(machine: Machine, draw: Draw) -> Trajectory:
    return draw_motion(draw.style, machine, draw.seconds, np.random.default_rng(draw.motion_seed))


def _noise(machine: Machine, log: Log, truth: Any) -> float:
    """RMS of what noise alone makes of measured friction, over means of ten samples [N]."""
    true = replace(log, position_m=truth.position_m, force_N=truth.force_N)
    noise = signals_from_log(log, machine).friction - signals_from_log(true, machine).friction
    noise = noise[settle_samples(machine) + 1 :]
    factor = max(1, round(machine.sampling.rate / 1000.0))
    means = row_means(noise, factor)
    return float(np.sqrt(np.mean(means**2)))
