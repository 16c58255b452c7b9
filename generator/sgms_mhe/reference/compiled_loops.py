"""The loops of the integrator in C: `intervals.c` compiled with CasADi's functions."""

import ctypes
import os
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from importlib import resources
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np

from sgms_mhe.reference.blocks import Blocks
from sgms_mhe.reference.flow import DEGREE, NEAR
from sgms_mhe.reference.linearised import Linearised, Outputs
from sgms_mhe.reference.plan import BEFORE_TURN, Plan
from sgms_mhe.support.arrays import AnyArray, Array
from sgms_mhe.support.toolchain import QUICK_FLAGS, load_library, shared_library


class CompiledLoops:
    """The loops of one model, compiled. Making them raises BuildError where there is no compiler."""

    def __init__(self, blocks: Blocks, functions: Mapping[str, ca.Function]) -> None:
        self._model = blocks.model
        self._blocks = blocks
        self._functions = functions
        self._library = self._compile()

    def intervals(self, plan: Plan, first: int, x: Array, theta: Array) -> Linearised:
        """Integrate intervals first, first + 1, ... (0 leads from node 0) from the node states x (n, n_x)."""
        count, n_x, n_p = len(x), self._model.n_x, self._model.n_p
        offsets = (first + np.arange(count, dtype=np.int64)) * plan.steps
        x1, A, B = np.empty((count, n_x)), np.empty((count, n_x, n_x)), np.empty((count, n_p, n_x))
        x, theta = np.ascontiguousarray(x), np.ascontiguousarray(theta)
        inside, inner_w = (count, plan.readings - 1), plan.inner_w[first : first + count]
        inner = Outputs(np.empty(inside), np.empty((*inside, n_x)), np.empty((*inside, n_p)))
        function, packed = self._library.sgms_reference_intervals, self._packed_flow

        def run(part: slice) -> None:
            function(
                ctypes.c_longlong(len(x[part])),
                _pointer(offsets[part]),
                ctypes.c_longlong(plan.steps),
                ctypes.c_double(plan.h),
                *map(_pointer, (plan.start, plan.end, plan.substeps, plan.cut, plan.piece_substeps)),
                ctypes.c_longlong(plan.stairs),
                *map(_pointer, (plan.stair, plan.stair_substeps, plan.slide, packed)),
                *map(_pointer, (x[part], theta, x1[part], A[part], B[part], inner_w[part])),
                *(_pointer(array[part]) for array in inner),
            )

        # Intervals do not depend on each other, and ctypes lets other threads run meanwhile.
        pieces = min(count, os.cpu_count() or 1)
        edges = [count * i // pieces for i in range(pieces + 1)] if pieces else []
        list(self._threads.map(run, [slice(a, b) for a, b in pairwise(edges)]))
        # Column-major in C.
        return Linearised(x1, A.transpose(0, 2, 1), B.transpose(0, 2, 1), inner)

    def outputs(self, x: Array, w: Array, theta: Array) -> Outputs:
        """Output and its sensitivities at nodes: x (n, n_x), w (n, 5)."""
        count, n_x, n_p = len(x), self._model.n_x, self._model.n_p
        y, C, D = np.empty(count), np.empty((count, n_x)), np.empty((count, n_p))
        given = [np.ascontiguousarray(array) for array in (x, w, theta)]
        self._library.sgms_reference_outputs(ctypes.c_longlong(count), *map(_pointer, (*given, y, C, D)))
        return Outputs(y, C, D)

    @cached_property
    def _threads(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(os.cpu_count())

    @cached_property
    def _packed_flow(self) -> Array:
        return self._blocks.flow.pack() if any(block.saturates for block in self._blocks.all) else np.zeros(8)

    def _compile(self) -> ctypes.CDLL:
        functions = self._functions
        with tempfile.TemporaryDirectory() as folder:
            generator = ca.CodeGenerator("reference", {"with_header": False})
            for function in functions.values():
                generator.add(function)
            driver = resources.files(__package__).joinpath("intervals.c").read_text()
            source = Path(folder) / "sgms_mhe_reference.c"
            source.write_text(generator.dump() + self._constants() + driver)
            path = shared_library([source], flags=QUICK_FLAGS, libraries=["m"])
        library = load_library(path)
        library.sgms_reference_intervals.restype = None
        library.sgms_reference_outputs.restype = None
        return library

    def _constants(self) -> str:
        """Return the constants that intervals.c expects before it."""
        functions, blocks = self._functions.values(), self._blocks.all
        smoothing = self._model.machine.friction.smoothing

        def largest(size: Callable[[ca.Function], int]) -> int:
            return max(1, *(size(function) for function in functions))

        def array(declaration: str, entries: list[str]) -> str:
            return f"static {declaration}[] = {{{', '.join(entries)}}};"

        numbers = {
            "N_X": self._model.n_x,
            "N_W": self._model.w.numel(),
            "N_P": self._model.n_p,
            "N_BLOCKS": len(blocks),
            "LARGEST_BLOCK": max(len(block.states) for block in blocks),
            "N_CHEBYSHEV": DEGREE + 1,
            "N_READINGS": self._model.machine.sampling.readings_per_update,
            "BEFORE_TURN": BEFORE_TURN,
            "NEAR": NEAR / smoothing.lambda_ if smoothing else 0.0,
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
            array("const step_function STEP", ["0" if k.switches else f"step_{b}" for b, k in enumerate(blocks)]),
            array("const step_function CLIP", [f"clip_{b}" if k.switches else "0" for b, k in enumerate(blocks)]),
            array("const step_function FLOW", [f"flow_{b}" if k.saturates else "0" for b, k in enumerate(blocks)]),
            array("const step_function RATE", [f"rate_{b}" if k.slides else "0" for b, k in enumerate(blocks)]),
        ]
        return "\n".join(["", *lines, ""])


def _pointer(array: AnyArray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)
