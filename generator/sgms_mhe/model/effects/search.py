"""How a diagnosis looks for an effect: its trials, and the force a trial adds to the model's.

To first order an effect adds columns to the model's derivatives: columns in the sizes it is linear in, given the
few numbers it is not linear in (pitch, frequency, time constant). A strategy describes these columns; the
engines that try them live in the diagnosis and know no effect.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from sgms_mhe.model.effects.motion import MotionRecord
from sgms_mhe.model.effects.parameters import EffectParameter
from sgms_mhe.support.arrays import Array, Complex

Values = Mapping[str, float]
Grid = Callable[[MotionRecord], Sequence[Values]]
"""Trial values of what an effect is not linear in, from the record that is searched."""


def no_grid(_: MotionRecord) -> Sequence[Values]:
    """One trial: an effect that is linear in everything."""
    return ({},)


def one_size(name: str) -> Callable[[Values, Array], Values]:
    """Parameters of an effect whose only size is the parameter `name`."""
    return lambda given, size: {**given, name: float(size[0])}


@dataclass(frozen=True)
class Columns:
    """An effect whose force is linear in its sizes once a few numbers are given.

    Attributes:
        columns: force per unit of each size (m, k) [N], along a record at given numbers.
        parameters: the effect's parameters from the given numbers and the sizes found (k).
        grid: the numbers to try.
        tests: how many independent trials the grid amounts to.
        own_size: the given number the size must come out as: a lag is its own size. Of two trials that explain as
            much the one whose size agrees with it counts.
        variants: the numbers an identification from nothing tries, none given first; a diagnosis tries that alone.
        rise: of a contribution to the level the size, if any, by which it grows towards low speed as the Stribeck
            effect does: its force per unit is that of the column times that effect's share.
        exact: the size whose column is taken from the model's own derivative in the end, where `columns` are rough: a
            level that jumps where elements stick.
    """

    columns: Callable[[MotionRecord, Values], Array]
    parameters: Callable[[Values, Array], Values]
    grid: Grid = no_grid
    tests: float = 1.0
    own_size: str | None = None
    exact: str | None = None
    variants: Grid = no_grid
    rise: str = ""
    costly: ClassVar[bool] = False


@dataclass(frozen=True)
class CurveColumns(Columns):
    """Friction over speed of any shape, which any of a known one nearly is.

    A diagnosis looks for it where the known ones leave such a curve. That and an identification try all of the grid,
    few numbers first.
    """


@dataclass(frozen=True)
class Harmonic:
    """A sine in position or time: columns Im(g E) and Re(g E) with E = exp(i k x), g = sum_j c_j(k) w_j.

    Attributes:
        coordinate: x.
        size: name of the amplitude; its sign is that of half a turn of the phase.
        period: name of the parameter that k = 2 pi / period follows (in time: a frequency, k = 2 pi frequency).
        phase: name of the phase.
        weights: w_j (m) each.
        factors: c_j of k (n) each.
    """

    coordinate: Literal["position", "time"]
    size: str
    period: str
    weights: Callable[[MotionRecord], Sequence[Array]]
    factors: Callable[[MotionRecord, Array], Sequence[Complex]]
    phase: str = "phase_rad"
    costly: ClassVar[bool] = False


def ones(k: Array) -> Complex:
    """A factor of 1 at every k."""
    result: Complex = np.ones(len(k), dtype=np.complex128)
    return result


@dataclass(frozen=True)
class Step:
    """A force that sets in at some instant: every instant is tried.

    Attributes:
        size: name of the force.
        time: name of the instant.
        tests: how many independent trials all instants amount to.
    """

    size: str
    time: str
    tests: float = 30.0
    costly: ClassVar[bool] = False


@dataclass(frozen=True)
class Derivative:
    """The model's own derivative in a size where the effect is none, for forces that nothing shorter says.

    The search of an effect that declares none: one run of the compiled model.

    Attributes:
        size: its name; None: the effect's first size.
        grid: further trials; one compiled model serves all.
        tests: how many independent trials the grid amounts to.
        costly: whether the grid is worth its runs of the model only where something speaks for the effect.
    """

    size: str | None = None
    grid: Grid = no_grid
    tests: float = 1.0
    costly: bool = False


@dataclass(frozen=True)
class Trials:
    """An effect that is linear in nothing: the model runs at every trial, its column is the change of the force.

    Attributes:
        grid: values of one parameter.
        through: a short cut where the effect's own equations need many steps: the elements' moves per sample
            (n) [m], from the mass's moves (n) [m], the force its elements push back with (n) [N] and the trial.
    """

    grid: Grid
    through: Callable[[Array, Array, Values], Array] | None = None
    costly: ClassVar[bool] = True


@dataclass(frozen=True)
class Periodic:
    """A sum of sines in position whose periods divide one: how many and which, the data say.

    Attributes:
        sine: of the first order, with the names of the amplitude and of the common period.
        order: the list of the orders that are there.
        cosine: name of the list of the cosines' amplitudes.
        room: the longest period over the travel.
    """

    sine: Harmonic
    order: EffectParameter
    cosine: str
    room: float
    costly: ClassVar[bool] = False


@dataclass(frozen=True)
class Unsearched:
    """A table whose numbers a diagnosis learns at once: no cause, it is neither searched nor fitted."""

    costly: ClassVar[bool] = False


Search = Columns | Harmonic | Periodic | Step | Derivative | Trials | Unsearched
