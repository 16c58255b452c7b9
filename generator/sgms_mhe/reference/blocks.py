"""Blocks of states that can be integrated apart from each other, and which of them take steps in closed form."""

import math
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order

from sgms_mhe.model import Model
from sgms_mhe.reference.flow import Flow, gate_ratio, window


@dataclass(frozen=True)
class IntegratedBlock:
    """States that depend on no state outside the block; blocks may share states that read none of the others.

    `saturates`: its first state is an element that obeys the law of equation (1), and the others set its level by
    linear equations of their own. `slides`: it is an element alone, its level depends on signals alone and its rho not
    on them, and the measured velocity moves it; looked for only where samples are merged.

    `switches`: its first state is an element that switches, and the others set its level by linear equations of their
    own. `at_once`: it is such an element alone, and its rho does not depend on the signals.
    """

    states: tuple[int, ...]
    rate_per_metre: float
    rate_per_second: float
    saturates: bool
    slides: bool
    switches: bool
    at_once: bool


class Blocks:
    """The blocks of one model, found from its expressions alone."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._sampling = model.machine.sampling
        self._smoothing = model.machine.friction.smoothing
        self._is_flow = self._sampling.integrator.scheme == "flow"

    @cached_property
    def gate_ratio(self) -> float:
        """|v|/v_s beyond which elements follow the displacement flow; inf for the Runge-Kutta schemes."""
        return gate_ratio(self._smoothing) if self._is_flow and self._smoothing else math.inf

    @property
    def reaches_flow(self) -> bool:
        """Return True if the gate saturates below max_velocity; otherwise Runge-Kutta serves every step."""
        return self.gate_ratio * self.model.machine.friction.stribeck_velocity < self._sampling.max_velocity

    @cached_property
    def flow(self) -> Flow:
        """Tables of the displacement flow."""
        return Flow.of(self.model.machine.friction.smoothed)

    @cached_property
    def all(self) -> tuple[IntegratedBlock, ...]:
        """Every state with all it depends on, directly or not; the largest such sets, in the order of first states."""
        model = self.model
        sparsity = ca.jacobian(model.rhs, model.chi).sparsity()
        rows, columns = sparsity.get_triplet()
        graph = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(model.n_x, model.n_x))
        closures = [set(breadth_first_order(graph, i, return_predecessors=False).tolist()) for i in range(model.n_x)]
        largest = {tuple(sorted(own)) for own in closures if not any(own < other for other in closures)}

        def block(states: tuple[int, ...]) -> IntegratedBlock:
            saturates = self.reaches_flow and self._obeys_law(states)
            switches = model.machine.friction.switches and model.states[states[0]].element is not None
            return IntegratedBlock(
                states=states,
                rate_per_metre=max(model.states[i].rate_per_metre for i in states),
                rate_per_second=max(model.states[i].rate_per_second for i in states),
                saturates=saturates,
                slides=saturates and self._sampling.merged > 1 and self._is_moved_alone(states),
                switches=switches,
                at_once=switches and len(states) == 1 and not ca.depends_on(model.rho[states[0]], model.w),
            )

        return tuple(block(states) for states in sorted(largest))

    def drive(self, i: int) -> ca.SX:
        """rho_i v of an element, with whatever velocity the model really uses: its rhs at zero deflection."""
        return ca.substitute(self.model.rhs[i], self.model.chi[i], 0)

    def _obeys_law(self, states: tuple[int, ...]) -> bool:
        """Return True if the first state is an element whose rhs is rho (v - eta |v| r), checked at random points.

        The others must be effects' states with linear rates of their own.
        """
        model, smoothing = self.model, self.model.machine.friction.smoothed
        i, others = states[0], list(states[1:])
        if model.states[i].element is None or any(model.states[j].element is not None for j in others):
            return False
        slopes = [ca.jacobian(model.rhs[j], model.chi) for j in others]
        for j, slope in zip(others, slopes, strict=True):
            if slope.sparsity().get_col() != [j] or ca.depends_on(slope, model.chi):
                return False
        function = ca.Function("law", [model.chi, model.w, model.theta], [model.rhs[i], self.drive(i), model.level])
        rng = np.random.default_rng(1)
        limit = self.gate_ratio * self.model.machine.friction.stribeck_velocity
        for _ in range(50):
            w = rng.standard_normal(self.model.w.numel())
            w[1] = math.copysign(limit * 10.0 ** rng.uniform(0.0, 3.0), w[1])
            theta = np.array([rng.uniform(max(p.lower, 0.9), min(p.upper, 1.1)) for p in model.parameters])
            chi = rng.uniform(-1.2, 1.2, model.n_x)
            chi[others] *= 0.1  # or a level might be negative
            rhs, drive, level = (float(value) for value in function(chi, w, theta))
            r = float(chi[i]) * math.copysign(1.0, drive) / level
            eta = float(window(r, smoothing)) if r > 0.0 else 0.0
            if not abs(rhs - (drive - eta * r * drive)) <= 1e-7 * abs(drive):
                return False
        return True

    def _is_moved_alone(self, states: tuple[int, ...]) -> bool:
        """Return True if a block obeys the law as an element alone, moved by rho(theta) times the measured velocity.

        Its level must be a function of signals alone. The drive is checked at random points.
        """
        model, i = self.model, states[0]
        if len(states) > 1 or ca.depends_on(model.level, ca.vertcat(model.chi, model.theta)):
            return False
        if ca.depends_on(model.rho[i], model.w):
            return False
        function = ca.Function("drive", [model.chi, model.w, model.theta], [self.drive(i), model.rho[i]])
        rng = np.random.default_rng(2)
        for _ in range(50):
            w, chi = rng.standard_normal(model.w.numel()), rng.uniform(-1.2, 1.2, model.n_x)
            theta = np.array([rng.uniform(max(p.lower, 0.9), min(p.upper, 1.1)) for p in model.parameters])
            drive, rho = (float(value) for value in function(chi, w, theta))
            if not abs(drive - rho * w[1]) <= 1e-12 * abs(rho * w[1]):
                return False
        return True
