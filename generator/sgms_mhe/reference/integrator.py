"""Shooting intervals with sensitivities, by CasADi's differentiation of the discretised steps (docs/integration.md).

One step function per block of the model and its Jacobians come from CasADi; composing them by the chain rule over
substeps, samples and the node maps gives x1 = f(x, theta), A = df/dx and B = df/dtheta of one interval. The loops
run in compiled C around CasADi's generated functions, or in Python where there is no compiler; both read the same plan.
"""

from sgms_mhe.model import Model
from sgms_mhe.reference.blocks import Blocks, IntegratedBlock
from sgms_mhe.reference.compiled_loops import CompiledLoops
from sgms_mhe.reference.flow import Flow
from sgms_mhe.reference.linearised import Linearised, Outputs
from sgms_mhe.reference.plan import Plan, Planner
from sgms_mhe.reference.python_loops import PythonLoops
from sgms_mhe.reference.step_functions import step_functions
from sgms_mhe.signals.chain import Signals
from sgms_mhe.support.arrays import Array
from sgms_mhe.support.errors import BuildError


class ReferenceIntegrator:
    """The integrator of one model. `compiled=False` runs it in Python."""

    def __init__(self, model: Model, *, compiled: bool = True) -> None:
        self.model = model
        self._blocks = Blocks(model)
        self._planner = Planner(self._blocks)
        self._loops = _loops(self._blocks, compiled)

    @property
    def blocks(self) -> tuple[IntegratedBlock, ...]:
        """The blocks of states integrated apart from each other."""
        return self._blocks.all

    @property
    def flow(self) -> Flow:
        """Tables of the displacement flow."""
        return self._blocks.flow

    def plan(self, signals: Signals, *, rounded: bool = False) -> Plan:
        """Steps and substeps of every complete interval of a record; `rounded`: as steps are kept in 24 bits."""
        return self._planner.plan(signals, rounded=rounded)

    def intervals(self, plan: Plan, first: int, x: Array, theta: Array) -> Linearised:
        """Integrate intervals first, first + 1, ... (0 leads from node 0) from the node states x (n, n_x)."""
        return self._loops.intervals(plan, first, x, theta)

    def outputs(self, x: Array, w: Array, theta: Array) -> Outputs:
        """Output and its sensitivities at nodes: x (n, n_x), w (n, 5)."""
        return self._loops.outputs(x, w, theta)


def _loops(blocks: Blocks, compiled: bool) -> CompiledLoops | PythonLoops:
    functions = step_functions(blocks)
    if compiled:
        try:
            return CompiledLoops(blocks, functions)
        except BuildError:
            pass  # without a compiler the same loops run in Python, many times slower
    return PythonLoops(blocks, functions)
