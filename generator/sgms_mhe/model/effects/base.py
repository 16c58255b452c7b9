"""Wrong numbers of the base model, described as effects are: a diagnosis treats both alike."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from sgms_mhe.model.effects.causes import CauseDefinition
from sgms_mhe.model.effects.excitation import Excitation, Need
from sgms_mhe.model.effects.motion import MotionRecord
from sgms_mhe.model.effects.parameters import RecordLimit
from sgms_mhe.model.effects.scales import Unit
from sgms_mhe.model.effects.search import Columns, Values

LARGEST_RISE: Final = 20.0
"""Stribeck ratio beyond which none is followed [1]: far above the Stribeck velocity any size would do."""
FASTEST_STRIBECK: Final = 0.1
"""Largest Stribeck velocity, over the largest speed: a rise of friction over the whole range of speed is a curve that
effects have names for."""
LEVEL: Final = "coulomb"
DAMPING: Final = "viscous"
"""The numbers that level and damping of a `MotionRecord` are the model's derivatives in."""
MASS: Final = "mass_kg"
"""The moved mass, beside the numbers of friction, by its name in results."""
POSITIVE: Final = 1e-6
"""Least of a number that a model divides by, over its nominal value [1]."""
SLOWEST_STRIBECK: Final = 3e-4  # the least that is tried


@dataclass(frozen=True)
class BaseNumber:
    """One number of the base model that may be wrong.

    Attributes:
        name: as in `[estimator] parameters`.
        words: its name for people.
        suffix: its unit at the end of its name in reports (`_N` of `coulomb_N`, `_N_m` of `stiffness_1_N_m`).
        array: whether each element has one (`stiffness_1`, `stiffness_2`, ...).
        shares: whether they sum to 1, so that the largest is the rest of the others and no number of its own.
        lower, upper: limits of a fit, over the nominal value: a positive one stays so, and nothing else.
        typical: size, in `unit`s of the machine, that a fit counts in where the machine file says 0; None: it may not.
        most: limit of its identifiability [SI]. The machine file's own value stays allowed.
    """

    name: str
    words: str
    suffix: str = ""
    array: bool = False
    shares: bool = False
    lower: float = POSITIVE
    upper: float = math.inf
    typical: float | None = None
    unit: Unit = "one"
    most: RecordLimit | None = None

    def holds(self, column: str) -> bool:
        """Return True if a column of results is this number, or one of its elements."""
        return column == self.name or (self.array and self.is_element(column))

    def is_element(self, column: str) -> bool:
        """Return True if a column of results is one of its elements."""
        stem, _, index = column.rpartition("_")
        return stem == self.name and index.isdigit()

    def columns(self, elements: int) -> tuple[str, ...]:
        """Its columns of results for a machine of so many elements."""
        return tuple(f"{self.name}_{i + 1}" for i in range(elements)) if self.array else (self.name,)

    def element(self, column: str) -> int:
        """Index of the element a column of an array is of, from 0."""
        return int(column.rpartition("_")[2]) - 1


@dataclass(frozen=True, kw_only=True)
class BaseCause(CauseDefinition):
    """A wrong number: which numbers of the base model it means, and how their fit starts.

    Attributes:
        numbers: of the base model.
        start_factors: factors, common to all elements, that a fit may start from: where elements turn round all the
            time the sum of squares is rough in them, and a fit that starts far away stops short. Empty: the file's.
        start_search: columns to start from where the machine file says 0 of a number and so nothing of the others;
            sizes that are not positive are none.
    """

    numbers: tuple[BaseNumber, ...]
    start_factors: tuple[float, ...] = ()
    start_search: Columns | None = None

    @property
    def frees(self) -> tuple[str, ...]:
        """Names for `[estimator] parameters`."""
        return tuple(number.name for number in self.numbers)


FRACTION: Final = BaseNumber("fraction", "share of the Coulomb level", array=True, shares=True)


def _velocities(motion: MotionRecord) -> list[Values]:
    shares = np.geomspace(SLOWEST_STRIBECK, FASTEST_STRIBECK, 12)
    return [{"stribeck_velocity": float(v)} for v in shares * motion.extents.speed]


_RISE = Columns(
    lambda m, p: (m.level * np.exp(-((np.abs(m.velocity) / p["stribeck_velocity"]) ** 2)))[:, None],
    lambda given, size: {"stribeck_ratio": float(size[0]), **given},
    _velocities,
    tests=12.0,
)


BASE_CAUSES: Final[Mapping[str, BaseCause]] = {
    cause.name: cause
    for cause in (
        BaseCause(
            name="stiffness",
            summary="presliding stiffness differs from the machine file",
            numbers=(BaseNumber("stiffness", "stiffness", "_N_m", array=True),),
            start_factors=(0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8),
            moves=("loops", "places"),
            excitation=Excitation(
                "reversals, and loops that stay below break-away; an element shows only where it turns round",
                (Need("reversals", 4.0),),
            ),
            confused_with={
                "hose_hysteresis": "small loops at places far apart: both hystereses are there, but the hose's "
                "alone goes on rising over travels far beyond break-away",
                "micro_viscous": "the same presliding loop at two speeds: a spring does not know speed",
                "backlash": "one slow reversal: a gap has no force at all, a soft element a low slope",
            },
        ),
        BaseCause(
            name="fraction",
            summary="shares of the Coulomb level that elements carry differ from the machine file",
            numbers=(FRACTION,),
            moves=("loops", "places"),
            excitation=Excitation(
                "reversals, and loops below and beyond each element's break-away", (Need("reversals", 4.0),)
            ),
            confused_with={
                "stiffness": "loops well below break-away: there the stiffnesses alone count, beyond it the shares",
                "hose_hysteresis": "small loops at places far apart: both hystereses are there, but the hose's "
                "alone goes on rising over travels far beyond break-away",
            },
        ),
        BaseCause(
            name="coulomb",
            summary="Coulomb level differs from the machine file",
            numbers=(BaseNumber("coulomb", "Coulomb friction", "_N"),),
            of_record=True,  # temperature changes it
            over_speed=True,
            moves=("speeds", "again"),
            excitation=Excitation("sliding in both directions", (Need("both_directions", 0.1), Need("reversals", 1.0))),
            confused_with={
                "force_gain": "one move with high acceleration: a gain scales the inertial force too",
                "friction_drift": "the same move at the beginning and at the end of the log",
                "constant_offset": "move in both directions: an offset does not change sign",
                "asymmetric_coulomb": "move in both directions: a wrong level is wrong the same way in either",
            },
        ),
        BaseCause(
            name="viscous",
            summary="viscous friction differs from the machine file",
            numbers=(BaseNumber("viscous", "viscous friction", "_N_s_m", lower=0.0, typical=0.1, unit="damping"),),
            of_record=True,  # temperature changes it
            over_speed=True,
            moves=("speeds", "again"),
            excitation=Excitation(
                "constant speeds that differ by a factor of three", (Need("speed_ratio", 2.0), Need("moving_s", 0.5))
            ),
            confused_with={
                "eddy_current_damping": "constant speeds up to twice the corner velocity: it falls off there",
                "quadratic_drag": "three constant speeds or more: is the force over speed a line or a parabola",
                "force_delay": "constant speed: a delay has no effect there",
                "asymmetric_viscous": "both directions: a wrong damping is wrong the same way in either",
            },
        ),
        BaseCause(
            name="stribeck",
            summary="rise of friction towards low speed differs from the machine file",
            numbers=(
                BaseNumber("stribeck_ratio", "stribeck ratio", lower=0.0, typical=0.1, most=lambda _: LARGEST_RISE),
                BaseNumber(
                    "stribeck_velocity",
                    "stribeck velocity",
                    "_m_s",
                    most=lambda extents: FASTEST_STRIBECK * extents.speed,
                ),
            ),
            start_search=_RISE,
            over_speed=True,
            moves=("speeds", "rests"),
            excitation=Excitation(
                "constant speeds from well below to well above the Stribeck velocity", (Need("speed_ratio", 10.0),)
            ),
            confused_with={
                "dwell_dependence": "break away after rests of different length, at the same speed",
                "frictional_lag": "pass through the Stribeck velocity with different accelerations",
                "eddy_current_damping": "speeds below the Stribeck velocity",
            },
        ),
    )
}
"""Wrong-number causes by name."""


def base_number(column: str) -> BaseNumber | None:
    """The number of the base model a column of results (`coulomb`, `stiffness_2`) is of; None if it is of none."""
    numbers = (number for cause in BASE_CAUSES.values() for number in cause.numbers)
    return next((number for number in numbers if number.holds(column)), None)


def reported_name(column: str) -> str:
    """A column's name in reports, with its unit at the end: `coulomb_N`, `stiffness_2_N_m`."""
    number = base_number(column)
    return column if number is None else column + number.suffix


def base_cause(name: str) -> BaseCause:
    """Return the wrong-number cause called `name`; KeyError if there is none."""
    return BASE_CAUSES[name]
