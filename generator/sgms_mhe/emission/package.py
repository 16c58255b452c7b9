"""A machine's package: the emitted C, its runtime headers and the structure report, as text by file name."""

from __future__ import annotations

import bisect
import math
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import casadi as ca
import jinja2
import numpy as np

from sgms_mhe import __version__
from sgms_mhe.emission.c_source import CPrinter
from sgms_mhe.emission.graph import Graph, Node, operations, walk
from sgms_mhe.emission.provenance import digest_of_sources
from sgms_mhe.emission.selftest import selftest_vectors
from sgms_mhe.emission.structure import Group, Structure, analyse, report
from sgms_mhe.integration.flow_table import flow_table, gate_ratio
from sgms_mhe.integration.schemes import SCHEMES
from sgms_mhe.integration.work_precision import table_text
from sgms_mhe.machine import Machine
from sgms_mhe.model import SIGNAL_NAMES, Model, build_model
from sgms_mhe.model.friction import SATURATED
from sgms_mhe.signals.chain import chain_delay, lowpass_coefficients, settle_samples
from sgms_mhe.support.errors import InputError
from sgms_mhe.support.paths import runtime_dir, templates_dir

RUNTIME_VERSION = 1
RUNTIME_HEADERS = ("sgms_real.h", "sgms_math.h", "sgms_linalg.h", "sgms_filter.h")
FARTHEST = 5.0
"""Relative deflection that no element comes near: a level is reached at 1."""
IMPLAUSIBLE = 1e4
"""A state so many standard deviations of the first node's away from zero is no solution (DESIGN section 4)."""
MOVE = 0.3
"""How far the end of an interval may move before that, over sqrt(sigma_x / lambda)."""
STEP_COST_PER_ROW = 30
"""Multiplications, or so, of one step of the series for each of chi and its sensitivities."""
AHEAD_DISPLACEMENT = 0.05
"""Largest move per Runge-Kutta step of the propagation ahead, in deflection scales: no sensitivity hangs on it."""
LEVEL_CHANGE = 0.0175
"""Change of the level over merged samples, times lambda, up to which an element slides through them at once."""
AHEAD_SLOW_DISPLACEMENT = 0.01
"""The same per linearly implicit midpoint step, which an element takes below AHEAD_GATE."""
AHEAD_EQUAL = 4e-6
"""Slip, and relative deflections, that the propagation ahead may neglect."""
FARTHEST_MOVE = 10.0
"""An element that has moved on by so many deflection scales slides, wherever it was."""
SLOW_LAMBDA = 35.0
"""Largest lambda up to which `slow_displacement` holds as it stands: the slip window is 1 / lambda wide."""
VECTOR_BYTES = 32
"""Lanes are padded to vectors of this size, so that a compiler needs no scalar remainder loop."""


_EMPTY: Mapping[str, int] = MappingProxyType({})


@dataclass(frozen=True)
class Function:
    """Statements of one emitted function and a sentence that counts its operations."""

    lines: tuple[str, ...]
    counts: str


@dataclass(frozen=True)
class Package:
    """Emitted files by name."""

    machine: Machine
    files: Mapping[str, str]


def _count_text(nodes: Sequence[Node]) -> str:
    counts = operations(nodes)
    if not counts:
        return "No operations."
    return "Operations: " + ", ".join(f"{n} {op}" for op, n in sorted(counts.items())) + "."


class _Emitter:
    """Turns expressions of one model into C functions."""

    def __init__(self, model: Model, printer: CPrinter, terms: tuple[str, ...]) -> None:
        self.model = model
        self.printer = printer
        self.w_labels = list(SIGNAL_NAMES)
        self.theta_labels = [f"theta_{p.column}" for p in model.parameters]
        self.x_labels = [f"x_{s.name}" for s in model.states]
        self.terms = terms

    def function(
        self, outputs: Sequence[tuple[str, ca.SX]], *, inputs: Mapping[str, str], zeroed: Mapping[str, int] = _EMPTY
    ) -> Function:
        """Function of x, w, theta; `inputs` maps vector names ("x", "w", "theta") to C arrays.

        `zeroed` are output arrays and their lengths that are mostly zero: they are cleared, then the rest is set.
        """
        graph = Graph()
        vectors = {"x": self.model.x, "w": self.model.w, "theta": self.model.theta}
        labels = {"x": self.x_labels, "w": self.w_labels, "theta": self.theta_labels}
        nodes = graph.read(ca.vertcat(*(e for _, e in outputs)), vectors, labels)
        names = {
            graph.input(vector, label): f"{inputs[vector]}[{k}]"
            for vector, array in inputs.items()
            for k, label in enumerate(labels[vector])
        }
        zero = graph.constant(0.0)
        targets = [
            (target, node)
            for (target, _), node in zip(outputs, nodes, strict=True)
            if not (node is zero and target.split("[")[0] in zeroed)
        ]
        clear = [
            f"for (int i = 0; i < {n}; i++) {{\n        {a}[i] = {self.printer.number(0.0)};\n    }}"
            for a, n in zeroed.items()
        ]
        used = {node for node in walk(nodes) if node.op == "input"}
        unused = [
            f"(void){array};"
            for vector, array in inputs.items()
            if not any(graph.input(vector, label) in used for label in labels[vector])
        ]
        return Function(tuple(unused + clear + self.printer.statements(targets, names, {})), _count_text(nodes))

    def group_function(self, group: Group, outputs: Sequence[tuple[str, Node]], skip: Sequence[str] = ()) -> Function:
        """Function of a group's canonical inputs (chi, terms, q, data); `skip` names those it does not take."""
        nodes = [node for _, node in outputs]
        inputs = [node for node in walk(nodes) if node.op == "input"]
        names = {node: self._name(node) for node in inputs}
        used = set(names.values())
        unused = [
            f"(void){name};"
            for name in _group_arguments(group, self.terms)
            if name not in skip and not any(u == name or u.startswith(f"{name}[") for u in used)
        ]
        lines = unused + self.printer.statements(list(outputs), names, group.names)
        return Function(tuple(lines), _count_text(nodes))

    def _name(self, node: Node) -> str:
        """C name of a canonical input: chi0 -> chi0, term0 -> velocity, q0 -> q[0], data0 -> data[0]."""
        vector = next(iter(node.inputs))
        index = int(node.label[len("term" if vector == "terms" else vector) :])
        return {"chi": f"chi{index}", "terms": "", "q": f"q[{index}]", "data": f"data[{index}]"}[vector] or self.terms[
            index
        ]


def _group_arguments(group: Group, terms: Sequence[str]) -> list[str]:
    return [f"chi{i}" for i in range(group.m)] + [*terms, "q", "data"]


def emit_package(machine: Machine, model: Model | None = None, *, selftest: bool = True) -> Package:
    """Generate the C of a machine.

    Args:
        machine: the machine file.
        model: its symbolic model, where that is not what `build_model` makes of the machine.
        selftest: with the self-test vectors, for which the reference solver has to run.

    Raises:
        InputError: the machine asks for something that cannot be emitted; the message says what.
    """
    model = model or build_model(machine)
    if model.n_p == 0:
        raise InputError(machine.source, "estimator.parameters", [], "at least one parameter to estimate")
    structure = analyse(model)
    printer = CPrinter(machine.code.precision)
    emitter = _Emitter(model, printer, tuple(t.name for t in structure.sample_terms))
    context = _context(machine, model, structure, emitter)
    if selftest:
        context["vectors"] = selftest_vectors(model)
        context["templates"].append(("selftest.h.jinja", f"{machine.name}_selftest.h"))
    environment = _environment(machine.code.precision)
    files = {}
    for template, target in context["templates"]:
        files[target] = environment.get_template(template).render(context)
    for header in RUNTIME_HEADERS + (("sgms_flow.h",) if context["flow"] else ()):
        files[header] = (runtime_dir() / header).read_text(encoding="utf-8")
    files["structure.txt"] = report(structure)
    if machine.sampling.integrator.tolerance is not None:
        files["work_precision.txt"] = table_text(machine)
    return Package(machine, dict(sorted(files.items())))


@lru_cache(maxsize=2)
def _environment(precision: Literal["double", "single"]) -> jinja2.Environment:
    """Templates and what they call; compiled templates stay with it."""
    printer = CPrinter(precision)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(templates_dir()),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    environment.globals.update(
        num=printer.number,
        array=printer.array,
        body=_body,
        rows=lambda values: ", ".join(printer.number(v) for v in values),
    )
    return environment


def _body(function: Function) -> str:
    return "\n".join("    " + line for line in function.lines)


def _context(machine: Machine, model: Model, structure: Structure, emitter: _Emitter) -> dict[str, Any]:
    sampling, estimator = machine.sampling, machine.estimator
    integrator = sampling.integrator
    samples = sampling.samples_per_update
    substeps = integrator.substeps
    merged = sampling.merged
    read = _signals_read(model, structure)
    steps = samples // merged
    step_time = merged * sampling.step
    single = machine.code.precision == "single"
    horizon = estimator.horizon if estimator.kind == "mhe" else 0
    slots = max(1, horizon)
    vector = VECTOR_BYTES // (4 if single else 8)
    # The newest interval is integrated as it is sampled: only older ones need their series again, or lanes.
    relinearise = estimator.relinearise if slots > 1 else "newest"
    most_blocks = max(len(g.blocks) for g in structure.groups)
    n_blocks = sum(len(g.blocks) for g in structure.groups)
    chosen = max(2, n_blocks)  # blocks that an update linearises anew at most (DESIGN section 4)
    side_by_side = max(most_blocks, {"all": slots, "auto": chosen, "newest": 1}[relinearise])
    wide = -(-side_by_side // vector) * vector
    lanes = {"all": wide, "auto": slots, "newest": 1}[relinearise]
    ring = relinearise != "newest"
    linear = integrator.velocity == "linear"
    piece_time = sampling.step if merged > 1 else step_time
    nodes = 3 if sampling.varies_in_step else 1
    noise = estimator.noise
    fixed = estimator.arrival_cost.update == "fixed"
    # A factor of the sweep stays what it is while nothing before it changes.
    resume = horizon > 0 and relinearise != "all" and not fixed and model.output_is_affine
    scheme = SCHEMES["rk4" if integrator.scheme == "flow" else integrator.scheme]
    flow = integrator.scheme == "flow" and any(g.is_elements for g in structure.groups)
    law = element_law(machine)
    groups = [
        _group_context(
            g,
            structure,
            emitter,
            flow=flow and g.is_elements,
            law=law is not None and g.obeys_law,
            step_time=step_time,
            piece_time=piece_time,
            wide=wide,
        )
        for g in structure.groups
    ]
    first = first_q = 0
    for group in groups:
        group |= {"first": first, "first_q": first_q}
        first += group["n_blocks"]
        first_q += group["n_q"] * group["n_blocks"]
    block_states = [b.states for g in structure.groups for b in g.blocks]
    largest_block = max(len(states) for states in block_states)
    block_rows = [g.m * (1 + g.m + g.n_q) for g in structure.groups for _ in g.blocks]
    state_rows = sum(block_rows)
    n_q_total = sum(g.n_q * len(g.blocks) for g in structure.groups)
    q = [e for g in structure.groups for b in g.blocks for e in b.parameter_terms]
    scale = [_node_scale(model, i) for i in range(model.n_x)]
    couples = _couples(structure)
    coupled = max(len(row) for row in couples)
    theta = model.theta
    name = machine.name
    output = ca.substitute(model.output, model.chi, model.from_node)
    deflection = ca.substitute(model.deflection, model.chi, model.from_node)
    lower = [p.lower for p in model.parameters]
    upper = [p.upper for p in model.parameters]
    bounded = any(np.isfinite(lower)) or any(np.isfinite(upper))
    largest = 1e30 if single else 1e300
    context: dict[str, Any] = {
        "banner": f"Generated by sgms-mhe {__version__} from machine {machine.digest[:12]} "
        f"with sources {digest_of_sources()}. Do not edit: run sgms-mhe generate.",
        "name": name,
        "NAME": name.upper(),
        "description": (machine.description or f"Friction observer {name}").replace("*/", "* /"),
        "runtime_version": RUNTIME_VERSION,
        "single": int(single),
        "real": emitter.printer.real,
        "n_x": model.n_x,
        "n_z": model.n_z,
        "n_p": model.n_p,
        "horizon": horizon,
        "slots": slots,
        "lanes": lanes,
        "wide": wide,
        "vector": vector,
        "law": law if any(g["law"] for g in groups) else None,
        "relinearise": relinearise,
        "chosen": chosen,
        "most_blocks": most_blocks,
        "resume": resume,
        "start_size": (model.n_x + model.n_p) * (model.n_x + model.n_p + 3) // 2,
        "start_rows": [i * (2 * (model.n_x + model.n_p) + 3 - i) // 2 for i in range(model.n_x + model.n_p)],
        "drift_interval": estimator.drift_interval,
        "block_sizes": [len(states) for states in block_states],
        "block_states": [
            "{" + ", ".join(str(i) for i in [*states, *[states[-1]] * (largest_block - len(states))]) + "}"
            for states in block_states
        ],
        "largest_block": largest_block,
        "ring": ring,
        "nodes": nodes,
        "term_rows": nodes * (steps if ring else 1),
        "varying": nodes > 1,
        "raw_rows": [
            (SIGNAL_NAMES.index(t.name), k) for k, t in enumerate(structure.sample_terms) if t.name in SIGNAL_NAMES
        ],
        "slope_weights": 3.0 / (merged * merged - 1.0) * (2.0 * np.arange(merged) + 1.0 - merged) if merged > 1 else [],
        "signal_names": SIGNAL_NAMES,
        "read": read,
        "chain": " + ".join(f"SGMS_{s.upper()}" for s in ("position", "force", "acceleration") if s in read) or "0",
        "piece_time": piece_time,
        "samples": samples,
        "merged": merged,
        "merge": merged > 1,
        "steps": steps,
        "n_terms": len(structure.sample_terms),
        "term_names": [t.name for t in structure.sample_terms],
        "state_rows": state_rows,
        "one_size": sum(g["one_rows"] for g in groups) * wide,
        "costs": _costs(model, relinearise, slots, steps, samples, stairs=merged, rows=state_rows, batches=1),
        "scalar_costs": _costs(
            model, relinearise, slots, steps, samples, stairs=merged, rows=max(block_rows), batches=chosen
        ),
        "n_blocks": n_blocks,
        "n_q_total": n_q_total,
        "settle": settle_samples(machine),
        "rate": sampling.rate,
        "rate_text": f"{sampling.rate:g}",
        "sample_time": 1.0 / sampling.rate,
        "step_time": step_time,
        "interval_ms": f"{1e3 / sampling.update_rate:g}",
        "mass": machine.plant.mass,
        "max_velocity": sampling.max_velocity,
        "hold_path": hold_path(machine),
        "inverse_measurement": 1.0 / noise.measurement,
        "prior_sd": noise.parameter,
        "implausible": IMPLAUSIBLE,
        "drift_sd": noise.parameter_drift if not (fixed and horizon) else 0.0,
        "bounded": bounded,
        "lower": [max(v, -largest) for v in lower],
        "upper": [min(v, largest) for v in upper],
        "inverse_state_noise": 1.0 / model.state_noise,
        "inverse_move": np.sqrt(model.state_noise * machine.friction.smoothing.lambda_) / MOVE,
        "inverse_initial_state": 1.0 / model.initial_state,
        "inverse_arrival_state": 1.0 / model.state_noise,
        "fixed": fixed,
        "lowpass": lowpass_coefficients(machine),
        "linear": linear,
        "flow": flow,
        "scheme": scheme
        if not flow
        else scheme.with_text("displacement flow, Runge-Kutta (rk4) where it does not apply"),
        "base_substeps": max(1, substeps // samples),
        "groups": groups,
        "reach": [max(max(row) for row in couples[: c + 1]) + 1 for c in range(model.n_x)],
        "coupled": [len(row) for row in couples],
        "couples": [row + [row[-1]] * (coupled - len(row)) for row in couples],
        "defect_width": coupled + model.n_p + 1,
        "factor_rows": model.n_x + model.n_p,
        "kept_width": 2 * model.n_x + model.n_p + 1,
        "parameter_columns": [p.column for p in model.parameters],
        "parameter_unit": [abs(p.scale) for p in model.parameters],
        "compensation": _compensation_context(machine),
        "moves": 2 if machine.compensation.delay else 1,
        "ahead": _ahead_context(machine, step_time),
        "farthest_move": FARTHEST_MOVE,
        "feed_forward": emitter.function(
            [("y", ca.substitute(model.feed_forward, model.chi, model.from_node))],
            inputs={"x": "x", "w": "w", "theta": "theta"},
        ),
        "memory_text": "static or on a stack that is large enough",
        "sample_terms": emitter.function(
            [(f"term[{k} * stride]", t.expression) for k, t in enumerate(structure.sample_terms)], inputs={"w": "w"}
        ),
        "parameter_terms": emitter.function(
            [(f"q[{k}]", e) for k, e in enumerate(q)]
            + [
                (f"d_q[{k * model.n_p + j}]", d)
                for k, e in enumerate(q)
                for j, d in enumerate(ca.vertsplit(ca.densify(ca.gradient(e, theta))))
            ]
            + [(f"scale[{i}]", s) for i, s in enumerate(scale)]
            + [
                (f"d_scale[{i * model.n_p + j}]", d)
                for i, s in enumerate(scale)
                for j, d in enumerate(ca.vertsplit(ca.densify(ca.gradient(s, theta))))
            ],
            inputs={"theta": "theta"},
            zeroed={"d_q": len(q) * model.n_p, "d_scale": model.n_x * model.n_p},
        ),
        "output": emitter.function(
            [("y", output)]
            + [(f"c[{i}]", d) for i, d in enumerate(ca.vertsplit(ca.densify(ca.gradient(output, model.x))))]
            + [(f"d[{i}]", d) for i, d in enumerate(ca.vertsplit(ca.densify(ca.gradient(output, theta))))],
            inputs={"x": "x", "w": "w", "theta": "theta"},
        ),
        "deflection": emitter.function(
            [(f"z[{i}]", e) for i, e in enumerate(ca.vertsplit(deflection))], inputs={"x": "x", "theta": "theta"}
        ),
        "si": emitter.function(
            [
                (f"p[{k}]", p.nominal * theta[k] if p.scale == p.nominal else p.nominal + p.scale * (theta[k] - 1.0))
                for k, p in enumerate(model.parameters)
            ],
            inputs={"theta": "theta"},
        ),
    }
    flow_template = []
    if flow:
        smoothing = machine.friction.smoothing
        gate = gate_ratio(smoothing.zeta, smoothing.lambda_, smoothing.gamma)
        context |= {
            "table": flow_table(smoothing.zeta, smoothing.lambda_, machine.code.precision, str(machine.source)),
            "zeta": smoothing.zeta,
            "lambda_": smoothing.lambda_,
            "gate": gate,
            "gate_velocity": gate * machine.friction.stribeck_velocity,
            "level_change": LEVEL_CHANGE / smoothing.lambda_,
            "phi": _series([(n - 1.0) / math.factorial(n + 1) for n in range(2, 9)], emitter.printer),
            "d_phi": _series([n * (n - 1.0) / math.factorial(n + 1) for n in range(2, 9)], emitter.printer),
        }
        flow_template = [("flow.h.jinja", f"{name}_flow.h")]
    context["templates"] = [
        *flow_template,
        ("machine.h.jinja", f"{name}.h"),
        ("machine.c.jinja", f"{name}.c"),
        ("config.h.jinja", f"{name}_config.h"),
        ("model.h.jinja", f"{name}_model.h"),
        ("integrator.h.jinja", f"{name}_integrator.h"),
        ("compensation.h.jinja", f"{name}_compensation.h"),
    ]
    return context


def _signals_read(model: Model, structure: Structure) -> set[str]:
    """Names of the signals that the estimator's functions depend on; velocity it needs itself."""
    functions = ca.vertcat(*(t.expression for t in structure.sample_terms), model.output, model.feed_forward)
    depends = ca.which_depends(functions, model.w)
    return {"velocity"} | {name for name, does in zip(SIGNAL_NAMES, depends, strict=True) if does}


def _series(coefficients: Sequence[float], printer: CPrinter) -> str:
    """x^2 (c_0 - c_1 x + c_2 x^2 - ...) as C, by Horner's scheme."""
    text = printer.number(coefficients[-1])
    for c in reversed(coefficients[:-1]):
        text = f"({printer.number(c)} - x * {text})"
    return f"x * x * {text}"


def element_law(machine: Machine) -> Mapping[str, float] | None:
    """Constants of an element's right side as two logistic functions of |r| and r v, powers of two (DESIGN section 6).

    The window depends on |r| alone where its two sides do not overlap (`SATURATED`). Exponents must stay in range: r is
    held within `farthest`, where the range reaches far beyond every deflection there is, and the gate's velocity within
    `fastest`, beyond which the gate is saturated wherever the window is not shut; otherwise (0) both exponents are held
    within `deepest`, where the logistic functions have reached 0 or 1 to rounding. None where the window's own exponent
    leaves the range.
    """
    smoothing, friction = machine.friction.smoothing, machine.friction
    single = machine.code.precision == "single"
    fastest = max(1.0, smoothing.lambda_ / smoothing.gamma)
    per_power = 1.0 / math.log(2.0)
    deepest, largest = (30.0, 125.0) if single else (60.0, 1000.0)
    offset = 2.0 * smoothing.lambda_ * smoothing.zeta * per_power
    farthest = largest / (2.0 * max(smoothing.lambda_, smoothing.gamma * fastest) * per_power)
    if smoothing.lambda_ * smoothing.zeta < SATURATED or offset + deepest > largest:
        return None
    shared = farthest >= FARTHEST  # the clamps of r and v come doubled
    return {
        "farthest": farthest if shared else 0.0,
        "deepest": deepest,
        "fastest": fastest * friction.stribeck_velocity,
        "window": (1.0 if shared else 2.0) * smoothing.lambda_ * per_power,
        "offset": offset,
        "gate": -(0.5 if shared else 2.0) * smoothing.gamma / friction.stribeck_velocity * per_power,
        "ln2": math.log(2.0),
    }


def _couples(structure: Structure) -> list[list[int]]:
    """Per state the states that share a block with it, itself included: the columns of A that may not be zero."""
    blocks = [block.states for group in structure.groups for block in group.blocks]
    states = range(structure.model.n_x)
    return [sorted({state for block in blocks if i in block for state in block}) for i in states]


@dataclass(frozen=True)
class _Costs:
    """Work of an update in multiplications or so: of one unit of each kind, and of the units in one sample."""

    recover: int
    step: int
    node: int
    per_sample: int


def _costs(
    model: Model, relinearise: str, slots: int, steps: int, samples: int, *, stairs: int, rows: int, batches: int
) -> _Costs:
    """Share the work of an update out over the samples of an interval but its last.

    A sample does units, in their order, as long as they fit: per_sample is the smallest number with which all of them
    are done in time. More never takes longer. `rows` are those of a step, of which "auto" takes every one `batches`
    times; at worst it is taken as its samples (`stairs`).
    """
    n_x, n_p = model.n_x, model.n_p
    width = 2 * n_x + n_p + 1
    recover = (1 + (relinearise == "auto")) * n_x * (n_x + n_p)
    node = 2 * n_x * (n_x + 2) * width + 2 * (n_x + n_p) * (n_x + n_p + 1)
    step = STEP_COST_PER_ROW * stairs * rows * (slots if relinearise == "all" else 1)
    count = {"all": 1, "auto": batches, "newest": 0}[relinearise] * steps
    units = [(recover, slots - 1), (node, 1), (step, count), (node, slots - 1)]
    total = sum(cost * n for cost, n in units)

    def is_enough(per_sample: int) -> bool:
        used = left = 0
        for cost, n in units:
            n, left = max(0, n - left // cost), left - min(n, left // cost) * cost
            if n > 0:
                whole = per_sample // cost
                used += -(-n // whole)
                left = per_sample - ((n - 1) % whole + 1) * cost
        return used <= samples - 1

    possible = range(max(cost for cost, n in units if n > 0), total)
    per_sample = possible.start + bisect.bisect_left(possible, True, key=is_enough)
    return _Costs(recover, step, node, per_sample)


def _compensation_context(machine: Machine) -> dict[str, Any]:
    compensation, rate = machine.compensation, machine.sampling.rate
    lag, h = chain_delay(machine), machine.sampling.step
    # At constant acceleration the filtered velocity is that of lag + h/2 ago (a difference is the velocity of half a
    # sample ago). The mean velocity since, the displacement beyond the filtered position over the lag, is later by:
    later = 0.5 * (lag + h)
    return {
        "delay": compensation.delay,
        "over_delay": (lag + 0.5 * h + 0.5 * compensation.delay) / later,
        "at_end": (lag + 0.5 * h + compensation.delay) / later,
        "gain_step": min(1.0, 1.0 / (rate * compensation.ramp)) if compensation.ramp else 1.0,
        "hold": compensation.hold,
        "limit": compensation.limit,
        "enabled": int(compensation.enabled),
        "lag": lag,
        "carry": math.exp(-1.0 / machine.sampling.samples_per_update),
        "lag_text": f"{1e3 * lag:.3g} ms",
        "delay_text": f"{1e6 * compensation.delay:g} us",
        "ramp_text": f"{1e3 * compensation.ramp:g} ms",
    }


def _ahead_context(machine: Machine, step_time: float) -> dict[str, float]:
    """Constants of the propagation ahead: elastic range, gate, and du/dxi = -k u + a u^2 about the fixed point."""
    friction, smoothing = machine.friction, machine.friction.smoothing
    zeta, lambda_, gamma = smoothing.zeta, smoothing.lambda_, smoothing.gamma
    longest = chain_delay(machine) + machine.compensation.delay + step_time
    # Taken as saturated, a gate whose tail is left out moves an element's force by kappa |v| T tail at most.
    saturated = gate_ratio(zeta, lambda_, gamma)
    stroke = saturated * friction.stribeck_velocity * longest * sum(friction.stiffness) / friction.coulomb
    gate = min(saturated, gate_ratio(zeta, lambda_, gamma, AHEAD_EQUAL / stroke))
    r = 1.0
    for _ in range(60):  # 1 - etaA(r) r = 0
        window = 1.0 / (1.0 + math.exp(-2.0 * lambda_ * (r - zeta)))
        first = 2.0 * lambda_ * window * (1.0 - window)
        r += (1.0 - window * r) / (window + first * r)
    second = 2.0 * lambda_ * first * (1.0 - 2.0 * window)
    return {
        "displacement": AHEAD_DISPLACEMENT,
        "equal": AHEAD_EQUAL,
        "elastic": _ahead_elastic(machine),
        "gate_velocity": gate * friction.stribeck_velocity,
        "longest": longest,
        "curve": -0.5 * (2.0 * first + second * r) / (window + first * r),
        "powers": (window + first * r) / math.log(2.0),
        "forgotten": -math.log2(AHEAD_EQUAL),
    }


def _ahead_elastic(machine: Machine) -> float:
    """Relative deflection below which slip is less than AHEAD_EQUAL of the motion; not positive: there is none."""
    smoothing = machine.friction.smoothing
    return smoothing.zeta + math.log(AHEAD_EQUAL) / (2.0 * smoothing.lambda_)


def hold_path(machine: Machine) -> float:
    """Path [m] of an interval below which it says nothing of the parameters: 10 % of the smallest deflection scale."""
    friction = machine.friction
    return 0.1 * min(
        nu * friction.coulomb / kappa for nu, kappa in zip(friction.fraction, friction.stiffness, strict=True)
    )


def _node_scale(model: Model, i: int) -> ca.SX:
    """x_i / chi_i, a function of the parameters."""
    return ca.substitute(ca.gradient(model.to_node[i], model.chi)[i], model.chi, ca.SX.zeros(model.n_x))


def _group_context(
    group: Group,
    structure: Structure,
    emitter: _Emitter,
    *,
    flow: bool,
    law: bool,
    step_time: float,
    piece_time: float,
    wide: int,
) -> dict[str, Any]:
    m, n_q, terms = group.m, group.n_q, emitter.terms
    integrator = structure.model.machine.sampling.integrator
    max_velocity = structure.model.machine.sampling.max_velocity
    per_step = step_time / integrator.displacement
    states = [f"chi{i}" for i in range(m)]
    values = list(terms)
    inputs = ["q_l", "data_l"]
    real = "sgms_real"
    arguments = [f"{real} {v}" for v in states + values] + [f"const {real} *q", f"const {real} *data"]
    slopes = [f"rate[{i}]" for i in range(m)]
    for i in range(m):
        slopes += [" + ".join(f"d_chi[{i * m + f}] * at{m + f * m + e}" for f in range(m)) for e in range(m)]
    for i in range(m):
        slopes += [
            " + ".join(f"d_chi[{i * m + f}] * at{m + m * m + f * n_q + e}" for f in range(m)) + f" + d_q[{i * n_q + e}]"
            for e in range(n_q)
        ]
    number = emitter.printer.number
    rates = [
        [
            b.rate_per_metre * per_step,
            b.rate_per_second * per_step,
            (max_velocity * b.rate_per_metre + b.rate_per_second) * per_step,
        ]
        for b in group.blocks
    ]
    ahead_terms = [f"term[{k}]" for k in range(len(terms))] + ["q", "data"]
    is_slider = group.is_elements and m == 1
    ahead_slow = flow and is_slider
    per_move = 1.0 / (AHEAD_SLOW_DISPLACEMENT if ahead_slow else AHEAD_DISPLACEMENT)
    ahead_rates = [(b.rate_per_metre * per_move, b.rate_per_second / integrator.displacement) for b in group.blocks]
    result: dict[str, Any] = {
        "name": group.name,
        "NAME": group.name.upper(),
        "m": m,
        "n_q": n_q,
        "n_data": group.n_data,
        "rows": m * (1 + m + n_q),
        "one_rows": m * (1 + m + n_q) + n_q + group.n_data,
        "n_blocks": len(group.blocks),
        "blocks": group.blocks,
        "arguments": arguments,
        "terms": values,
        "call": [f"at{i}" for i in range(m)] + [f"term[{k} * WIDE + l]" for k in range(len(terms))] + inputs,
        "law": law,
        "slopes": slopes,
        "ahead_flow_call": [f"chi[{i}]" for i in range(1, m)] + ahead_terms,
        "ahead_call": [f"at{i}" for i in range(m)] + ahead_terms,
        "ahead_move_calls": [
            [f"term[{'TERMS + ' if move else ''}{k}]" for k in range(len(terms))] + ["q", "data"] for move in range(2)
        ],
        "is_slider": is_slider,
        "ahead_slow": ahead_slow,
        "ahead_steps": not ahead_slow,
        "ahead_elastic": is_slider and (flow or law) and _ahead_elastic(structure.model.machine) > 0.0,
        "ahead_rates": ["{" + ", ".join(number(v) for v in row) + "}" for row in ahead_rates],
        "rhs": emitter.group_function(
            group,
            [(f"rate[{i}]", n) for i, n in enumerate(group.rhs)]
            + [(f"d_chi[{i}]", n) for i, n in enumerate(group.d_chi)]
            + [(f"d_q[{i}]", n) for i, n in enumerate(group.d_q)],
        ),
        "data_rows": [emitter.printer.array(b.data or (0.0,)) for b in group.blocks],
        "rates": ["{" + ", ".join(number(v) for v in row) + "}" for row in rates],
        "flow": flow,
        "n_up": m - 1 if flow or law else 0,
        "slides": False,
        "coefficients": None,
    }
    if flow or law:
        result["level_in_q"] = any(n.op != "const" for n in group.d_inverse_level)
        result["flow_arguments"] = [f"{real} {v}" for v in states[1:] + values] + [
            f"const {real} *q",
            f"const {real} *data",
        ]
        result["flow_call"] = [f"chi[{i} * WIDE]" for i in range(1, m)]
        result["flow_call"] += [f"term[{k} * WIDE + l]" for k in range(len(terms))] + inputs
        outputs = [("*rho", group.rate[0]), ("*over_level", group.inverse_level[0])]
        outputs += [(f"d_rho[{k}]", n) for k, n in enumerate(group.d_rate)]
        outputs += [(f"d_over_level[{k}]", n) for k, n in enumerate(group.d_inverse_level)]
        outputs += [(f"level_by_state[{i}]", n) for i, n in enumerate(group.level_by_state)]
        result["coefficients"] = emitter.group_function(group, outputs, skip=states[:1])
    if flow:
        # At most slow_displacement per RK4 step below the gate, where r moves slowly; the slip window, 1 / lambda wide
        # in r, bounds a step even there.
        friction = structure.model.machine.friction
        smoothing = friction.smoothing
        gate = gate_ratio(smoothing.zeta, smoothing.lambda_, smoothing.gamma) * friction.stribeck_velocity
        displacement = integrator.slow_displacement * min(1.0, SLOW_LAMBDA / smoothing.lambda_)
        result["slow"] = [
            max(
                1,
                math.ceil(
                    gate * piece_time * b.rate_per_metre / displacement
                    + piece_time * b.rate_per_second / integrator.displacement
                ),
            )
            for b in group.blocks
        ]
        line_rates = [
            (step_time * b.rate_per_metre / displacement, step_time * b.rate_per_second / integrator.displacement)
            for b in group.blocks
        ]
        line_rates += [(0.0, 0.0)] * (wide - len(line_rates))
        result["line_rates"] = ["{" + ", ".join(number(v) for v in row) + "}" for row in line_rates]
        result["slides"] = group.obeys_law and not result["level_in_q"]
        result["node_call"] = lambda node: [f"nodes[{node} + {k} * WIDE + l]" for k in range(len(terms))] + inputs
        outputs = [(f"end[{i}]", n) for i, n in enumerate(group.upstream)]
        outputs += [(f"by_state[{i}]", n) for i, n in enumerate(group.upstream_by_state)]
        outputs += [(f"by_q[{k}]", n) for k, n in enumerate(group.upstream_by_q)]
        result["upstream"] = emitter.group_function(group, outputs, skip=states[:1])
    return result


def write_package(package: Package, folder: Path) -> None:
    """Write a package into `folder`, which afterwards holds it and nothing else that a package could have left.

    The folder is replaced in one move, so an interruption leaves the old one or the new one.

    Raises:
        InputError: the folder cannot be written, or holds files that no package emits.
    """
    parent = folder.parent
    foreign = [p.name for p in folder.iterdir() if p.suffix not in (".c", ".h", ".txt")] if folder.is_dir() else []
    if foreign:
        raise InputError(folder, "output folder", sorted(foreign)[0], "an empty folder or an earlier package")
    try:
        parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(dir=parent, prefix=f".{folder.name}-"))
        try:
            for name, text in package.files.items():
                (scratch / name).write_text(text, encoding="utf-8")
            scratch.chmod(0o755)
            if folder.exists():
                shutil.rmtree(folder)
            scratch.rename(folder)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise InputError(folder, "output folder", None, f"cannot be written: {error.strerror}") from None
