"""The same estimation problem by CasADi's own C export, to be timed beside the emitted estimator.

What is exported is the residual F and the Jacobian J of a full window: defects x_{k+1} - f(x_k, theta) of N intervals
and h(x_k, theta) - y_k of N + 1 nodes, f by a fixed number of classical Runge-Kutta steps through the samples. Neither
weights nor arrival cost nor the solution are part of it. Two ways, as CasADi's users write it:

    whole        one function: a fold of the step over the interval, mapped over the intervals, J by CasADi's coloured
                 forward mode
    propagated   the step with its sensitivities (forward mode, sparse), called by a loop in C
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from sgms_bench import C_DIR
from sgms_mhe.configuration import override_machine
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.support.toolchain import DEFAULT_FLAGS, program

Array = NDArray[np.float64]
Kind = Literal["propagated", "whole"]
KINDS: Final[tuple[Kind, ...]] = ("propagated", "whole")


@dataclass(frozen=True)
class Windows:
    """Full windows of a record, n of them with N intervals of M samples.

    Attributes:
        x: node states (n, N + 1, n_x).
        theta: scaled parameters (n_p).
        w: signals at the samples of each interval, without its first node (n, N, M, 5).
        w_node: signals at the nodes (n, N + 1, 5).
        y: measured friction at the nodes [N] (n, N + 1).
    """

    x: Array
    theta: Array
    w: Array
    w_node: Array
    y: Array


@dataclass(frozen=True)
class PeerEvaluation:
    """F and J of n windows.

    Attributes:
        x1: end of each interval (n, N, n_x), its defect taken from the node that follows.
        A: dx1/dx0 (n, N, n_x, n_x).
        B: dx1/dtheta (n, N, n_x, n_p).
        residual: h - y of each node [N] (n, N + 1).
        C: its derivatives in the node (n, N + 1, n_x).
        D: its derivatives in theta (n, N + 1, n_p).
    """

    x1: Array
    A: Array
    B: Array
    residual: Array
    C: Array
    D: Array


class PeerExport:
    """CasADi's export of a machine's problem, compiled as a program.

    Args:
        machine: whose model it is; its own integrator is not used.
        kind: how F and J are formed.
        intervals: N of a window.
        steps: Runge-Kutta steps per interval, a multiple or a divisor of its samples.
        flags: of the compiler.

    Raises:
        InputError: `steps` does not fit the samples.
        BuildError: the compiler refused.
    """

    def __init__(
        self, machine: Machine, kind: Kind, intervals: int, steps: int, flags: Sequence[str] = DEFAULT_FLAGS
    ) -> None:
        fixed = {"scheme": "rk4", "substeps": steps}
        self.kind, self.intervals, self.steps = kind, intervals, steps
        self._model = build_model(override_machine(machine, {"sampling": {"integrator": fixed}}))
        step = self._step()
        self._functions = self._whole(step) if kind == "whole" else self._propagate(step)
        generator = ca.CodeGenerator("peer", {"with_header": False})
        for function in self._functions.values():
            generator.add(function)
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "peer.c"
            driver = (C_DIR / "peer.c").read_text(encoding="utf-8")
            # The driver goes by POSIX time, which has to be asked for before the first header.
            head = "#define _POSIX_C_SOURCE 199309L\n"
            source.write_text(head + generator.dump() + self._constants() + driver, encoding="utf-8")
            self.program = program([source], flags=flags, libraries=["m"])

    # --- what is exported ------------------------------------------------------------------------------------------

    def _step(self) -> ca.Function:
        """One Runge-Kutta step: (chi, w, theta) to chi1, signals held."""
        model = self._model
        h = model.machine.sampling.step * model.machine.sampling.samples_per_update / self.steps
        rhs = model.function("rhs")
        chi, w, theta = model.chi, model.w, model.theta
        k1 = rhs(chi, w, theta)
        k2 = rhs(chi + h / 2 * k1, w, theta)
        k3 = rhs(chi + h / 2 * k2, w, theta)
        k4 = rhs(chi + h * k3, w, theta)
        return ca.Function("step", [chi, w, theta], [chi + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)], {"cse": True})

    def _output(self) -> ca.SX:
        return ca.substitute(self._model.output, self._model.chi, self._model.from_node)

    def _whole(self, step: ca.Function) -> dict[str, ca.Function]:
        model, count, steps = self._model, self.intervals, self.steps
        x, p, w = ca.MX.sym("x", model.n_x), ca.MX.sym("p", model.n_p), ca.MX.sym("w", model.w.numel(), steps)
        end = step.fold(steps)(model.function("from_node")(x, p), w, ca.repmat(p, 1, steps))
        interval = ca.Function("interval", [x, w, p], [model.function("to_node")(end, p)])
        measure = ca.Function("measure", [model.x, model.w, model.theta], [self._output()])
        variables = ca.MX.sym("variables", model.n_x * (count + 1) + model.n_p)
        nodes = ca.reshape(variables[: model.n_x * (count + 1)], model.n_x, count + 1)
        theta = variables[model.n_x * (count + 1) :]
        n_w = model.w.numel()
        signals, at_nodes = ca.MX.sym("w", n_w, steps * count), ca.MX.sym("w_node", n_w, count + 1)
        y = ca.MX.sym("y", 1, count + 1)
        ends = interval.map("intervals", "serial", count, [2], [])(nodes[:, :count], signals, theta)
        outputs = measure.map("measures", "serial", count + 1, [2], [])(nodes, at_nodes, theta)
        residual = ca.vertcat(ca.vec(nodes[:, 1:] - ends), ca.vec(outputs - y))
        return {
            "whole": ca.Function(
                "whole", [variables, signals, at_nodes, y], [residual, ca.jacobian(residual, variables)]
            )
        }

    def _propagate(self, step: ca.Function) -> dict[str, ca.Function]:
        model = self._model
        chi, x, w, theta = model.chi, model.x, model.w, model.theta
        after = step(chi, w, theta)
        by_chi, by_theta = ca.jacobian(after, chi), ca.jacobian(after, theta)
        begin = [model.from_node, ca.jacobian(model.from_node, x), ca.jacobian(model.from_node, theta)]
        # Patterns that the step maps into themselves: products of sparse Jacobians fill in until they do.
        a, b = ca.DM(begin[1].sparsity(), 1.0), ca.DM(begin[2].sparsity(), 1.0)
        jacobian = ca.DM(by_chi.sparsity(), 1.0)
        for _ in range(model.n_x):
            a, b = a + jacobian @ a, b + jacobian @ b + ca.DM(by_theta.sparsity(), 1.0)
        s_x, s_p = ca.SX.sym("s_x", a.sparsity()), ca.SX.sym("s_p", b.sparsity())
        to_node = model.to_node
        scale, shift = ca.jacobian(to_node, chi), ca.jacobian(to_node, theta)
        following = ca.SX.sym("following", model.n_x)
        y = ca.SX.sym("y")
        output = self._output()
        options = {"cse": True}
        return {
            "begin": ca.Function("begin", [x, theta], [begin[0], *_as((begin[1], a), (begin[2], b))], options),
            "step": ca.Function(
                "step",
                [chi, s_x, s_p, w, theta],
                [after, *_as((by_chi @ s_x, a), (by_chi @ s_p + by_theta, b))],
                options,
            ),
            "finish": ca.Function(
                "finish",
                [chi, s_x, s_p, theta, following],
                [following - to_node, scale @ s_x, scale @ s_p + shift],
                options,
            ),
            "measure": ca.Function(
                "measure", [x, w, theta, y], [output - y, ca.jacobian(output, x), ca.jacobian(output, theta)], options
            ),
        }

    def _constants(self) -> str:
        functions = self._functions
        numbers = {
            "PEER_SIGNALS": self._model.w.numel(),
            "PEER_X": self._model.n_x,
            "PEER_P": self._model.n_p,
            "PEER_INTERVALS": self.intervals,
            "PEER_STEPS": self.steps,
            "PEER_WHOLE": int(self.kind == "whole"),
            "PEER_ARG": max(f.sz_arg() for f in functions.values()),
            "PEER_RES": max(f.sz_res() for f in functions.values()),
            "PEER_IW": max(f.sz_iw() for f in functions.values()),
            "PEER_W": max(f.sz_w() for f in functions.values()),
        }
        if self.kind == "whole":
            numbers["PEER_JACOBIAN"] = functions["whole"].nnz_out(1)
        else:
            numbers |= {"PEER_A": functions["finish"].nnz_out(1), "PEER_B": functions["finish"].nnz_out(2)}
            numbers |= {"PEER_C": functions["measure"].nnz_out(1), "PEER_D": functions["measure"].nnz_out(2)}
        return "".join(f"#define {name} {value}\n" for name, value in numbers.items())

    # --- data in and out -------------------------------------------------------------------------------------------

    def problems(self, windows: Windows) -> bytes:
        """Return the input of the program: its windows as doubles."""
        count, _, samples, _ = windows.w.shape
        w = windows.w
        if self.steps >= samples:
            w = np.repeat(w, self.steps // samples, axis=2)
        else:
            # Merged samples: one step with their mean signals.
            w = w.reshape(count, self.intervals, self.steps, samples // self.steps, -1).mean(axis=3)
        theta = np.broadcast_to(windows.theta, (count, self._model.n_p))
        parts = (windows.x, theta, w, windows.w_node, windows.y)
        return np.hstack([part.reshape(count, -1) for part in parts]).tobytes()

    def evaluation(self, windows: Windows, results: bytes) -> PeerEvaluation:
        """Return the output of the program for these windows."""
        n_x, n_p, intervals = self._model.n_x, self._model.n_p, self.intervals
        count, nodes = len(windows.x), intervals + 1
        rows = np.frombuffer(results).reshape(count, -1)
        defect, residual, rest = np.split(rows, np.cumsum([intervals * n_x, nodes]), axis=1)
        x1 = windows.x[:, 1:] - defect.reshape(count, intervals, n_x)
        if self.kind == "whole":
            jacobian = _dense(self._functions["whole"].sparsity_out(1), rest)
            by_x = jacobian[:, :, : nodes * n_x].reshape(count, -1, nodes, n_x)
            by_theta = jacobian[:, :, nodes * n_x :]
            defects = by_x[:, : intervals * n_x].reshape(count, intervals, n_x, nodes, n_x)
            k, j = np.arange(intervals), np.arange(nodes)
            return PeerEvaluation(
                x1=x1,
                A=-defects[:, k, :, k].transpose(1, 0, 2, 3),
                B=-by_theta[:, : intervals * n_x].reshape(count, intervals, n_x, n_p),
                residual=residual,
                C=by_x[:, intervals * n_x :][:, j, j],
                D=by_theta[:, intervals * n_x :],
            )
        patterns = [self._functions["finish"].sparsity_out(i) for i in (1, 2)]
        patterns += [self._functions["measure"].sparsity_out(i) for i in (1, 2)]
        copies = (intervals, intervals, nodes, nodes)
        edges = np.cumsum([n * pattern.nnz() for n, pattern in zip(copies, patterns, strict=True)])
        a, b, c, d = (
            _dense(pattern, part.reshape(count, n, pattern.nnz()))
            for pattern, part, n in zip(patterns, np.split(rest, edges[:-1], axis=1), copies, strict=True)
        )
        return PeerEvaluation(x1, a, b, residual, c[:, :, 0], d[:, :, 0])


def _as(*pairs: tuple[ca.SX, ca.DM]) -> list[ca.SX]:
    """Expressions on wider patterns."""
    return [ca.project(expression, pattern.sparsity()) for expression, pattern in pairs]


def _dense(pattern: ca.Sparsity, nonzeros: Array) -> Array:
    """Matrices (..., rows, columns) of a pattern from their nonzeros (..., nnz)."""
    rows, columns = pattern.get_triplet()
    full = np.zeros((*nonzeros.shape[:-1], *pattern.shape))
    full[..., rows, columns] = nonzeros
    return full
