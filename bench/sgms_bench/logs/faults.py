"""Faults of logs: what each does to a good one, and what must come: the log, or the reason why not."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from sgms_bench.logs.cases import NAMES, UNITS, Array, Rng, Truth, run_driven
from sgms_bench.logs.formats import Format, Style, name_channel
from sgms_bench.logs.layouts import Channel
from sgms_mhe.machine import QUANTITIES, Role
from sgms_mhe.signals.logs import Log

FEW_DIGITS: Final = 1e-6
"""Of the range: what a column may be off by where a recorder writes ten digits and a time in microseconds."""


@dataclass(frozen=True)
class Recorder:
    """A recorder with its habits.

    Attributes:
        truth: that it recorded.
        names: of the signals.
        units: of the signals, by name.
    """

    truth: Truth
    format: Format
    style: Style
    names: Mapping[Role, str]
    units: Mapping[Role, str]

    @property
    def kind_units(self) -> Mapping[Role, Mapping[str, float]]:
        """Units of this kind of axis."""
        return UNITS[self.truth.axis.kind]

    def own(self, role: Role) -> str:
        """The column's name in this package."""
        return next(q.column for q in QUANTITIES[self.truth.axis.kind] if q.role == role)

    def channel(self, role: Role, values: Array, unit: str | None = None) -> Channel:
        """A signal in SI units as it is recorded; `unit`: as which it is called, empty for none."""
        recorded = self.units[role]
        stated = recorded if unit is None else unit
        name = self.names[role]
        if role == "time" and self.format.clock == "stamps":
            return Channel(name, "", values)
        whole = values / self.kind_units[role][recorded]
        return Channel(name, stated, whole) if self.format.has_units else Channel(self._name(name, stated), "", whole)

    def channels(self, log: Log) -> dict[Role, Channel]:
        """Time, position and force."""
        return {
            "time": self.channel("time", log.time_s),
            "position": self.channel("position", log.position_m),
            "force": self.channel("force", log.force_N),
        }

    def beside(self, name: str, unit: str, values: Array) -> Channel:
        """Another signal."""
        return Channel(name, unit, values) if self.format.has_units else Channel(self._name(name, unit), "", values)

    def _name(self, name: str, unit: str) -> str:
        return name_channel(Channel(name, unit, np.empty(0)), self.style)


@dataclass(frozen=True)
class Case:
    """A file and what must come of it.

    Attributes:
        channels: in the order of the file.
        expected: the log that is in it.
        facts: true of it; a sentence that claims another fact is false.
        refusal: pattern of the reason for which it must be refused; empty where it must be read.
        remedy: options with which the refused one is read; None: with none.
        numbers: that sentences must have, by fact.
        on_machine: whether only the axis's machine file shows the fault.
        commands: that read it too.
        beside: files beside it.
        options: that it needs from the start.
        tolerance: of the columns, over their range.
    """

    channels: tuple[Channel, ...]
    expected: Log
    facts: frozenset[str] = frozenset()
    refusal: str = ""
    remedy: tuple[str, ...] | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)
    on_machine: bool = False
    commands: tuple[str, ...] = ()
    beside: Callable[[Path], object] | None = None
    options: tuple[str, ...] = ()
    tolerance: float = FEW_DIGITS


Fault = Callable[[Recorder, Rng], Case]
NO_CHANGES: Final[Mapping[Role, Channel]] = {}


def _case(recorder: Recorder, changes: Mapping[Role, Channel] = NO_CHANGES, recorded: Log | None = None) -> Case:
    """The recorded log with some channels changed."""
    log = recorder.truth.log if recorded is None else recorded
    channels = {role: changes.get(role, channel) for role, channel in recorder.channels(log).items()}
    return Case(tuple(channels.values()), log)


def _nothing(recorder: Recorder, rng: Rng) -> Case:
    command = ("predict", "estimate", "identify", "")[rng.integers(4)]
    return replace(_case(recorder), commands=(command,) if command else ())


def _more_columns(recorder: Recorder, rng: Rng) -> Case:
    """Set points, errors and a mode beside what was measured, in any order."""
    case, log = _case(recorder), recorder.truth.log
    position = recorder.channel("position", log.position_m)
    unit = recorder.units["position"]
    more = [
        recorder.beside("Position demand value", unit, position.values + 0.01 * np.ptp(position.values)),
        recorder.beside("Following error", unit, np.full(len(log), 0.01 * np.ptp(position.values))),
        recorder.beside("Winding temperature", "", 40.0 + rng.standard_normal(len(log))),
        recorder.beside("Torque limit" if log.kind == "rotary" else "Force limit", recorder.units["force"], log.time_s),
    ]
    order = rng.permutation(len(more) + 2)
    both = [*case.channels[1:], *more]
    return replace(case, channels=(case.channels[0], *(both[k] for k in order)))


def _no_unit(recorder: Recorder, rng: Rng) -> Case:
    role: Role = ("position", "force")[rng.integers(2)]
    values = recorder.truth.log.position_m if role == "position" else recorder.truth.log.force_N
    case = _case(recorder, {role: recorder.channel(role, values, "")})
    reason = rf"column {recorder.own(role)}: missing: .*without a unit"
    remedy = ("--unit", f"{role}={recorder.units[role]}")
    return replace(case, facts=frozenset({"no unit"}), refusal=reason, remedy=remedy)


def _ampere(recorder: Recorder, rng: Rng) -> Case:
    log, factor = recorder.truth.log, 10.0 ** rng.uniform(-1.0, 2.0)
    case = _case(recorder, {"force": recorder.beside(recorder.names["force"], "A", log.force_N / factor)})
    reason = r"unit = 'A': .* per A; .*scale = \.\.\."
    remedy = ("--force-scale", repr(factor))
    return replace(case, facts=frozenset({"ampere"}), refusal=reason, remedy=remedy)


def _no_time(recorder: Recorder, rng: Rng) -> Case:
    case = _case(recorder)
    remedy = ("--rate", repr(recorder.truth.log.rate))
    return replace(case, channels=case.channels[1:], refusal=r"--rate", remedy=remedy, facts=frozenset({"no time"}))


def _velocity_alone(recorder: Recorder, rng: Rng) -> Case:
    log = recorder.truth.log
    speed = recorder.channel("velocity", log.columns["velocity_m_s"])
    case = _case(recorder, {"position": speed})
    from_zero = replace(log, position_m=log.position_m - log.position_m[0])
    return replace(case, expected=from_zero, facts=frozenset({"no position"}), tolerance=2e-3)


def _friction_alone(recorder: Recorder, rng: Rng) -> Case:
    log, own = recorder.truth.log, recorder.own("friction")
    noisy = log.columns["friction_N"] + 0.01 * recorder.truth.axis.coulomb * rng.standard_normal(len(log))
    force = Channel(own, recorder.units["force"] if recorder.format.has_units else "", noisy)
    if recorder.format.has_units:  # a column of the log's own name has the unit in it
        force = Channel(own, "", noisy)
    return replace(
        _case(recorder, {"force": force}),
        expected=replace(log, force_N=noisy, friction_N=noisy),
        facts=frozenset({"no force"}),
        commands=("identify",),
    )


def _row_twice(recorder: Recorder, rng: Rng) -> Case:
    case, log = _case(recorder), recorder.truth.log
    at = int(rng.integers(50, len(log) - 50))
    twice = tuple(replace(c, values=np.insert(c.values, at, c.values[at - 1])) for c in case.channels)
    return replace(case, channels=twice, facts=frozenset({"repeated"}))


def _late_stamps(recorder: Recorder, rng: Rng) -> Case:
    log = recorder.truth.log
    late = log.time_s + rng.uniform(0.05, 0.12) / log.rate * np.clip(rng.standard_normal(len(log)), -3.0, 3.0)
    case = _case(recorder, {"time": recorder.channel("time", np.round(1e6 * late) / 1e6)})
    facts = frozenset({"uneven"})
    return replace(case, facts=facts, refusal="uniform time within 1 %", remedy=("--log", RESAMPLE), tolerance=0.05)


def _missing_rows(recorder: Recorder, rng: Rng) -> Case:
    case, log = _case(recorder), recorder.truth.log
    first = int(rng.integers(100, len(log) - 200))
    lost = np.arange(first, first + int(rng.integers(5, 60)))
    shorter = tuple(replace(c, values=np.delete(c.values, lost)) for c in case.channels)
    position, force = log.position_m.copy(), log.force_N.copy()
    position[lost] = force[lost] = np.nan
    facts = frozenset({"uneven"})
    return replace(
        case,
        channels=shorter,
        expected=replace(log, position_m=position, force_N=force),
        facts=facts,
        refusal="uniform time within 1 %",
        remedy=("--log", RESAMPLE),
        tolerance=1e-3,
    )


def _missing_values(recorder: Recorder, rng: Rng) -> Case:
    log = recorder.truth.log
    position, force = log.position_m.copy(), log.force_N.copy()
    for values in (position, force):
        first = int(rng.integers(100, len(log) - 200))
        values[first : first + int(rng.integers(1, 60))] = np.nan
    return replace(
        _case(recorder, recorded=replace(log, position_m=position, force_N=force)),
        commands=("predict",) if rng.random() < 0.3 else (),
    )


def _wrap_position(recorder: Recorder, rng: Rng) -> Case:
    log, unit = recorder.truth.log, recorder.units["position"]
    factor = recorder.kind_units["position"][unit]
    extent = float(np.ptp(log.position_m)) / factor
    period = float(f"{extent / rng.uniform(1.6, 4.0):.3g}")
    if unit == "deg" and extent > 500.0:
        period = 360.0
    position = np.mod(log.position_m / factor + 0.3 * period, period) * factor
    case = _case(recorder, {"position": recorder.channel("position", position)})
    return replace(
        case,
        facts=frozenset({"wraps"}),
        refusal=r"jumps by .*wrap = ",
        remedy=("--wrap", repr(period)),
        numbers={"wraps": period},
        expected=replace(log, position_m=log.position_m - log.position_m[0] + position[0]),
    )


def _unsigned(recorder: Recorder, rng: Rng) -> Case:
    """A register with a sign that is recorded as if it had none."""
    log, bits = recorder.truth.log, int(rng.choice((8, 16, 32)))
    factor = recorder.kind_units["force"][recorder.units["force"]]
    size = rng.uniform(0.03, 0.12) * 2.0 ** min(bits, 16)
    counts = np.round(size * log.force_N / np.abs(log.force_N).max())
    case = _case(recorder, {"force": recorder.channel("force", np.mod(counts, 2.0**bits) * factor)})

    def write(folder: Path) -> object:
        return (folder / SIGNED).write_text(f"[log]\n{recorder.own('force')} = {{ signed = {bits} }}\n")

    return replace(
        case,
        beside=write,
        facts=frozenset({"unsigned"}),
        refusal=rf"jumps by .*signed = {bits} ",
        remedy=("--log", SIGNED),
        expected=replace(log, force_N=counts * factor),
    )


def _turn_force(recorder: Recorder, rng: Rng) -> Case:
    log = recorder.truth.log
    case = _case(recorder, {"force": recorder.channel("force", -log.force_N)})
    return replace(
        case,
        facts=frozenset({"turned"}),
        refusal=r"scale = -1\.0",
        remedy=_scale(recorder, -1.0),
        commands=("!identify",),
    )


def _scale(recorder: Recorder, scale: float) -> tuple[str, ...]:
    """Options that scale the force, whose unit is to be said again beside a scale."""
    unit = recorder.units["force"]
    return ("--force-scale", repr(scale), "--unit", f"force={unit}")


def _other_scale(recorder: Recorder, rng: Rng) -> Case:
    """The force constant is not what the file says: 30 to 60 times off, either way."""
    log = recorder.truth.log
    factor = float(rng.uniform(30.0, 60.0) ** rng.choice((-1.0, 1.0)))
    case = _case(recorder, {"force": recorder.channel("force", log.force_N / factor)})
    return replace(
        case,
        facts=frozenset({"scaled"}),
        refusal=r"scale = [\d.]+",
        numbers={"scaled": factor},
        remedy=_scale(recorder, factor),
        on_machine=True,
    )


def _swap(recorder: Recorder, rng: Rng) -> Case:
    log = recorder.truth.log
    position = recorder.channel("position", log.force_N)
    force = recorder.channel("force", log.position_m)
    case = _case(recorder, {"position": position, "force": force})
    return replace(case, facts=frozenset({"swapped"}), refusal=r"position|force|torque", on_machine=True)


def _constant(recorder: Recorder, rng: Rng) -> Case:
    role: Role = ("position", "force")[rng.integers(2)]
    case = _case(recorder, {role: recorder.channel(role, np.full(len(recorder.truth.log), 0.5))})
    return replace(case, facts=frozenset({"constant"}), refusal=rf"{recorder.own(role)}, every row = .*that changes")


def _coarse_stamps(recorder: Recorder, rng: Rng) -> Case:
    log = recorder.truth.log
    coarse = np.floor(log.time_s * log.rate / 8.0 + 1e-9) * 8.0 / log.rate
    case = _case(recorder, {"time": recorder.channel("time", coarse)})
    return replace(case, facts=frozenset({"coarse stamps"}), refusal="coarser than the samples")


def _backwards(recorder: Recorder, rng: Rng) -> Case:
    log = recorder.truth.log
    at = int(rng.integers(100, len(log) - 100))
    time = log.time_s.copy()
    time[at:] -= 40.0 / log.rate
    case = _case(recorder, {"time": recorder.channel("time", time)})
    return replace(case, facts=frozenset({"backwards"}), refusal="time decreases")


def _two_positions(recorder: Recorder, rng: Rng) -> Case:
    log = recorder.truth.log
    second = recorder.beside("Encoder position", recorder.units["position"], log.position_m[::-1].copy())
    case = _case(recorder)
    return replace(
        case, channels=(*case.channels, second), facts=frozenset({"two columns"}), refusal="one column; .*says which"
    )


def _no_motion(recorder: Recorder, rng: Rng) -> Case:
    """The axis stands; the force goes up and down below break-away."""
    log = recorder.truth.log
    step = float(np.ptp(log.position_m)) / 1e5
    still = step * np.round(rng.normal(0.0, 0.6, len(log)))
    return replace(
        _case(recorder, recorded=replace(log, position_m=still)), facts=frozenset({"still"}), commands=("!identify",)
    )


def _frozen(recorder: Recorder, rng: Rng) -> Case:
    """The encoder sticks for a while, then jumps to where the axis is."""
    log = recorder.truth.log
    first = int(rng.uniform(0.3, 0.7) * len(log))
    position = log.position_m.copy()
    position[first : first + int(rng.uniform(0.1, 0.4) * log.rate)] = position[first]
    return replace(
        _case(recorder, recorded=replace(log, position_m=position)), facts=frozenset({"stuck"}), commands=("estimate",)
    )


def _unequal(recorder: Recorder, rng: Rng) -> Case:
    """Channels of one array each that end a few samples apart."""
    case, log = _case(recorder), recorder.truth.log
    cut = int(rng.integers(1, 6))
    force = case.channels[2]
    channels = (*case.channels[:2], replace(force, values=force.values[:-cut]))
    return replace(
        case, channels=channels, expected=log.part(0.0, log.time_s[-1 - cut] + 0.5 / log.rate), facts=frozenset({"cut"})
    )


def _clock_beside(recorder: Recorder, rng: Rng) -> Case:
    case, log = _case(recorder), recorder.truth.log

    def write(folder: Path) -> object:
        stamps = "".join(f"{1e3 * t:.12g}\n" for t in log.time_s)
        (folder / "log_clock.csv").write_text(f"stamp\n{stamps}")
        return (folder / CLOCK).write_text('[log]\ntime_s = { variable = "{stem}_clock.csv:stamp", unit = "ms" }\n')

    return replace(case, channels=case.channels[1:], beside=write, options=("--log", CLOCK))


def _milliseconds(recorder: Recorder, rng: Rng) -> Case:
    """Milliseconds that are called seconds."""
    log = recorder.truth.log
    case = _case(recorder, {"time": replace(recorder.channel("time", log.time_s, "s"), values=1e3 * log.time_s)})
    return replace(case, facts=frozenset({"time unit"}), refusal="Hz", on_machine=True, remedy=("--unit", "time=ms"))


def _position_unit(recorder: Recorder, rng: Rng) -> Case:
    """A position that is called metres or radians and is not."""
    kind = recorder.truth.axis.kind
    unit = "mm" if kind == "linear" else "mrad"
    other = replace(recorder, units={**recorder.units, "position": unit})
    si = "m" if kind == "linear" else "rad"
    case = _case(other, {"position": other.channel("position", recorder.truth.log.position_m, si)})
    return replace(
        case,
        facts=frozenset({f"unit {unit}"}),
        refusal=rf'unit = "{unit}"',
        on_machine=True,
        remedy=("--unit", f"position={unit}"),
    )


def relay_truth(rng: Rng) -> Truth:
    """A rotor whose torque has two values."""
    level, period = rng.uniform(3.0, 8.0), rng.uniform(0.4, 1.2)
    return run_driven(rng, lambda t, coulomb: level * coulomb * np.where(np.mod(t, period) < period / 2, 1.0, -1.0))


def _relay(recorder: Recorder, rng: Rng) -> Case:
    return replace(_case(recorder), commands=("identify", "predict"))


def one_way_truth(rng: Rng) -> Truth:
    """A rotor that turns one way at about one speed."""
    return run_driven(rng, lambda t, coulomb: coulomb * (1.5 + 0.002 * rng.standard_normal(len(t))))


def _one_way(recorder: Recorder, rng: Rng) -> Case:
    return replace(_case(recorder), facts=frozenset({"one way"}), commands=("?identify",))


RESAMPLE: Final = "resample.toml"
CLOCK: Final = "clock.toml"
SIGNED: Final = "signed.toml"

FAULTS: Final[Mapping[str, Fault]] = {
    "none": _nothing,
    "more columns": _more_columns,
    "no unit": _no_unit,
    "ampere": _ampere,
    "no time": _no_time,
    "velocity alone": _velocity_alone,
    "friction alone": _friction_alone,
    "row twice": _row_twice,
    "late stamps": _late_stamps,
    "missing rows": _missing_rows,
    "missing values": _missing_values,
    "wrap": _wrap_position,
    "force unsigned": _unsigned,
    "force turned": _turn_force,
    "force constant": _other_scale,
    "swapped": _swap,
    "constant": _constant,
    "coarse stamps": _coarse_stamps,
    "time goes back": _backwards,
    "two positions": _two_positions,
    "no motion": _no_motion,
    "frozen encoder": _frozen,
    "unequal lengths": _unequal,
    "clock beside": _clock_beside,
    "unit of time": _milliseconds,
    "unit of position": _position_unit,
    "relay": _relay,
    "one way": _one_way,
}

TRUTHS: Final[Mapping[str, Callable[[Rng], Truth]]] = {"relay": relay_truth, "one way": one_way_truth}
"""Faults of the motion itself."""

FREE: Final = (
    "no time",
    "coarse stamps",
    "time goes back",
    "late stamps",
    "row twice",
    "clock beside",
    "two positions",
)
"""Faults that formats with clocks of their own have no place for."""


def can_have(chosen: Format, fault: str) -> bool:
    """Return True if a file of this format can have the fault."""
    if fault == "unequal lengths":
        return chosen.suffix in (".npz", ".mat", ".h5") and chosen.is_free
    if fault == "missing rows":
        return chosen.is_free
    if fault in ("unit of time", "no time", "clock beside") and chosen.clock != "any":
        return False
    return chosen.is_free or fault not in FREE


def draw_recorder(rng: Rng, truth: Truth, chosen: Format) -> Recorder:
    """Habits at random."""
    kind = truth.axis.kind
    names: dict[Role, str] = {role: str(rng.choice(NAMES[kind][role])) for role in NAMES[kind]}
    units: dict[Role, str] = {role: str(rng.choice(list(UNITS[kind][role]))) for role in UNITS[kind]}
    if chosen.clock != "any":
        units["time"] = "s" if chosen.clock == "stamps" else chosen.clock
    style: Style = ("brackets", "parentheses", "slash", "underscore")[rng.integers(4)]
    return Recorder(truth, chosen, style, names, units)
