"""Friction over speed with few points, as drives and spreadsheets take it."""

from dataclasses import dataclass, replace
from typing import Final

import casadi as ca
import numpy as np

from sgms_mhe.emission.axis_equations import axis_model
from sgms_mhe.emission.axis_forms import TABLES, WrittenAxis, render_form
from sgms_mhe.machine import Machine
from sgms_mhe.model.simple import SimpleAxis
from sgms_mhe.support.arrays import Array, Index
from sgms_mhe.support.errors import InputError

SPEEDS: Final = 200
"""Of the law that a table is chosen by."""
USUAL: Final = 20
"""Points of a table where the form takes more."""
FIRST_STEP: Final = 1e-6
"""s."""
STEPS: Final = 50


@dataclass(frozen=True, kw_only=True)
class TabledAxis(SimpleAxis):
    """An axis with friction by its speed (p) [m/s] alone: `forwards` and `backwards` (p) [N], level beyond the ends."""

    speed: Array
    forwards: Array
    backwards: Array

    def friction(self, velocity: Array, force: Array, step: float) -> Array:
        """Return the friction (n) of the velocities (n); the force does not count."""
        forwards, backwards = (np.interp(abs(velocity), self.speed, f) for f in (self.forwards, self.backwards))
        return np.where(velocity > 0.0, forwards, np.where(velocity < 0.0, backwards, 0.0))


def write_table(
    machine: Machine, title: str, form: str, points: int | None = None, speed_range: tuple[float, float] | None = None
) -> WrittenAxis:
    """Write friction over speed as straight lines between few points, at the speeds where they lose least.

    Args:
        machine: whose axis it is.
        title: unused: the form names no model.
        form: one of `TABLES`.
        points: of each direction; None: as many as the form takes.
        speed_range: slowest and fastest point [m/s]; None: v_s / 10 to max_velocity.

    Raises:
        InputError: more points than the form takes, or a range that is none.
    """
    units, friction, most = machine.plant.units, machine.friction, TABLES[form]
    slow, fast = speed_range or (0.1 * friction.stribeck_velocity, machine.sampling.max_velocity)
    if not 0.0 < slow < fast:
        raise InputError("export", "range", f"{slow:g} {fast:g}", "two speeds above 0, the slower one first")
    if points is not None and not 2 <= points <= most:
        raise InputError("export", "points", points, f"2 to {most} for {form}")
    inside = tuple(effect for effect in machine.effects if _hangs_on_velocity_alone(machine, effect.label))
    speed = np.geomspace(slow, fast, SPEEDS)
    law = np.array([steady_friction(replace(machine, effects=inside), side * speed) for side in (1.0, -1.0)])
    curves = law if form == "csv" else 0.5 * (law[:1] - law[1:])  # drives turn the sign with that of the speed
    knots = speed[choose_knots(speed, curves, points or min(most, USUAL))]
    lines = np.array([np.interp(speed, knots, row) for row in np.eye(len(knots))]).T
    heights = np.linalg.lstsq(lines, curves.T, rcond=None)[0].T
    forwards, backwards = (heights[0], heights[1]) if form == "csv" else (heights[0], -heights[0])
    table = TabledAxis(machine.plant.moved, 0.0, 0.0, speed=knots, forwards=forwards, backwards=backwards)
    off = np.array([table.friction(side * speed, speed, 0.0) for side in (1.0, -1.0)]) - law
    loss, size = (float(np.sqrt(np.mean(values**2))) for values in (off, law))
    label = ", ".join(effect.label for effect in inside)
    holds = [f"steady friction over speed{f' with the effects {label}' if label else ''}, {len(knots)} points"]
    left_out = tuple(effect.label for effect in machine.effects if effect not in inside)
    lost = [
        f"between the points {loss:.3g} {units.force} rms, {100.0 * loss / size:.2g} % of the friction, "
        f"{abs(off).max():.3g} {units.force} at most, from {slow:g} to {fast:g} {units.velocity}",
        f"the {friction.n_z} Maxwell-slip elements: stiffness and hysteresis at a reversal",
    ]
    if form != "csv" and not np.allclose(law[0], -law[1], rtol=1e-6):
        lost.append("what the two directions differ by: the table is their mean")
    if left_out:
        lost.append(f"the effects {', '.join(left_out)}")
    written = WrittenAxis(form, b"", tuple(holds), tuple(lost), table, left_out)
    return render_form(machine, f"{form}.txt" if form != "csv" else "friction.csv", title, written, table=table)


def _hangs_on_velocity_alone(machine: Machine, label: str) -> bool:
    """Return True if an effect moves the axis and reads nothing of the signals but its velocity."""
    effects = tuple(effect for effect in machine.effects if effect.label == label)
    axis = axis_model(replace(machine, effects=effects))
    others = ca.vertcat(*(axis.model.w[i] for i in (0, 2, 3, 4)))
    return not axis.left_out and not ca.depends_on(ca.vertcat(axis.model.rhs, axis.model.output), others)


def steady_friction(machine: Machine, velocity: Array) -> Array:
    """Return the friction (n) at constant velocities (n), when all deflections have come to rest.

    From rest by implicit Euler steps, each twice as long as the one before: the first ones follow the motion, the last
    ones solve for where it ends.
    """
    model = axis_model(machine).model
    states = [model.chi, model.w, model.theta]
    rates = ca.Function("rates", states, [model.rhs, ca.jacobian(model.rhs, model.chi)])
    output = ca.Function("friction", states, [model.output])
    nominal = [parameter.nominal for parameter in model.parameters]
    chi, w = np.zeros((model.n_x, len(velocity))), np.zeros((len(model.signal_names), len(velocity)))
    w[1] = velocity
    for step in FIRST_STEP * 2.0 ** np.arange(STEPS):
        rate, slope = (np.array(value) for value in rates(chi, w, nominal))  # slopes side by side, as the speeds
        slopes = slope.reshape(model.n_x, len(velocity), model.n_x).swapaxes(0, 1)
        chi = chi + np.linalg.solve(np.eye(model.n_x) / step - slopes, rate.T[..., None])[..., 0].T
    return np.array(output(chi, w, nominal)).ravel()


def choose_knots(speed: Array, curves: Array, points: int) -> Index:
    """Choose which samples (p) of curves (k, n) over speed (n) to join by straight lines, the squares of errors least.

    Dynamic programming over the last point and their number; the first and the last sample are among them.
    """
    n = len(speed)
    cost = np.full((n, n), np.inf)
    for i in range(n - 1):
        ahead, rise = speed[i + 1 :] - speed[i], curves[:, i + 1 :] - curves[:, i, None]
        off = rise[:, None] - rise[:, :, None] * (ahead / ahead[:, None])  # of each sample, by where the chord ends
        cost[i, i + 1 :] = np.tril(off**2).sum(axis=(0, 2))
    least, before = cost[0], []
    for _ in range(points - 2):
        through = least[:, None] + cost
        before.append(through.argmin(axis=0))
        least = through.min(axis=0)
    knots = [n - 1]
    for best in reversed(before):
        knots.append(int(best[knots[-1]]))
    return np.array([0, *reversed(knots)])
