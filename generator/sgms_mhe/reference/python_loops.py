"""The loops of the integrator in Python, many times slower: where there is no compiler, and to check the compiled."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from sgms_mhe.reference.blocks import Blocks
from sgms_mhe.reference.flow import NEAR, relaxation
from sgms_mhe.reference.linearised import Linearised, Outputs
from sgms_mhe.reference.plan import BEFORE_TURN, Plan
from sgms_mhe.support.arrays import Array


class Moved(NamedTuple):
    """A block after a part of a step: chi (m,), and its derivatives in chi before it (m, m) and in theta (m, n_p)."""

    chi: Array
    by_chi: Array
    by_theta: Array


class _OnArrays:
    """A CasADi function of arrays, for one thread: its own call takes twenty times as long, to convert them."""

    def __init__(self, function: ca.Function) -> None:
        self._buffer, self._evaluate = function.buffer()
        self._given = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
        self._found = [np.zeros(function.numel_out(i)) for i in range(function.n_out())]
        self._shapes = [function.size_out(i) for i in range(function.n_out())]
        for place, array in enumerate(self._given):
            self._buffer.set_arg(place, array.data)  # type: ignore[call-arg]
        for place, array in enumerate(self._found):
            self._buffer.set_res(place, array.data)  # type: ignore[call-arg]

    def __call__(self, *given: Array | float) -> list[Array]:
        for array, value in zip(self._given, given, strict=True):
            array[:] = value
        self._evaluate()
        return [a.reshape(shape, order="F").copy() for a, shape in zip(self._found, self._shapes, strict=True)]


class PythonLoops:
    """The loops of one model around CasADi's functions."""

    def __init__(self, blocks: Blocks, functions: Mapping[str, ca.Function]) -> None:
        self._model = blocks.model
        self._blocks = blocks
        self._functions = {name: _OnArrays(function) for name, function in functions.items()}

    def intervals(self, plan: Plan, first: int, x: Array, theta: Array) -> Linearised:
        """Integrate intervals first, first + 1, ... (0 leads from node 0) from the node states x (n, n_x)."""
        n_x, n_p, readings = self._model.n_x, self._model.n_p, plan.readings
        ends = np.empty((len(x), n_x)), np.empty((len(x), n_x, n_x)), np.empty((len(x), n_x, n_p))
        inside = (len(x), readings - 1)
        inner = Outputs(np.empty(inside), np.empty((*inside, n_x)), np.empty((*inside, n_p)))
        for k, start in enumerate(x):
            *within, end = self._interval(plan, first + k, start, theta)
            for store, value in zip(ends, end, strict=True):
                store[k] = value
            for r, (x_r, A, B) in enumerate(within):
                y, C, D = self._functions["measure"](x_r, plan.inner_w[first + k, r], theta)
                for store, value in zip(inner, (y[0, 0], C @ A, C @ B + D), strict=True):
                    store[k, r] = value
        return Linearised(*ends, inner)

    def outputs(self, x: Array, w: Array, theta: Array) -> Outputs:
        """Output and its sensitivities at nodes: x (n, n_x), w (n, 5)."""
        count, n_x, n_p = len(x), self._model.n_x, self._model.n_p
        results = [self._functions["measure"](node, signal, theta) for node, signal in zip(x, w, strict=True)]
        y, C, D = (np.array(part) for part in zip(*results, strict=True))
        return Outputs(y.reshape(count), C.reshape(count, n_x), D.reshape(count, n_p))

    def _interval(self, plan: Plan, interval: int, x: Array, theta: Array) -> list[tuple[Array, Array, Array]]:
        """Node states, their sensitivities to x and theta, at the measurements of an interval, the last one its end."""
        n_x, n_p, functions = self._model.n_x, self._model.n_p, self._functions
        begin, F_x, F_t = functions["start"](x, theta)
        begin = begin.reshape(n_x)
        k0, spacing, readings = interval * plan.steps, plan.steps // plan.readings, plan.readings
        chi, phi, psi = np.empty((readings, n_x)), np.zeros((readings, n_x, n_x)), np.zeros((readings, n_x, n_p))
        for b, block in enumerate(self._blocks.all):
            states = list(block.states)
            c, p, t = begin[states], np.eye(len(states)), np.zeros((len(states), n_p))
            for k in range(plan.steps):
                for moved in self._step_of_block(plan, k0 + k, b, c, theta):
                    c, p, t = moved.chi, moved.by_chi @ p, moved.by_chi @ t + moved.by_theta
                if (k + 1) % spacing == 0:
                    r = (k + 1) // spacing - 1
                    chi[r, states], phi[r][np.ix_(states, states)], psi[r, states] = c, p, t
        reached = []
        for c, p, t in zip(chi, phi, psi, strict=True):
            x_r, T_x, T_t = functions["finish"](c, theta)
            reached.append((x_r.reshape(n_x), T_x @ p @ F_x, T_x @ (p @ F_t + t) + T_t))
        return reached

    def _step_of_block(self, plan: Plan, k: int, b: int, chi: Array, theta: Array) -> Iterator[Moved]:
        """One step of one block, in as many parts as it takes."""
        if self._blocks.all[b].switches:
            yield from self._clips(plan, k, b, chi, theta)
            return
        if self._blocks.all[b].slides and plan.slide[k, 0] != 0.0:
            moved = self._slid(plan.slide[k], float(chi[0]), *self._functions[f"rate_{b}"](theta))
            if moved is not None:
                yield moved
                return
        count = int(plan.substeps[k, b])
        if count > 0:
            yield from self._along(b, chi, plan.start[k], plan.end[k], theta, plan.h, count)
            return
        before, after = (int(count) for count in plan.piece_substeps[k, b])
        if before > 0:
            share = float(plan.cut[k])
            turn = plan.start[k] + (plan.end[k] - plan.start[k]) * share
            for moved in self._along(b, chi, plan.start[k], turn, theta, plan.h * share, before):
                chi = moved.chi
                yield moved
            yield from self._along(b, chi, turn, plan.end[k], theta, plan.h * (1.0 - share), after)
            return
        h = plan.h / plan.stairs
        for i in range(k * plan.stairs, (k + 1) * plan.stairs):
            w, count = plan.stair[i], int(plan.stair_substeps[i, b])
            parts: Iterable[Moved]
            if count > 0:
                parts = self._along(b, chi, w, w, theta, h, count)
            else:
                parts = [self._jump(self._functions[f"flow_{b}"](chi[1:], w, theta, h), chi)]
            for moved in parts:
                chi = moved.chi
                yield moved

    def _along(
        self, b: int, chi: Array, start: Array, end: Array, theta: Array, h: float, count: int
    ) -> Iterator[Moved]:
        """Runge-Kutta substeps with signals on the line from `start` to `end`."""
        for s in range(count):
            w0, w1 = start + (end - start) * (s / count), start + (end - start) * ((s + 1) / count)
            new, J, T = self._functions[f"step_{b}"](chi, w0, w1, theta, h / count)
            chi = new.reshape(len(chi))
            yield Moved(chi, J, T)

    def _clips(self, plan: Plan, k: int, b: int, chi: Array, theta: Array) -> Iterator[Moved]:
        """An element that switches through a step: at once, in two pieces where the velocity turns, or stair by stair.

        The level of a piece is that at its end, just before it where the velocity turns.
        """
        moves: list[tuple[Array, Array, float]] = []
        if self._blocks.all[b].at_once and plan.stairs > 1:
            start, change, share = plan.start[k], plan.end[k] - plan.start[k], float(plan.cut[k])
            for a, z in ((0.0, share), (share, 1.0)) if plan.substeps[k, b] == 0 else ((0.0, 1.0),):
                last = start + BEFORE_TURN * z * change if z < 1.0 else plan.end[k]
                moves.append((start + 0.5 * (a + z) * change, last, (z - a) * plan.h))
        else:
            stairs = plan.stair[k * plan.stairs : (k + 1) * plan.stairs]
            moves += [(w, w, plan.h / plan.stairs) for w in stairs]
        for w, last, h in moves:
            moved = _clip(self._functions[f"clip_{b}"](chi[1:], w, last, theta, h), chi)
            chi = moved.chi
            yield moved

    def _jump(self, drive: Sequence[Array], chi: Array) -> Moved:
        """chi = sign level r: the level's sensitivity enters through r0 and again through chi1."""
        level, xi = drive[0].item(), drive[1].item()
        dlevel, dxi, dend = drive[3:]
        sign = math.copysign(1.0, xi)
        r0 = sign * float(chi[0]) / level
        r1, slope, g1 = self._blocks.flow.advance(r0, abs(xi))
        change = sign * (r1 - slope * r0) * dlevel + level * g1 * dxi
        return _closed_form(sign * level * r1, slope, change[0], drive[2], dend)

    def _slid(self, slide: Array, chi: float, rate: Array, by_theta: Array) -> Moved | None:
        """A step an element slides through, at once; None where it is not near enough to the fixed point."""
        displacement, level, delta = (float(value) for value in slide)
        flow, rho = self._blocks.flow, rate.item()
        direction = math.copysign(1.0, displacement)
        r0 = direction * chi / level
        if not abs(r0 - flow.r_star) < NEAR / flow.smoothing.lambda_:
            return None
        xi = rho * abs(displacement) / level
        r1, slope, g1 = flow.advance(r0, xi)
        x = flow.k * xi
        phi, dphi = relaxation(x)
        lag = flow.r_star * delta * phi
        end = direction * (level * r1 + lag)
        by_chi = slope * math.exp(-flow.curvature * lag / (level * flow.k))
        by_rho = direction * (level * g1 * xi + flow.r_star * delta * x * dphi) / rho
        return Moved(np.array([end]), np.array([[by_chi]]), by_rho * by_theta)


def _clip(drive: Sequence[Array], chi: Array) -> Moved:
    """An element that sticks moves with the axis; one that the axis pushes beyond its level stays at the level."""
    level, move = drive[0].item(), drive[1].item()
    dlevel, dmove, dend = drive[3:]
    direction, end = math.copysign(1.0, move), float(chi[0]) + move
    slips = move != 0.0 and direction * end > level
    change = direction * dlevel[0] if slips else dmove[0]
    reached = direction * level if slips else end
    return _closed_form(reached, float(not slips), change, drive[2], dend)


def _closed_form(chi: float, slope: float, change: Array, end: Array, dend: Array) -> Moved:
    """An element at `chi`, its derivatives `slope` in itself and `change` in (the other states, theta).

    Those states set its level; they reach `end` with the Jacobian `dend` in (themselves, theta).
    """
    others = end.size
    J, T = np.zeros((others + 1, others + 1)), np.empty((others + 1, change.size - others))
    J[0, 0], J[0, 1:], J[1:, 1:] = slope, change[:others], dend[:, :others]
    T[0], T[1:] = change[others:], dend[:, others:]
    return Moved(np.concatenate([[chi], end.reshape(others)]), J, T)
