"""Schema of the machine file: every key with its unit, range and default.

One pydantic model per TOML table. The models are frozen and hold resolved numbers: whatever default depends on another
key (substeps, displacement, micro-viscous terms, effect parameters) is filled in here, so that no reader of a `Machine`
repeats a default.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    PrivateAttr,
    model_validator,
)
from pydantic_core import PydanticCustomError, PydanticUndefined

BASE_PARAMETERS: Final = ("stiffness", "coulomb", "viscous", "stribeck_ratio", "stribeck_velocity")
"""Parameters of the base model that can be estimated."""

DISPLACEMENT: Final = {"rk4": 0.03, "rk2": 0.05, "bs23": 0.02, "euler": 0.01, "flow": 0.1}
"""Default largest move per substep in deflection scales (`flow`: for the blocks that it leaves to rk4).

rk4 and bs23 then keep the force of Table I within 1e-4 N at every speed; rk2 and euler are off by up to 6e-3 N."""

CHOSEN_BY_TOLERANCE: Final = ("scheme", "substeps", "displacement", "slow_displacement")
"""Keys of the integrator that a tolerance excludes: it chooses them."""

LOG_UNITS: Final[dict[str, dict[str, tuple[float, float]]]] = {
    "time_s": {"s": (1.0, 0.0), "ms": (1e-3, 0.0), "us": (1e-6, 0.0), "min": (60.0, 0.0)},
    "position_m": {"m": (1.0, 0.0), "mm": (1e-3, 0.0), "um": (1e-6, 0.0), "nm": (1e-9, 0.0)},
    "force_N": {"N": (1.0, 0.0), "mN": (1e-3, 0.0), "kN": (1e3, 0.0)},
    "velocity_m_s": {"m/s": (1.0, 0.0), "mm/s": (1e-3, 0.0), "um/s": (1e-6, 0.0)},
    "acceleration_m_s2": {"m/s^2": (1.0, 0.0), "mm/s^2": (1e-3, 0.0)},
    "friction_N": {"N": (1.0, 0.0), "mN": (1e-3, 0.0), "kN": (1e3, 0.0)},
    "temperature_degC": {"degC": (1.0, 0.0), "K": (1.0, -273.15)},
}
"""Columns of a log, and the units in which a recorded file may hold them: SI value = factor * value + shift."""

SUM_TOLERANCE: Final = 1e-6
RATIO_TOLERANCE: Final = 1e-9
SMALLEST_CUTOFF: Final = 1e-4  # of rate: below it the low-pass coefficients lose their digits

C_KEYWORDS: Final = frozenset(
    """
    alignas alignof and asm auto bool break case catch char class compl const constexpr continue decltype
    default delete do double else enum explicit export extern false float for friend goto if inline int long
    main mutable namespace new noexcept not nullptr operator or private protected public register restrict
    return short signed sizeof static struct switch template this throw true try typedef typename union unsigned
    using virtual void volatile while xor
    """.split()
)

RESERVED_NAMES: Final = re.compile(
    r"sgms(_.*)?"  # the runtime's files and symbols
    r"|(element|block)[0-9]*|chain|course|flow|friction|hold|parameter|sample|selftest|start|take"  # a package's own
    r"|u?int((_least|_fast)?[0-9]+|ptr|max)|size|ptrdiff|wchar|wint|clock|time|fpos|va_list"  # types of the C library
    r"|assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal|std[a-z]+|string|tgmath"
    r"|threads|uchar|wctype",  # its headers
    re.IGNORECASE,
)
"""Machine names whose files or symbols would take the place of others, also where file names ignore case."""


def quantity(meaning: str, unit: str, default: Any = PydanticUndefined, **options: Any) -> Any:
    """A number whose description states meaning, unit, range and default; `options` are gt, ge, lt, le, alias."""
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    span = " and ".join(f"{signs[key]} {limit:g}" for key, limit in options.items() if key in signs)
    start = "required" if default is PydanticUndefined else f"default {default}"
    return Field(default, description=f"{meaning} [{unit}]; {span or 'any finite number'}; {start}", **options)


def text(meaning: str, allowed: str, default: Any = PydanticUndefined, **options: Any) -> Any:
    """A field that is not a number: meaning, allowed values and default."""
    start = "required" if default is PydanticUndefined else f"default {default!r}"
    return Field(default, description=f"{meaning}; {allowed}; {start}", **options)


def refusal(where: str, value: object, allowed: str) -> PydanticCustomError:
    """A violated rule between keys; `where` is relative to the table that checks the rule."""
    return PydanticCustomError("rule", "{allowed}", {"where": where, "value": value, "allowed": allowed})


def listing(names: Iterable[str]) -> str:
    """Names as in a sentence."""
    return ", ".join(names)


def merged(base: Any, over: Any) -> Any:
    """Content `over` laid over `base`: tables merge key by key; everything else, arrays included, is replaced.

    A tolerance takes the place of the integrator that it would exclude, and the other way round.
    """
    if isinstance(base, Mapping) and isinstance(over, Mapping):
        kept = dict(base)
        for given, excluded in (
            ("tolerance", CHOSEN_BY_TOLERANCE),
            *((key, ("tolerance",)) for key in CHOSEN_BY_TOLERANCE),
        ):
            if given in over:
                kept = {key: value for key, value in kept.items() if key not in excluded}
        return {**kept, **{key: merged(kept.get(key), value) for key, value in over.items()}}
    return over


class Table(BaseModel):
    """A TOML table: unknown keys, coerced types and non-finite numbers are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Floats = Annotated[tuple[Annotated[float, Field()], ...], Field(strict=False)]
Positives = Annotated[tuple[Annotated[float, Field(gt=0, le=1e12)], ...], Field(strict=False)]
NonNegatives = Annotated[tuple[Annotated[float, Field(ge=0, le=1e9)], ...], Field(strict=False)]
Names = Annotated[tuple[str, ...], Field(strict=False)]
Pair = Annotated[tuple[Annotated[float, Field(ge=0)], float], Field(strict=False)]


class Plant(Table):
    """What moves."""

    mass: float = quantity("moved mass", "kg", gt=0, le=1e6)


class Smoothing(Table):
    """Smoothing of the slip switches, equation (3); lambda (1 - zeta) = 3.5 leaves 1e-3 of the level."""

    zeta: float = quantity("deflection ratio at which slip sets in", "1", 0.9, gt=0, lt=1)
    lambda_: float = quantity("sharpness of the slip window", "1", 35.0, gt=0, le=1e3, alias="lambda")
    gamma: float = quantity("sharpness of the direction gate", "1", 35.0, gt=0, le=1e3)


class Friction(Table):
    """S-GMS parameters, one entry per Maxwell-slip element in the arrays."""

    stiffness: Positives = text("kappa_i, element stiffness [N/m]", "1 to 10 numbers > 0", min_length=1, max_length=10)
    fraction: Positives = text("nu_i, share of the Coulomb level [1]", "as many as stiffness, > 0, sum 1")
    micro_viscous: NonNegatives = Field(
        (), description="sigma_i, element damping [N s/m]; as many as stiffness, >= 0; default 0 each"
    )
    viscous: float = quantity("sigma_v, viscous damping", "N s/m", 0.0, ge=0, le=1e9)
    coulomb: float = quantity("f_C, Coulomb level", "N", gt=0, le=1e7)
    stribeck_ratio: float = quantity("beta, static over Coulomb level minus one", "1", 0.0, ge=0, le=100)
    stribeck_velocity: float = quantity("v_s, Stribeck velocity", "m/s", 1e-3, gt=0, le=10)
    smoothing: Smoothing = Field(Smoothing(), description="smoothing of the slip switches; default zeta 0.9, 35, 35")

    @property
    def n_z(self) -> int:
        """Number of Maxwell-slip elements."""
        return len(self.stiffness)

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, data: Any) -> Any:
        if (
            isinstance(data, Mapping)
            and "micro_viscous" not in data
            and isinstance(data.get("stiffness"), list | tuple)
        ):
            return {**data, "micro_viscous": [0.0] * len(data["stiffness"])}
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        for key in ("fraction", "micro_viscous"):
            values = getattr(self, key)
            if len(values) != self.n_z:
                raise refusal(key, list(values), f"{self.n_z} numbers, as many as stiffness has (here {len(values)})")
        total = sum(self.fraction)
        if abs(total - 1.0) > SUM_TOLERANCE:
            raise refusal("fraction", list(self.fraction), f"fractions that sum to 1 (here {total:.9g})")
        return self


class Integrator(Table):
    """How one shooting interval is integrated."""

    scheme: Literal["rk4", "rk2", "bs23", "euler", "flow"] = text(
        "integration scheme", "rk4, rk2, bs23, euler or flow", "rk4"
    )
    substeps: int = Field(
        1,
        ge=1,
        le=1_000_000,
        description="least number of steps per shooting interval [1]; a multiple or a divisor of rate / update_rate; "
        "default: rate / update_rate",
    )
    velocity: Literal["constant", "linear"] = text(
        "velocity between two samples",
        "constant or linear (linear: at least one substep per sample, not flow)",
        "constant",
    )
    displacement: float = Field(
        default_factory=lambda data: DISPLACEMENT[data["scheme"]],
        gt=0,
        le=10,
        description="largest move per substep over the deflection scale [1]; > 0 and <= 10; "
        "default 0.03 (rk4), 0.1 (flow), 0.05 (rk2), 0.02 (bs23), 0.01 (euler)",
    )
    slow_displacement: float = quantity(
        "of the flow: the same below the speed at which the gate saturates", "1", 0.02, gt=0, le=1
    )
    tolerance: float | None = Field(
        None,
        gt=0,
        le=0.1,
        description="largest error of an element's end state and of both its sensitivities over one interval, over the "
        "deflection scale [1]; > 0 and <= 0.1; chooses the scheme and its steps, so it stands without "
        f"{listing(CHOSEN_BY_TOLERANCE)}; default none",
    )


class Sampling(Table):
    """Rates, the velocity filter, the stated maximum speed."""

    rate: float = quantity("sample rate of position and force", "Hz", 10000.0, gt=0, le=1e7)
    update_rate: float = quantity("estimator updates; divides rate", "Hz", 100.0, gt=0, le=1e6)
    velocity_cutoff: float = quantity("second-order low-pass; < rate / 2", "Hz", 500.0, gt=0)
    max_velocity: float = quantity("speed up to which the estimate is right", "m/s", 1.0, gt=0, le=1e3)
    integrator: Integrator = Field(Integrator(), description="integration scheme; default rk4, one substep per sample")

    @property
    def samples_per_update(self) -> int:
        """M, samples per shooting interval."""
        return round(self.rate / self.update_rate)

    @property
    def step(self) -> float:
        """h [s], time between samples."""
        return 1.0 / self.rate

    @property
    def merged(self) -> int:
        """K, samples that make one integration step."""
        return max(1, self.samples_per_update // self.integrator.substeps)

    @property
    def varies_in_step(self) -> bool:
        """Whether signals are lines within a step, not constant."""
        return self.merged > 1 or self.integrator.velocity == "linear"

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, data: Any) -> Any:
        # The default of substeps needs both rates; wrong types are left for the fields to refuse.
        if not isinstance(data, Mapping):
            return data
        integrator = data.get("integrator", {})
        if isinstance(integrator, Mapping) and integrator.get("tolerance") is not None:
            given = [key for key in CHOSEN_BY_TOLERANCE if key in integrator]
            if given:
                allowed = f"no {given[0]} beside a tolerance, which chooses {listing(CHOSEN_BY_TOLERANCE)}"
                raise refusal(f"integrator.{given[0]}", integrator[given[0]], allowed)
        rate, update_rate = (data.get(key, cls.model_fields[key].default) for key in ("rate", "update_rate"))
        sound = all(type(value) in (int, float) and 0 < value < math.inf for value in (rate, update_rate))
        if sound and rate >= update_rate and isinstance(integrator, Mapping) and "substeps" not in integrator:
            return {**data, "integrator": {**integrator, "substeps": round(rate / update_rate)}}
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        ratio = self.rate / self.update_rate
        samples = self.samples_per_update
        if samples < 1 or abs(ratio - samples) > RATIO_TOLERANCE * ratio:
            raise refusal(
                "update_rate", self.update_rate, f"a rate that divides rate = {self.rate:g} Hz (ratio {ratio:g})"
            )
        if not SMALLEST_CUTOFF * self.rate <= self.velocity_cutoff < self.rate / 2:
            allowed = f">= {SMALLEST_CUTOFF * self.rate:g} Hz and < rate / 2 = {self.rate / 2:g} Hz"
            raise refusal("velocity_cutoff", self.velocity_cutoff, allowed)
        steps = self.integrator.substeps
        if steps % samples and samples % steps:
            raise refusal("integrator.substeps", steps, f"a multiple or a divisor of rate / update_rate = {samples}")
        if self.integrator.velocity == "linear":
            if self.integrator.tolerance is not None:
                raise refusal("integrator.velocity", "linear", "constant, where a tolerance is given")
            if self.integrator.scheme == "flow":
                raise refusal("integrator.velocity", "linear", "constant, where scheme is flow")
            if steps < samples:
                raise refusal(
                    "integrator.velocity",
                    "linear",
                    f"constant, where substeps < {samples}: merged samples are lines already",
                )
        return self


class Noise(Table):
    """Weights of the estimator, all one standard deviation."""

    measurement: float = quantity("sigma_y, friction measurement", "N", 0.5, gt=0, le=1e6)
    state: float = quantity("sigma_x per interval, as a fraction of nu_i f_C", "1", 0.02, gt=0, le=1e3)
    parameter: float = quantity("prior of a parameter, relative", "1", 0.3, gt=0, le=1e3)
    parameter_drift: float = quantity("random walk of a parameter per update, relative", "1", 0.002, ge=0, le=1e3)
    initial_state: float = quantity("prior of the first node's state, fraction of nu_i f_C", "1", 1.0, gt=0, le=1e3)
    state_as: Literal["force", "deflection"] = text(
        "node state that the noise acts on", "force (element force) or deflection (the paper)", "force"
    )


class ArrivalCost(Table):
    """Summary of what lies before the horizon."""

    update: Literal["riccati", "fixed"] = text("update of the arrival cost", "riccati or fixed", "riccati")


def _flatten(data: Any) -> Any:
    # TOML reads a bare key `effect.param` as a nested table: both spellings mean the same.
    if not isinstance(data, Mapping):
        return data
    flat: dict[str, Any] = {}
    for key, value in data.items():
        nested = (
            {f"{key}.{inner}": entry for inner, entry in value.items()} if isinstance(value, Mapping) else {key: value}
        )
        for name, entry in nested.items():
            if name in flat:
                raise refusal(name, entry, "one entry per parameter; this one is given twice")
            flat[name] = entry
    return flat


class Estimator(Table):
    """The observer."""

    kind: Literal["mhe", "ekf"] = text("estimator", "mhe or ekf", "mhe")
    horizon: int = quantity("N, shooting intervals", "1", 20, ge=1, le=1000)
    relinearise: Literal["all", "auto", "newest"] = text(
        "what of the older intervals an update linearises anew about the last solution",
        "all, auto (the blocks that have moved most) or newest (none: each but once, as the newest); of the mhe alone",
        "all",
    )
    parameters: Names = text(
        "parameters to estimate",
        f"any of {listing(BASE_PARAMETERS)} and effect.parameter of the effects, each once, at least one",
        ("stiffness",),
        min_length=1,
    )
    noise: Noise = Field(Noise(), description="standard deviations; default as in its keys")
    arrival_cost: ArrivalCost = Field(ArrivalCost(), description="arrival cost; default riccati")
    bounds: Annotated[dict[str, Pair], BeforeValidator(_flatten)] = Field(
        {}, description="[low, high] of a parameter over its nominal value [1]; 0 <= low < 1 < high; default unbounded"
    )

    @property
    def drift_interval(self) -> int:
        """Shifts of the window between two growths of the arrival cost by the drift: one window long, 20 at most."""
        return min(self.horizon, 20)

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, (low, high) in self.bounds.items():
            if not low < 1.0 < high:
                raise refusal(f"bounds.{name}", [low, high], "[low, high] times nominal with 0 <= low < 1 < high")
        for name, count in Counter(self.parameters).items():
            if count > 1:
                raise refusal("parameters", list(self.parameters), f"each parameter once ({name} stands {count} times)")
        return self


class Compensation(Table):
    """The friction that tick feeds forward to the drive."""

    delay: float = quantity("from a sample until the force that answers it acts, mean", "s", 0.0, ge=0, le=0.1)
    ramp: float = quantity("from off to fully on, and back", "s", 0.0, ge=0, le=100)
    limit: float | None = quantity("largest force fed forward; absent: none", "N", None, gt=0, le=1e9)
    hold: float = quantity(
        "speed below which the force fed forward holds; two encoder steps over the filters' delay end hunting at rest",
        "m/s",
        0.0,
        ge=0,
        le=10,
    )
    enabled: bool = text("on from init on; otherwise the compensate call turns it on", "true or false", True)


class Code(Table):
    """The emitted C."""

    precision: Literal["double", "single"] = text("floating-point type", "double or single", "double")


class Effect(Table):
    """One entry of [[effects]]: a name and that effect's parameters; units stand in the parameters' names."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float]

    name: str = text("effect, as in the registry of effects", "a known effect")

    _label: str = PrivateAttr(default="")

    @property
    def label(self) -> str:
        """Unique name within the machine: the effect's name; of the second effect of that name, `name_2`."""
        return self._label or self.name

    @property
    def parameters(self) -> dict[str, float]:
        """Value of every parameter, in the registry's order and in the units of their names."""
        return dict(self.__pydantic_extra__)

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or not isinstance(data.get("name"), str):
            return data
        # Imported here: effects may themselves be described in terms of machines.
        from sgms_mhe.model.effects import EFFECT_NAMES, effect_definition

        name = data["name"]
        if name not in EFFECT_NAMES:
            raise refusal("name", name, f"one of {listing(EFFECT_NAMES)}")
        definitions = {parameter.name: parameter for parameter in effect_definition(name).parameters}
        for key, value in data.items():
            if key != "name" and key not in definitions:
                raise refusal(key, value, f"unknown key; {name} has {listing(definitions)}")
        filled: dict[str, Any] = {"name": name}
        for key, parameter in definitions.items():
            value = data.get(key, parameter.default)
            if type(value) in (int, float) and not parameter.lower <= value <= parameter.upper:
                raise refusal(key, value, parameter.allowed)
            filled[key] = value
        return filled


class LogColumn(Table):
    """Where a log's column comes from: column = scale * variable + offset, given in `unit`."""

    variable: str = text("variable or header of the measured file", "a name", min_length=1)
    scale: float = quantity("factor on the variable; not 0", "unit per recorded unit", 1.0)
    offset: float = quantity("added after scaling", "unit", 0.0)
    unit: str | None = text("unit after scale and offset", "see the column; the column's own where absent", None)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.scale == 0.0:
            raise refusal("scale", self.scale, "a number other than 0")
        return self


def _as_column(data: Any) -> Any:
    return {"variable": data} if isinstance(data, str) else data


Source = Annotated[LogColumn | None, BeforeValidator(_as_column, json_schema_input_type=LogColumn | str | None)]


def _column(name: str) -> Any:
    allowed = f"a variable's name or {{ variable, scale, offset, unit }} with unit {listing(LOG_UNITS[name])}"
    return Field(None, description=f"source of the log's column {name}; {allowed}; default: a variable named {name}")


class LogMapping(Table):
    """Variables, scales and units of a measured file, for recorded files that are read as they are."""

    time_s: Source = _column("time_s")
    position_m: Source = _column("position_m")
    force_N: Source = _column("force_N")
    velocity_m_s: Source = _column("velocity_m_s")
    acceleration_m_s2: Source = _column("acceleration_m_s2")
    friction_N: Source = _column("friction_N")
    temperature_degC: Source = _column("temperature_degC")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, units in LOG_UNITS.items():
            column: LogColumn | None = getattr(self, name)
            if column is not None and column.unit is not None and column.unit not in units:
                raise refusal(f"{name}.unit", column.unit, f"one of {listing(units)}")
        return self


class Machine(Table):
    """A machine file, resolved and checked."""

    name: str = text(
        "prefix of every emitted symbol and file",
        "a C identifier of at most 48 characters that starts with a letter",
        pattern=r"^[A-Za-z][A-Za-z0-9_]*$",
        max_length=48,
    )
    description: str = text(
        "one line about the axis", "one line without comment marks or backslashes", "", max_length=200
    )
    plant: Plant = Field(description="what moves; required")
    friction: Friction = Field(description="S-GMS parameters; required")
    sampling: Sampling = Field(
        Sampling(integrator=Integrator(substeps=100)), description="rates; default 10 kHz, 100 Hz"
    )
    estimator: Estimator = Field(Estimator(), description="the observer; default as in its keys")
    compensation: Compensation = Field(
        Compensation(), description="the friction fed forward; default: at once, unlimited, without a delay"
    )
    code: Code = Field(Code(), description="the emitted C; default double precision")
    effects: Annotated[tuple[Effect, ...], Field(strict=False)] = Field(
        (), description="what the axis has beyond S-GMS; none, one or many; default none"
    )
    log: LogMapping | None = Field(None, description="mapping of a measured file; default: columns named as in a log")

    _source: Path = PrivateAttr(default=Path())
    _content: dict[str, Any] = PrivateAttr(default_factory=dict)

    @property
    def source(self) -> Path:
        """The file that this machine was read from."""
        return self._source

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the resolved content: the same wherever the file lies and however it is written."""
        content = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(content.encode()).hexdigest()

    @property
    def estimable(self) -> tuple[str, ...]:
        """Names that [estimator] parameters and bounds may use."""
        return BASE_PARAMETERS + tuple(f"{effect.label}.{key}" for effect in self.effects for key in effect.parameters)

    @property
    def content(self) -> dict[str, Any]:
        """What the file says, `extends` merged, defaults not filled in."""
        return self._content

    @model_validator(mode="wrap")
    @classmethod
    def _keep(cls, data: Any, handler: ModelWrapValidatorHandler[Machine]) -> Machine:
        machine = _with_chosen_integrator(handler(data))
        if isinstance(data, Mapping):
            machine._content = dict(data)
        return machine

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.name in C_KEYWORDS:
            raise refusal("name", self.name, "a C identifier that is not a keyword of C or C++")
        if RESERVED_NAMES.fullmatch(self.name):
            raise refusal(
                "name", self.name, "a name that neither the runtime (sgms...), a package nor C has for itself"
            )
        if not self.description.isprintable() or re.search(r"/\*|\*/|\\", self.description):
            raise refusal("description", self.description, "one printable line without comment marks or backslashes")
        counts: Counter[str] = Counter()
        for effect in self.effects:
            counts[effect.name] += 1
            effect._label = effect.name if counts[effect.name] == 1 else f"{effect.name}_{counts[effect.name]}"
        names = self.estimable
        for index, name in enumerate(self.estimator.parameters):
            if name not in names:
                raise refusal(f"estimator.parameters.{index}", name, f"one of {listing(names)}")
            if name in BASE_PARAMETERS and getattr(self.friction, name) == 0.0:
                raise refusal(
                    f"estimator.parameters.{index}", name, f"a parameter that is not 0 (friction.{name} is its scale)"
                )
        for name in self.estimator.bounds:
            if name not in names:
                raise refusal(
                    f"estimator.bounds.{name}", list(self.estimator.bounds[name]), f"a key out of {listing(names)}"
                )
        return self


def _with_chosen_integrator(machine: Machine) -> Machine:
    """The machine with the integrator that its tolerance asks for, if it has one."""
    sampling = machine.sampling
    tolerance = sampling.integrator.tolerance
    if tolerance is None:
        return machine
    # Imported here: few machines need it, and it brings numpy.
    from sgms_mhe.integration.work_precision import ROUNDING, candidates, choose

    found = candidates(machine.friction, sampling, machine.code.precision)
    chosen = choose(found, tolerance, machine.code.precision)
    if chosen is None:
        best = max(min(c.errors.largest for c in found), ROUNDING[machine.code.precision])
        allowed = f">= {best:.1e}, the least that the schemes reach in {machine.code.precision} precision"
        raise refusal("sampling.integrator.tolerance", tolerance, allowed)
    integrator = sampling.integrator.model_copy(update=chosen.settings)
    return machine.model_copy(update={"sampling": sampling.model_copy(update={"integrator": integrator})})
