"""Shooting intervals with sensitivities, by CasADi's differentiation of the discretised steps (DESIGN section 3).

One step function per block of the model and its Jacobians come from CasADi; composing them by the chain rule over
substeps, samples and the node maps gives x1 = f(x, theta), A = df/dx and B = df/dtheta of one interval. The loops
run in compiled C around CasADi's generated functions, or in Python where there is no compiler; both read the same plan.
"""

from __future__ import annotations

import ctypes
import math
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order

from sgms_mhe.model import Model
from sgms_mhe.reference.flow import DEGREE, NEAR, Flow, gate_ratio, relaxation, window
from sgms_mhe.signals.chain import Signals, signal_array
from sgms_mhe.support.errors import BuildError
from sgms_mhe.support.toolchain import load_library, shared_library

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]

# Largest lambda up to which a slow RK4 substep is as long as the settings say: the slip window is 1 / lambda wide.
WIDE_LAMBDA = 35.0

# Largest lambda |delta| / s_m with which an element that slides takes merged samples at once.
NEARLY_CONSTANT = 0.0175

# (c, a, b): stages f(y + h sum_j a_ij k_j) at c_i h, y1 = y + h sum_i b_i k_i.
TABLEAUS: dict[str, tuple[tuple[float, ...], tuple[tuple[float, ...], ...], tuple[float, ...]]] = {
    "euler": ((0.0,), ((),), (1.0,)),
    "rk2": ((0.0, 1 / 2), ((), (1 / 2,)), (0.0, 1.0)),
    "bs23": ((0.0, 1 / 2, 3 / 4), ((), (1 / 2,), (0.0, 3 / 4)), (2 / 9, 1 / 3, 4 / 9)),
    "rk4": (
        (0.0, 1 / 2, 1 / 2, 1.0),
        ((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)),
        (1 / 6, 1 / 3, 1 / 3, 1 / 6),
    ),
}


class Linearised(NamedTuple):
    """Intervals and their sensitivities: x1 (n, n_x), A (n, n_x, n_x), B (n, n_x, n_p)."""

    x1: Array
    A: Array
    B: Array


class Outputs(NamedTuple):
    """Outputs and their sensitivities: y [N] (n,), C (n, n_x), D (n, n_p)."""

    y: Array
    C: Array
    D: Array


class Moved(NamedTuple):
    """A block after a part of a step: chi (m,), and its derivatives in chi before it (m, m) and in theta (m, n_p)."""

    chi: Array
    by_chi: Array
    by_theta: Array


@dataclass(frozen=True)
class Block:
    """States that depend on no state outside the block; blocks may share states that read none of the others.

    `saturates`: its first state is an element that obeys the law of equation (1), and the others set its level by
    linear equations of their own. `slides`: it is an element alone, its level depends on signals alone and its rho not
    on them, and the measured velocity moves it; looked for only where samples are merged.
    """

    states: tuple[int, ...]
    rate_per_metre: float
    rate_per_second: float
    saturates: bool
    slides: bool


@dataclass(frozen=True)
class Plan:
    """Steps of a record, set by its signals alone.

    A step takes a block along the line from `start` to `end`, in two pieces where the velocity changes sign, or up K
    stairs of constant signals; an element that slides may take it at once. Where samples are not merged K is 1, and the
    stair has the signals of the step's end.

    Attributes:
        steps: steps per interval.
        h: duration of a step [s].
        start: signals w at the beginning of each step (intervals * steps, 5).
        end: signals w at its end; equal to `start` where velocity is constant.
        substeps: Runge-Kutta substeps along the line (intervals * steps, blocks); 0 are stairs.
        cut: share of the step before its velocity changes sign (intervals * steps); 0 where it does not.
        piece_substeps: Runge-Kutta substeps along the pieces before and after that (intervals * steps, blocks, 2);
            0 are stairs, or a step that is not cut.
        stairs: K, stairs of a step; each lasts h / K.
        stair: signals w of each stair (intervals * steps * K, 5).
        stair_substeps: Runge-Kutta substeps of each (intervals * steps * K, blocks); 0 is one jump of the displacement
            flow.
        slide: displacement [m], mean level s_m and delta of each step (intervals * steps, 3); zero where the signals do
            not let an element slide through it.
        path: sum |v_k| h of each interval [m].
        fastest: largest |v_k| of each interval [m/s].
    """

    steps: int
    h: float
    start: Array
    end: Array
    substeps: Counts
    cut: Array
    piece_substeps: Counts
    stairs: int
    stair: Array
    stair_substeps: Counts
    slide: Array
    path: Array
    fastest: Array


class Integrator:
    """The integrator of one model. `compiled=False` runs it in Python."""

    def __init__(self, model: Model, *, compiled: bool = True) -> None:
        self.model = model
        self._sampling = model.machine.sampling
        self._smoothing = model.machine.friction.smoothing
        self._is_flow = self._sampling.integrator.scheme == "flow"
        self._library: ctypes.CDLL | None = None
        if compiled:
            try:
                self._library = self._compile()
            except BuildError:
                # Without a compiler the same loops run in Python, many times slower.
                self._library = None

    # --- structure ---------------------------------------------------------------------------------------------

    @cached_property
    def gate_ratio(self) -> float:
        """|v|/v_s beyond which elements follow the displacement flow; inf for the Runge-Kutta schemes."""
        return gate_ratio(self._smoothing) if self._is_flow else math.inf

    @property
    def _reaches_flow(self) -> bool:
        """Whether the gate saturates below max_velocity; otherwise Runge-Kutta serves every step."""
        return self.gate_ratio * self.model.machine.friction.stribeck_velocity < self._sampling.max_velocity

    @cached_property
    def flow(self) -> Flow:
        """Tables of the displacement flow."""
        return Flow.of(self._smoothing)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Every state with all it depends on, directly or not; the largest such sets, in the order of first states."""
        model = self.model
        sparsity = ca.jacobian(model.rhs, model.chi).sparsity()
        rows, columns = sparsity.get_triplet()
        graph = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(model.n_x, model.n_x))
        closures = [set(breadth_first_order(graph, i, return_predecessors=False).tolist()) for i in range(model.n_x)]
        largest = {tuple(sorted(own)) for own in closures if not any(own < other for other in closures)}

        def block(states: tuple[int, ...]) -> Block:
            saturates = self._reaches_flow and self._obeys_law(states)
            return Block(
                states=states,
                rate_per_metre=max(model.states[i].rate_per_metre for i in states),
                rate_per_second=max(model.states[i].rate_per_second for i in states),
                saturates=saturates,
                slides=saturates and self._sampling.merged > 1 and self._is_moved_alone(states),
            )

        return tuple(block(states) for states in sorted(largest))

    def _drive(self, i: int) -> ca.SX:
        """rho_i v of an element, with whatever velocity the model really uses: its rhs at zero deflection."""
        return ca.substitute(self.model.rhs[i], self.model.chi[i], 0)

    def _obeys_law(self, states: tuple[int, ...]) -> bool:
        """Whether the first state is an element whose rhs is rho (v - eta |v| r), checked at random points.

        The others must be effects' states with linear rates of their own.
        """
        model = self.model
        i, others = states[0], list(states[1:])
        if model.states[i].element is None or any(model.states[j].element is not None for j in others):
            return False
        slopes = [ca.jacobian(model.rhs[j], model.chi) for j in others]
        for j, slope in zip(others, slopes, strict=True):
            if slope.sparsity().get_col() != [j] or ca.depends_on(slope, model.chi):
                return False
        function = ca.Function("law", [model.chi, model.w, model.theta], [model.rhs[i], self._drive(i), model.level])
        rng = np.random.default_rng(1)
        limit = self.gate_ratio * self.model.machine.friction.stribeck_velocity
        for _ in range(50):
            w = rng.standard_normal(5)
            w[1] = math.copysign(limit * 10.0 ** rng.uniform(0.0, 3.0), w[1])
            theta = np.array([rng.uniform(max(p.lower, 0.9), min(p.upper, 1.1)) for p in model.parameters])
            chi = rng.uniform(-1.2, 1.2, model.n_x)
            chi[others] *= 0.1  # or a level might be negative
            rhs, drive, level = (float(value) for value in function(chi, w, theta))
            r = float(chi[i]) * math.copysign(1.0, drive) / level
            eta = float(window(r, self._smoothing)) if r > 0.0 else 0.0
            if not abs(rhs - (drive - eta * r * drive)) <= 1e-7 * abs(drive):
                return False
        return True

    def _is_moved_alone(self, states: tuple[int, ...]) -> bool:
        """Whether a block that obeys the law is an element alone, moved by rho(theta) times the measured velocity.

        Its level must be a function of signals alone. The drive is checked at random points.
        """
        model, i = self.model, states[0]
        if len(states) > 1 or ca.depends_on(model.level, ca.vertcat(model.chi, model.theta)):
            return False
        if ca.depends_on(model.rho[i], model.w):
            return False
        function = ca.Function("drive", [model.chi, model.w, model.theta], [self._drive(i), model.rho[i]])
        rng = np.random.default_rng(2)
        for _ in range(50):
            w, chi = rng.standard_normal(5), rng.uniform(-1.2, 1.2, model.n_x)
            theta = np.array([rng.uniform(max(p.lower, 0.9), min(p.upper, 1.1)) for p in model.parameters])
            drive, rho = (float(value) for value in function(chi, w, theta))
            if not abs(drive - rho * w[1]) <= 1e-12 * abs(rho * w[1]):
                return False
        return True

    # --- plan --------------------------------------------------------------------------------------------------

    def plan(self, signals: Signals) -> Plan:
        """Steps and substeps of every complete interval of a record."""
        samples, h, stairs = self._sampling.samples_per_update, self._sampling.step, self._sampling.merged
        intervals = (len(signals) - 1) // samples
        w = signal_array(signals, h)[: intervals * samples + 1]
        if stairs == 1:
            stair = end = w[1:]
            start = w[:-1] if self._sampling.integrator.velocity == "linear" else end
            # Counts follow |v_k| alone, with linear velocity too.
            substeps = stair_substeps = self._held(np.abs(end[:, 1]), h)
            cut, piece_substeps = np.zeros(len(end)), np.zeros((len(end), len(self.blocks), 2), dtype=np.int64)
            slide = np.zeros((len(end), 3))
        else:
            # Lines by least squares through samples at the middles of their times: displacement is exact.
            tau = (2.0 * np.arange(stairs) + 1.0) / stairs - 1.0
            merged = w[1:].reshape(-1, stairs, w.shape[1])
            middle = merged.mean(axis=1)
            change = np.einsum("k,ski->si", tau, merged) / np.sum(tau * tau)
            start, end = middle - change, middle + change
            stair = (middle[:, None, :] + tau[:, None] * change[:, None, :]).reshape(-1, w.shape[1])
            reverses = np.abs(change[:, 1]) > np.abs(middle[:, 1])
            fast = np.abs(middle[:, 1]) - np.abs(change[:, 1]) > self._slow
            substeps = np.where(reverses[:, None], 0, self._along_lines(np.abs(middle[:, 1]), h * stairs, fast))
            cut = np.zeros(len(end))
            piece_substeps = np.zeros((len(end), len(self.blocks), 2), dtype=np.int64)
            before, after = np.abs(start[reverses, 1]), np.abs(end[reverses, 1])
            cut[reverses] = share = before / (before + after)
            pieces = np.stack(
                [
                    self._along_lines(0.5 * before, h * stairs * share, fast[reverses]),
                    self._along_lines(0.5 * after, h * stairs * (1.0 - share), fast[reverses]),
                ],
                axis=2,
            )
            piece_substeps[reverses] = np.where(np.any(pieces == 0, axis=2, keepdims=True), 0, pieces)
            stair_substeps = self._held(np.abs(stair[:, 1]), h)
            slide = self._slide(middle, change, h * stairs)
        velocities = np.abs(w[1:, 1]).reshape(intervals, samples)
        return Plan(
            steps=samples // stairs,
            h=h * stairs,
            start=np.ascontiguousarray(start),
            end=np.ascontiguousarray(end),
            substeps=substeps,
            cut=cut,
            piece_substeps=piece_substeps,
            stairs=stairs,
            stair=np.ascontiguousarray(stair),
            stair_substeps=stair_substeps,
            slide=slide,
            path=velocities.sum(axis=1) * h,
            fastest=velocities.max(axis=1, initial=0.0),
        )

    @property
    def _slow(self) -> float:
        """Speed up to which elements that follow the flow take Runge-Kutta steps [m/s]."""
        return self.gate_ratio * self.model.machine.friction.stribeck_velocity

    def _slow_substeps(self, block: Block, speed: Array | float, h: Array | float) -> Array:
        """RK4 substeps, not rounded, of an element that follows the flow, for a move at some speed over h."""
        settings = self._sampling.integrator
        longest = settings.slow_displacement * min(1.0, WIDE_LAMBDA / self._smoothing.lambda_)
        moved = np.asarray(speed) * h * block.rate_per_metre / longest
        return np.asarray(moved + h * block.rate_per_second / settings.displacement)

    def _runge_kutta_substeps(self, block: Block, speed: Array, h: Array | float, least: int) -> Counts:
        settings, limit = self._sampling.integrator, self._sampling.max_velocity

        def needed(v: Array) -> Counts:
            moved = (v * block.rate_per_metre + block.rate_per_second) * h
            return np.maximum(least, np.ceil(moved / settings.displacement)).astype(np.int64)

        most = needed(np.full_like(speed, limit))
        return np.asarray(np.minimum(needed(np.minimum(speed, 1e3 * limit)), most))

    def _held(self, speed: Array, h: float) -> Counts:
        """Substeps where signals are constant over h, 0 a jump of the flow (n, blocks)."""
        least = max(1, self._sampling.integrator.substeps // self._sampling.samples_per_update)
        counts = np.empty((len(speed), len(self.blocks)), dtype=np.int64)
        for b, block in enumerate(self.blocks):
            if block.saturates:
                slow = max(1, math.ceil(self._slow_substeps(block, self._slow, h)))
                counts[:, b] = np.where(speed > self._slow, 0, slow)
            else:
                counts[:, b] = self._runge_kutta_substeps(block, speed, h, least)
        return counts

    def _along_lines(self, speed: Array, h: Array | float, fast: Mask) -> Counts:
        """Substeps along lines of this mean speed and duration, 0 where stairs are less work (n, blocks).

        `fast`: the gate is saturated all along.
        """
        counts = np.empty((len(speed), len(self.blocks)), dtype=np.int64)
        for b, block in enumerate(self.blocks):
            if block.saturates:
                needed = np.maximum(1.0, np.ceil(self._slow_substeps(block, speed, h)))
                most = np.where(fast, max(1, self._sampling.merged // 2), self._sampling.merged - 1)
                counts[:, b] = np.where(needed <= most, needed, 0.0)
            else:
                counts[:, b] = self._runge_kutta_substeps(block, speed, h, 1)
        return counts

    def _slide(self, middle: Array, change: Array, h: float) -> Array:
        """Displacement, mean level and delta of the steps whose signals let elements slide, zeros elsewhere (n, 3)."""
        slide = np.zeros((len(middle), 3))
        fast = np.flatnonzero(np.abs(middle[:, 1]) - np.abs(change[:, 1]) > self._slow)
        if len(fast) == 0 or not any(block.slides for block in self.blocks):
            return slide
        middle, change = middle[fast], change[fast]
        v, v_s = middle[:, 1], change[:, 1]
        low, mid, high = (self._level(w) for w in (middle - change, middle, middle + change))
        # Simpson's rule over displacement, which runs from -1 to 1; the middle of the time is at `at_mid`.
        weight_low, weight_mid, weight_high = np.abs((v - v_s) / (6.0 * v)), 2.0 / 3.0, np.abs((v + v_s) / (6.0 * v))
        at_mid = -0.5 * v_s / v
        mean = 1.0 / (weight_low / low + weight_mid / mid + weight_high / high)
        delta = 3.0 * (weight_high * (high - mean) + weight_mid * at_mid * (mid - mean) - weight_low * (low - mean))
        constant = np.abs(delta) <= NEARLY_CONSTANT / self._smoothing.lambda_ * mean
        slide[fast[constant]] = np.column_stack([v * h, mean, delta])[constant]
        return slide

    def _level(self, w: Array) -> Array:
        """s~ of signals (n, 5), where it depends on nothing else."""
        function = ca.Function("level", [self.model.w], [self.model.level])
        return np.array(function(w.T)).reshape(len(w))

    # --- evaluation --------------------------------------------------------------------------------------------

    def intervals(self, plan: Plan, first: int, x: Array, theta: Array) -> Linearised:
        """Integrate intervals first, first + 1, ... (0 leads from node 0) from the node states x (n, n_x)."""
        count, n_x, n_p = len(x), self.model.n_x, self.model.n_p
        offsets = (first + np.arange(count, dtype=np.int64)) * plan.steps
        if self._library is None:
            results = [self._interval(plan, int(k), start, theta) for k, start in zip(offsets, x, strict=True)]
            return Linearised(*(np.array(part) for part in zip(*results, strict=True)))
        x1, A, B = np.empty((count, n_x)), np.empty((count, n_x, n_x)), np.empty((count, n_p, n_x))
        x, theta = np.ascontiguousarray(x), np.ascontiguousarray(theta)
        function, packed = self._library.sgms_reference_intervals, self._packed

        def run(part: slice) -> None:
            function(
                ctypes.c_longlong(len(x[part])),
                _pointer(offsets[part]),
                ctypes.c_longlong(plan.steps),
                ctypes.c_double(plan.h),
                _pointer(plan.start),
                _pointer(plan.end),
                _pointer(plan.substeps),
                _pointer(plan.cut),
                _pointer(plan.piece_substeps),
                ctypes.c_longlong(plan.stairs),
                _pointer(plan.stair),
                _pointer(plan.stair_substeps),
                _pointer(plan.slide),
                _pointer(packed),
                _pointer(x[part]),
                _pointer(theta),
                _pointer(x1[part]),
                _pointer(A[part]),
                _pointer(B[part]),
            )

        # Intervals do not depend on each other, and ctypes lets other threads run meanwhile.
        pieces = min(count, os.cpu_count() or 1)
        edges = [count * i // pieces for i in range(pieces + 1)] if pieces else []
        list(self._threads.map(run, [slice(a, b) for a, b in pairwise(edges)]))
        # Column-major in C.
        return Linearised(x1, A.transpose(0, 2, 1), B.transpose(0, 2, 1))

    def outputs(self, x: Array, w: Array, theta: Array) -> Outputs:
        """Output and its sensitivities at nodes: x (n, n_x), w (n, 5)."""
        count, n_x, n_p = len(x), self.model.n_x, self.model.n_p
        if self._library is None:
            results = [self._functions["measure"](node, signal, theta) for node, signal in zip(x, w, strict=True)]
            y, C, D = (np.array([np.array(row[i]) for row in results]) for i in range(3))
            return Outputs(y.reshape(count), C.reshape(count, n_x), D.reshape(count, n_p))
        y, C, D = np.empty(count), np.empty((count, n_x)), np.empty((count, n_p))
        self._library.sgms_reference_outputs(
            ctypes.c_longlong(count),
            _pointer(x := np.ascontiguousarray(x)),
            _pointer(w := np.ascontiguousarray(w)),
            _pointer(theta := np.ascontiguousarray(theta)),
            _pointer(y),
            _pointer(C),
            _pointer(D),
        )
        return Outputs(y, C, D)

    @cached_property
    def _threads(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(os.cpu_count())

    # --- functions ---------------------------------------------------------------------------------------------

    @cached_property
    def _packed(self) -> Array:
        return self.flow.packed() if any(block.saturates for block in self.blocks) else np.zeros(8)

    @cached_property
    def _functions(self) -> dict[str, ca.Function]:
        """CasADi functions with dense Jacobians: start, finish, measure, step_b, flow_b, rate_b."""
        model = self.model
        functions = {
            "start": _with_jacobians("start", [model.x, model.theta], model.from_node, (0, 1)),
            "finish": _with_jacobians("finish", [model.chi, model.theta], model.to_node, (0, 1)),
        }
        of_node = ca.substitute(model.output, model.chi, model.from_node)
        functions["measure"] = _with_jacobians("measure", [model.x, model.w, model.theta], of_node, (0, 2))
        for b, block in enumerate(self.blocks):
            functions[f"step_{b}"] = self._step(f"step_{b}", block)
            if block.saturates:
                functions[f"flow_{b}"] = self._flow_drive(f"flow_{b}", block)
            if block.slides:
                functions[f"rate_{b}"] = _with_jacobians(f"rate_{b}", [model.theta], model.rho[block.states[0]], (0,))
        return functions

    def _flow_drive(self, name: str, block: Block) -> ca.Function:
        """What drives a jump: (u, w, theta, h) to level, xi, u1 and their Jacobians in (u, theta).

        u (m - 1) are the states that set the level. With signals constant over h, du/dt = a + b u has the solution
        u1 = u e + a (e - 1) / b, e = exp(b h); the element sees the level at u1.
        """
        model = self.model
        others = list(block.states[1:])
        h = ca.SX.sym("h")
        u = ca.vertcat(*(model.chi[j] for j in others)) if others else ca.SX(0, 1)
        ends = []
        for j in others:
            b = ca.gradient(model.rhs[j], model.chi[j])
            a = ca.substitute(model.rhs[j], model.chi[j], 0)
            ends.append(model.chi[j] * ca.exp(b * h) + a * (ca.exp(b * h) - 1) / b)
        end = ca.vertcat(*ends) if others else ca.SX(0, 1)
        level = ca.substitute(model.level, u, end) if others else model.level
        xi = self._drive(block.states[0]) * h / level
        variables = ca.vertcat(u, model.theta)
        jacobians = [ca.densify(ca.jacobian(value, variables)) for value in (level, xi, end)]
        return ca.Function(name, [u, model.w, model.theta, h], [level, xi, ca.densify(end), *jacobians])

    def _step(self, name: str, block: Block) -> ca.Function:
        """One Runge-Kutta substep of a block: (chi, w at start, w at end, theta, h) to chi1 and its Jacobians."""
        model, states = self.model, list(block.states)
        scheme = "rk4" if self._is_flow else self._sampling.integrator.scheme
        chi = ca.vertcat(*(model.chi[i] for i in states))
        rhs = ca.Function("rhs", [chi, model.w, model.theta], [ca.vertcat(*(model.rhs[i] for i in states))])
        start, end, h = ca.SX.sym("w0", 5), ca.SX.sym("w1", 5), ca.SX.sym("h")
        linear = self._sampling.varies_in_step
        nodes, coefficients, weights = TABLEAUS[scheme]
        slopes: list[ca.SX] = []
        for c, row in zip(nodes, coefficients, strict=True):
            w = start + c * (end - start) if linear else end
            move = sum((a * k for a, k in zip(row, slopes, strict=True) if a != 0.0), ca.SX.zeros(len(states)))
            slopes.append(rhs(chi + h * move, w, model.theta))
        new = chi + h * sum((b * k for b, k in zip(weights, slopes, strict=True)), ca.SX.zeros(len(states)))
        return _with_jacobians(name, [chi, start, end, model.theta, h], new, (0, 3))

    # --- compiled ----------------------------------------------------------------------------------------------

    def _compile(self) -> ctypes.CDLL:
        functions = self._functions
        with tempfile.TemporaryDirectory() as folder:
            generator = ca.CodeGenerator("reference", {"with_header": False})
            for function in functions.values():
                generator.add(function)
            driver = resources.files(__package__).joinpath("intervals.c").read_text()
            source = Path(folder) / "sgms_mhe_reference.c"
            source.write_text(generator.dump() + self._constants() + driver)
            path = shared_library([source], libraries=["m"])
        library = load_library(path)
        library.sgms_reference_intervals.restype = None
        library.sgms_reference_outputs.restype = None
        return library

    def _constants(self) -> str:
        """What intervals.c expects to precede it."""
        functions, blocks = self._functions.values(), self.blocks

        def largest(size: Callable[[ca.Function], int]) -> int:
            return max(1, *(size(function) for function in functions))

        def array(declaration: str, entries: list[str]) -> str:
            return f"static {declaration}[] = {{{', '.join(entries)}}};"

        numbers = {
            "N_X": self.model.n_x,
            "N_P": self.model.n_p,
            "N_BLOCKS": len(blocks),
            "LARGEST_BLOCK": max(len(block.states) for block in blocks),
            "N_CHEBYSHEV": DEGREE + 1,
            "NEAR": NEAR / self._smoothing.lambda_,
            "SZ_ARG": largest(ca.Function.sz_arg),
            "SZ_RES": largest(ca.Function.sz_res),
            "SZ_IW": largest(ca.Function.sz_iw),
            "SZ_W": largest(ca.Function.sz_w),
            "START": "start",
            "FINISH": "finish",
            "MEASURE": "measure",
        }
        lines = [f"#define {name} {value}" for name, value in numbers.items()]
        lines += [
            "typedef int (*step_function)(const double **, double **, long long *, double *, int);",
            array("const long long BLOCK_SIZE", [str(len(block.states)) for block in blocks]),
            array("const long long BLOCK_STATES", [str(i) for block in blocks for i in block.states]),
            array("const step_function STEP", [f"step_{b}" for b in range(len(blocks))]),
            array("const step_function FLOW", [f"flow_{b}" if k.saturates else "0" for b, k in enumerate(blocks)]),
            array("const step_function RATE", [f"rate_{b}" if k.slides else "0" for b, k in enumerate(blocks)]),
        ]
        return "\n".join(["", *lines, ""])

    # --- the same loops in Python ------------------------------------------------------------------------------

    def _interval(self, plan: Plan, k0: int, x: Array, theta: Array) -> tuple[Array, Array, Array]:
        n_x, n_p, functions = self.model.n_x, self.model.n_p, self._functions
        chi, F_x, F_t = (np.array(part) for part in functions["start"](x, theta))
        chi = chi.reshape(n_x)
        phi, psi = np.zeros((n_x, n_x)), np.zeros((n_x, n_p))
        begin = chi.copy()
        for b, block in enumerate(self.blocks):
            states = list(block.states)
            c, p, t = begin[states], np.eye(len(states)), np.zeros((len(states), n_p))
            for k in range(k0, k0 + plan.steps):
                for moved in self._step_of_block(plan, k, b, c, theta):
                    c, p, t = moved.chi, moved.by_chi @ p, moved.by_chi @ t + moved.by_theta
            chi[states] = c
            phi[np.ix_(states, states)] = p
            psi[states] = t
        x1, T_x, T_t = (np.array(part) for part in functions["finish"](chi, theta))
        return x1.reshape(n_x), T_x @ phi @ F_x, T_x @ (phi @ F_t + psi) + T_t

    def _step_of_block(self, plan: Plan, k: int, b: int, chi: Array, theta: Array) -> Iterator[Moved]:
        """One step of one block, in as many parts as it takes."""
        if self.blocks[b].slides and plan.slide[k, 0] != 0.0:
            moved = self._slid(plan.slide[k], float(chi[0]), *self._functions[f"rate_{b}"].call([theta]))
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
                parts = [self._jumped(self._functions[f"flow_{b}"](chi[1:], w, theta, h), chi)]
            for moved in parts:
                chi = moved.chi
                yield moved

    def _along(
        self, b: int, chi: Array, start: Array, end: Array, theta: Array, h: float, count: int
    ) -> Iterator[Moved]:
        """Runge-Kutta substeps with signals on the line from `start` to `end`."""
        for s in range(count):
            w0, w1 = start + (end - start) * (s / count), start + (end - start) * ((s + 1) / count)
            new, J, T = (np.array(part) for part in self._functions[f"step_{b}"](chi, w0, w1, theta, h / count))
            chi = new.reshape(len(chi))
            yield Moved(chi, J, T)

    def _jumped(self, drive: tuple[ca.DM, ...], chi: Array) -> Moved:
        """chi = sign level r: the level's sensitivity enters through r0 and again through chi1."""
        level, xi = float(drive[0]), float(drive[1])
        dlevel, dxi, dend = (np.array(part) for part in drive[3:])
        others = len(chi) - 1
        sign = math.copysign(1.0, xi)
        r0 = sign * float(chi[0]) / level
        r1, slope, g1 = self.flow.advance(r0, abs(xi))
        change = sign * (r1 - slope * r0) * dlevel + level * g1 * dxi
        J, T = np.zeros((others + 1, others + 1)), np.zeros((others + 1, self.model.n_p))
        J[0, 0], J[0, 1:], J[1:, 1:] = slope, change[0, :others], dend[:, :others]
        T[0], T[1:] = change[0, others:], dend[:, others:]
        end = np.array(drive[2]).reshape(others)
        return Moved(np.concatenate([[sign * level * r1], end]), J, T)

    def _slid(self, slide: Array, chi: float, rate: ca.DM, by_theta: ca.DM) -> Moved | None:
        """A step that an element slides through, at once; None where it is not near enough to the fixed point."""
        displacement, level, delta = (float(value) for value in slide)
        flow, rho = self.flow, float(rate)
        direction = math.copysign(1.0, displacement)
        r0 = direction * chi / level
        if not abs(r0 - flow.r_star) < NEAR / self._smoothing.lambda_:
            return None
        xi = rho * abs(displacement) / level
        r1, slope, g1 = flow.advance(r0, xi)
        x = flow.k * xi
        phi, dphi = relaxation(x)
        lag = flow.r_star * delta * phi
        end = direction * (level * r1 + lag)
        by_chi = slope * math.exp(-flow.curvature * lag / (level * flow.k))
        by_rho = direction * (level * g1 * xi + flow.r_star * delta * x * dphi) / rho
        return Moved(np.array([end]), np.array([[by_chi]]), by_rho * np.array(by_theta))


def _with_jacobians(name: str, arguments: list[ca.SX], value: ca.SX, wanted: tuple[int, ...]) -> ca.Function:
    jacobians = [ca.densify(ca.jacobian(value, arguments[i])) for i in wanted]
    return ca.Function(name, arguments, [ca.densify(value), *jacobians], {"cse": True})


def _pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)
