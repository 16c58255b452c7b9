"""Trajectories that excite the effects of a diagnosis, or that tell two causes apart."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from sgms_mhe.machine import Machine, Units
from sgms_mhe.model.effects import MOVES, Move, cause, cause_names, find_causes, separating_moves
from sgms_mhe.model.scales import scales_of
from sgms_mhe.plant.trajectories import Motion, Trajectory
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import atomic_write
from sgms_mhe.support.names import did_you_mean
from sgms_mhe.support.notebooks import Presentation, Shown


@dataclass(frozen=True, repr=False)
class MotionPlan(Shown):
    """A trajectory and its purpose."""

    trajectory: Trajectory
    reason: str
    moves: tuple[str, ...]

    def _shown(self) -> Presentation:
        return f"{self.trajectory.name}, {self.trajectory.duration_s:.3g} s: {self.reason}", (), ()


@dataclass(frozen=True)
class _Axis:
    """Sizes of moves: fastest speed [m/s], its acceleration and jerk, break-away distance and travel [m]."""

    speed: float
    acceleration: float
    jerk: float
    breakaway: float
    travel: float

    def limits(self, share: float) -> tuple[float, float, float]:
        """Velocity, acceleration and jerk of a move at a share of the speed."""
        return share * self.speed, self.acceleration, self.jerk


def _loops(path: Motion, axis: _Axis) -> None:
    """Presliding: loops below and around break-away, slow and four times faster."""
    for pace in (1.0, 4.0):
        slow = 2.0 * axis.breakaway * pace
        for share in (0.1, 0.3, 0.8, 2.0):
            a = share * axis.breakaway
            path.loops((a, 0.6 * a, 0.3 * a), slow, 20.0 * slow, 2000.0 * slow)
    path.wait(0.2)


def _speeds(path: Motion, axis: _Axis) -> None:
    """The same stroke forth and back at rising constant speeds."""
    start = path.position
    for share in (0.003, 0.01, 0.03, 0.1, 0.3, 0.6, 1.0):
        way = min(axis.travel, max(axis.speed * share * 0.5, 10.0 * axis.breakaway))
        path.move_to(start + way, *axis.limits(share))
        path.wait(0.05)
        path.move_to(start, *axis.limits(share))
        path.wait(0.05)


def _travel(path: Motion, axis: _Axis) -> None:
    """The whole travel forth and back, slowly and fast, for forces fixed in place."""
    start = path.position
    for share in (0.1, 0.4):
        path.move_to(start + axis.travel, *axis.limits(share))
        path.move_to(start, *axis.limits(share))


def _jerks(path: Motion, axis: _Axis) -> None:
    """Short hard moves: inertia, delays, resonances."""
    for sign in (1.0, -1.0, 1.0, -1.0):
        path.move_by(sign * 0.05 * axis.travel, axis.speed, 1.5 * axis.acceleration, 4.0 * axis.jerk)
        path.wait(0.15)
    for frequency in (4.0, 8.0, 16.0):
        path.swing(min(0.02 * axis.travel, 0.3 * axis.acceleration / (6.3 * frequency) ** 2), frequency, cycles=6)


def _rests(path: Motion, axis: _Axis) -> None:
    """Slow break-away after rests of different length."""
    for rest in (0.05, 0.2, 0.8, 3.0, 0.05, 0.8):
        path.wait(rest)
        path.move_by(20.0 * axis.breakaway, *axis.limits(0.005))
        path.move_by(-20.0 * axis.breakaway, *axis.limits(0.005))


def _places(path: Motion, axis: _Axis) -> None:
    """Small loops at places far apart."""
    start = path.position
    for share in (0.0, 0.5, 1.0, 0.0):
        path.move_to(start + share * axis.travel, *axis.limits(0.4))
        path.wait(0.1)
        a = axis.breakaway
        path.loops((2.0 * a, a, 0.4 * a), 4.0 * a, 80.0 * a, 8000.0 * a)


def _again(path: Motion, axis: _Axis) -> None:
    """Later, the move from the beginning once more."""
    path.wait(5.0)
    _speeds(path, axis)


LEAST_S: Final = 20.0
"""A plan that is shorter begins again: a few moves are too few independent pieces of evidence."""
LAPS: Final = (1.0, 0.8, 0.9, 0.7, 0.95, 0.75)
"""Speed and travel of each lap: laps that are all alike would be a clock."""

_MAKERS: Final[Mapping[Move, Callable[[Motion, _Axis], None]]] = {
    "loops": _loops,
    "speeds": _speeds,
    "travel": _travel,
    "jerks": _jerks,
    "rests": _rests,
    "places": _places,
    "again": _again,
}


def list_open_causes(path: Path) -> tuple[str, ...]:
    """Return the causes the statements in a JSON file leave open, and that a motion would show.

    Raises:
        InputError: the file; it leaves nothing open a motion shows.
    """
    try:
        statements = json.loads(path.read_text(encoding="utf-8"))["statements"]
        opened = [s for s in statements if s["sure"] != "yes" and s["next"]]
        words = [f"{s['about']} {s['why']['numbers'].get('other', '')} {s['kind']}" for s in opened]
    except (OSError, ValueError, KeyError, TypeError) as error:
        allowed = (
            f"a JSON of start, identify or diagnose ({error.strerror if isinstance(error, OSError) else 'it is none'})"
        )
        raise InputError(path, "--open", None, allowed) from None
    causes = find_causes(" ".join(words))
    if not causes:
        raise InputError(path, "--open", None, "a result that leaves something open which a motion would show")
    return causes


def make_plan(machine: Machine, separate: tuple[str, str] | None = None, wanted: Sequence[str] = ()) -> MotionPlan:
    """A trajectory for a machine: for everything, for two causes and their separation, or for wanted ones.

    Raises:
        InputError: a cause that does not exist.
    """
    for name in separate or ():
        if name not in (known := cause_names(machine.plant.kind)):
            allowed = f"two of {', '.join(known)}, as a {machine.plant.kind} axis has{did_you_mean(name, known)}"
            raise InputError("plan", "separate", name, allowed)
    speed = 0.9 * machine.sampling.max_velocity
    deflection = scales_of(machine).deflection
    shown = {move for name in separate or wanted for move in cause(name).moves}
    moves = [move for move in MOVES if move in shown or not shown]
    path = Motion(machine.sampling.rate)
    path.wait(0.3)
    for share in LAPS:
        # Half a second at full speed, reached within a tenth of a second.
        axis = _Axis(share * speed, 10.0 * speed, 400.0 * speed, deflection, 0.5 * share * speed)
        for move in moves:
            _MAKERS[move](path, axis)
            path.wait(0.2)
        path.move_to(0.0, *axis.limits(0.4))
        path.wait(0.3)
        if path.duration_s >= LEAST_S:
            break
    reason = "excites every effect of the catalogue"
    if wanted:
        reason = f"shows {', '.join(wanted)}: {', '.join(MOVES[move] for move in moves)}"
    if separate is not None:
        said = separating_moves(*separate)[:1] or dict.fromkeys(cause(name).excitation.text for name in separate)
        reason = f"{' or '.join(separate)}: {'; '.join(said)}"
    return MotionPlan(path.trajectory(f"{machine.name}_plan"), reason, tuple(MOVES[move] for move in moves))


def write_plan(path: str | Path, plan: MotionPlan, units: Units) -> None:
    """Write the trajectory as CSV: time_s, position_m (position_rad of a rotary axis)."""
    trajectory = plan.trajectory
    table = np.column_stack((trajectory.time_s, trajectory.position_m))
    with atomic_write(path) as stream:
        stream.write(f"time_s,{units.named('position_m')}\n".encode())
        stream.write("".join(f"{t!r},{q!r}\n" for t, q in table.tolist()).encode())
