"""Structure analysis: parts of the symbolic model that are independent, shared, or computed once.

Found from the expressions, never assumed: blocks of states that depend on no state outside the block (from the Jacobian
of the right side), groups of blocks that are the same function of different numbers, parameter terms (functions of
parameters alone, once per update), sample terms (functions of signals alone, once per sample), and the few scalars
through which the parameters enter a block, which are the only ones its sensitivities are propagated for.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from itertools import islice

import casadi as ca
import numpy as np

from sgms_mhe.emission.graph import Graph, Node, frontier, operations, to_sx, walk
from sgms_mhe.machine import Machine
from sgms_mhe.model import SIGNAL_NAMES, Model, StateSpec


@dataclass(frozen=True)
class Block:
    """States that depend on no state outside the block, and the numbers that make it this block.

    Attributes:
        states: indices into the model's states.
        data: constants in which it differs from the other blocks of its group.
        parameter_terms: SX of theta, the scalars through which parameters enter (n_q).
        rate_per_metre, rate_per_second: fastest nominal rates, for the number of substeps.
    """

    states: tuple[int, ...]
    data: tuple[float, ...]
    parameter_terms: tuple[ca.SX, ...]
    rate_per_metre: float
    rate_per_second: float


@dataclass(frozen=True)
class Group:
    """Blocks that are the same function: one emitted right side serves them all, side by side.

    Attributes:
        rhs: d(chi)/dt (m); of an element that switches, while it sticks.
        d_chi: its Jacobian in chi (m x m, row-major).
        d_q: its Jacobian in the parameter terms (m x n_q, row-major).
        rate, level: of Maxwell-slip elements, rho and f_C/s(v), or s(v)/f_C where they switch, with their derivatives
            in the parameter terms (`d_rate`, `d_level`, n_q each); empty for other blocks.
        level_by_state: derivatives of `level` in the element's upstream states (m - 1).
        upstream: those states at the end of a step (m - 1), with their derivatives in themselves (`upstream_by_state`,
            m - 1) and in the parameter terms (`upstream_by_q`, (m - 1) x n_q).
        name: C name.
        blocks: its blocks, in the order of their states.
        obeys_law: whether `rhs` is the S-GMS law of one state in these, for every value of its inputs.
        switches: whether the blocks are elements that switch.
        names: names for intermediate values.
    """

    rhs: tuple[Node, ...]
    d_chi: tuple[Node, ...]
    d_q: tuple[Node, ...]
    rate: tuple[Node, ...] = ()
    level: tuple[Node, ...] = ()
    d_rate: tuple[Node, ...] = ()
    d_level: tuple[Node, ...] = ()
    level_by_state: tuple[Node, ...] = ()
    upstream: tuple[Node, ...] = ()
    upstream_by_state: tuple[Node, ...] = ()
    upstream_by_q: tuple[Node, ...] = ()
    _: KW_ONLY
    name: str
    blocks: tuple[Block, ...]
    obeys_law: bool
    switches: bool
    names: dict[Node, str]

    @property
    def m(self) -> int:
        """States per block."""
        return len(self.rhs)

    @property
    def n_q(self) -> int:
        """Parameter terms per block."""
        return len(self.blocks[0].parameter_terms)

    @property
    def n_data(self) -> int:
        """Constants per block."""
        return len(self.blocks[0].data)

    @property
    def is_elements(self) -> bool:
        """Return True if the blocks are Maxwell-slip elements, which have a closed form in displacement."""
        return bool(self.level)

    @property
    def at_once(self) -> bool:
        """Return True if they are switching elements that take merged samples in one clip: alone, rho constant."""
        return self.switches and self.m == 1 and "terms" not in self.rate[0].inputs


@dataclass(frozen=True)
class SampleTerm:
    """A function of the signals alone stored with every step of the series; `expression` is SX of w."""

    name: str
    expression: ca.SX


@dataclass(frozen=True)
class Structure:
    """Result of the structure analysis.

    Attributes:
        groups: groups of blocks.
        sample_terms: stored per step; the first is always the velocity.
    """

    model: Model
    groups: tuple[Group, ...]
    sample_terms: tuple[SampleTerm, ...]


def closed_sets(pattern: np.ndarray[tuple[int, int], np.dtype[np.bool_]]) -> list[tuple[int, ...]]:
    """Blocks of states: each state with all that its equation depends on, directly or not; the largest such sets.

    Blocks may share states: a state that others read and that reads none of them stands in each of their blocks. Sorted
    states, blocks in the order of their first states.
    """
    n = pattern.shape[0]
    reach = pattern | np.eye(n, dtype=bool)
    for k in range(n):
        reach |= np.outer(reach[:, k], reach[k])
    sets = {frozenset(int(j) for j in np.flatnonzero(row)) for row in reach}
    return sorted(tuple(sorted(own)) for own in sets if not any(own < other for other in sets))


def sparsity(expression: ca.SX, variables: ca.SX) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Pattern of the Jacobian of `expression` in `variables`."""
    pattern = ca.jacobian_sparsity(expression, variables)
    return np.array(ca.DM(pattern, 1).full() != 0.0)


def upstream_states(model: Model, states: Sequence[int]) -> tuple[int, ...] | None:
    """The states of a block beside its first, where that is a Maxwell-slip element and they leave it its flow.

    They must be effects' states that each obey a linear equation of their own: constant through a step, signals then
    move them in closed form, and the element sees the level they reach. None where the block is of another kind.
    """
    if model.states[states[0]].element is None or any(model.states[i].element is not None for i in states[1:]):
        return None
    for i in states[1:]:
        slope = ca.gradient(model.rhs[i], model.chi[i])
        alone = not any(ca.depends_on(model.rhs[i], model.chi[j]) for j in range(model.n_x) if j != i)
        if not alone or ca.depends_on(slope, model.chi) or slope.is_zero():
            return None
    return tuple(states[1:])


def _is_term(node: Node) -> bool:
    """Return True for a term stored with a step: signals, and functions of signals too expensive to repeat."""
    return node.inputs == {"w"} and (node.op == "input" or node.is_expensive)


def analyse(model: Model) -> Structure:
    """Analyse a model."""
    graph = Graph()
    labels = {
        "chi": [f"chi_{s.name}" for s in model.states],
        "w": list(model.signal_names),
        "theta": [f"theta_{p.column}" for p in model.parameters],
    }
    vectors = {"chi": model.chi, "w": model.w, "theta": model.theta}
    switches = model.machine.friction.switches
    rhs = graph.read(_while_sticking(model) if switches else model.rhs, vectors, labels)
    # A law that divides by the level has its reciprocal, once per sample; a clip has the level itself.
    level = graph.read(model.level if switches else 1.0 / model.level, vectors, labels)[0]
    rho = graph.read(model.rho, vectors, labels) if model.n_z else []
    terms = frontier([graph.input("w", "velocity"), *rhs, *rho, level], _is_term)
    sampling = model.machine.sampling
    if sampling.merged > 1:  # between the nodes of a step the signals are interpolated, and their functions follow
        terms += [n for n in walk(terms) if n.op == "input" and n not in terms]
    symbols = {graph.input(v, name): vectors[v][k] for v in ("w", "theta") for k, name in enumerate(labels[v])}
    level_name = "level" if switches else "inverse_level"
    sample_terms = tuple(
        SampleTerm(node.label or (level_name if node is level else f"term_{k}"), expression)
        for k, (node, expression) in enumerate(zip(terms, to_sx(terms, symbols), strict=True))
    )
    found: dict[object, list[tuple[_Canonical, tuple[int, ...], tuple[ca.SX, ...]]]] = {}
    for states in closed_sets(sparsity(model.rhs, model.chi)):
        own = [rhs[i] for i in states]
        element = model.states[states[0]].element if upstream_states(model, states) is not None else None
        extra = [rho[element], level] if element is not None else []
        q_nodes = _parameter_terms(own + extra)
        named = [(n, graph.read(e, vectors, labels)[0]) for i in states for n, e in model.names[i].items()]
        canonical = _canonical(
            graph, own, extra, named, [labels["chi"][i] for i in states], terms, q_nodes, sampling.step
        )
        expressions = tuple(to_sx(q_nodes, symbols))
        found.setdefault(canonical.signature, []).append((canonical, states, expressions))
    groups = tuple(_group(k, members, model.states, model.machine) for k, members in enumerate(found.values()))
    return Structure(model, groups, sample_terms)


def _while_sticking(model: Model) -> ca.SX:
    """The right side with elements that move with the axis, rho v."""
    drives = [model.rho[i] * model.w[SIGNAL_NAMES.index("velocity")] for i in range(model.n_z)]
    return ca.vertcat(*drives, model.rhs[model.n_z :])


def _parameter_terms(nodes: Sequence[Node]) -> list[Node]:
    """The scalars through which parameters enter: maximal theta-only nodes, or theta itself where that is fewer."""
    terms = frontier(nodes, lambda node: node.inputs == {"theta"})
    raw = [n for n in walk(nodes) if n.op == "input" and n.inputs == {"theta"}]
    return raw if len(raw) < len(terms) else terms


@dataclass(frozen=True)
class _Canonical:
    """A block as a function of (chi, terms, q) in names that do not tell which block it is."""

    outputs: tuple[Node, ...]
    named: tuple[tuple[str, Node], ...]
    counts: tuple[int, ...]
    constants: tuple[float, ...]
    signature: object


def _canonical(
    graph: Graph,
    rhs: Sequence[Node],
    extra: Sequence[Node],
    named: Sequence[tuple[str, Node]],
    chi_labels: Sequence[str],
    terms: Sequence[Node],
    q_nodes: Sequence[Node],
    step: float,
) -> _Canonical:
    """Differentiate a block and write it in canonical inputs."""
    chi = ca.SX.sym("chi", len(rhs))
    term = ca.SX.sym("term", len(terms))
    q = ca.SX.sym("q", len(q_nodes))
    known = {graph.input("chi", label): chi[k] for k, label in enumerate(chi_labels)}
    known |= {node: term[k] for k, node in enumerate(terms)}
    known |= {node: q[k] for k, node in enumerate(q_nodes)}
    f = ca.vertcat(*to_sx(rhs, known))
    parts = [f, ca.jacobian(f, chi).T.reshape((-1, 1)), ca.jacobian(f, q).T.reshape((-1, 1))]
    if extra:
        rate, level = to_sx(extra, known)
        parts += [rate, level, ca.jacobian(rate, q).T, ca.jacobian(level, q).T]
        if len(rhs) > 1:
            parts += _upstream(f[1:], level, chi[1:], q, step)
    local = Graph()
    vectors = {"chi": chi, "terms": term, "q": q}
    labels = {
        "chi": [f"chi{k}" for k in range(len(rhs))],
        "terms": [f"term{k}" for k in range(len(terms))],
        "q": [f"q{k}" for k in range(len(q_nodes))],
    }
    outputs = local.read(ca.vertcat(*parts), vectors, labels)
    values = local.read(ca.vertcat(*to_sx([n for _, n in named], known)), vectors, labels) if named else []
    order = walk(outputs)
    place = {node: k for k, node in enumerate(order)}
    shape = tuple((n.op, n.label, tuple(place[a] for a in n.args)) for n in order)
    return _Canonical(
        outputs=tuple(outputs),
        named=tuple(zip((n for n, _ in named), values, strict=True)),
        counts=tuple(p.numel() for p in parts),
        constants=tuple(n.value for n in order if n.op == "const"),
        signature=(shape, tuple(place[n] for n in outputs), len(terms)),
    )


def _upstream(rates: ca.SX, level: ca.SX, states: ca.SX, q: ca.SX, step: float) -> list[ca.SX]:
    """Linear equations du/dt = alpha + beta u over a step, u1 = u + (alpha + beta u) (exp(beta h) - 1) / beta."""
    beta = ca.vertcat(*(ca.gradient(rates[i], states[i]) for i in range(rates.numel())))
    decay = ca.exp(beta * step)
    end = states + rates * (decay - 1.0) / beta
    by_q = ca.jacobian(end, q)
    return [ca.jacobian(level, states).T, end, decay, by_q.T.reshape((-1, 1))]


def _group(
    k: int,
    members: list[tuple[_Canonical, tuple[int, ...], tuple[ca.SX, ...]]],
    states: tuple[StateSpec, ...],
    machine: Machine,
) -> Group:
    """Merge blocks of one signature; constants in which they differ become block data."""
    canonical = members[0][0]
    table = np.array([c.constants for c, _, _ in members])
    varying = [j for j in range(table.shape[1]) if np.any(table[:, j] != table[0, j])] if table.size else []
    graph = Graph()
    renamed: dict[Node, Node] = {}
    position = 0
    for node in walk(canonical.outputs):
        if node.op == "const":
            if position in varying:
                renamed[node] = graph.input("data", f"data{varying.index(position)}")
            else:
                renamed[node] = graph.constant(node.value)
            position += 1
        elif node.op == "input":
            renamed[node] = graph.input(next(iter(node.inputs)), node.label)
        else:
            renamed[node] = graph.apply(node.op, *(renamed[a] for a in node.args))
    outputs = iter(renamed[n] for n in canonical.outputs)
    parts = [tuple(islice(outputs, count)) for count in canonical.counts]
    is_elements = len(parts) > 3
    blocks = tuple(
        Block(
            states=own,
            data=tuple(c.constants[j] for j in varying),
            parameter_terms=expressions,
            rate_per_metre=max(states[i].rate_per_metre for i in own),
            rate_per_second=max(states[i].rate_per_second for i in own),
        )
        for c, own, expressions in members
    )
    names = {renamed[n]: label for label, n in canonical.named if n in renamed and n.args}
    switches = machine.friction.switches
    return Group(
        *parts,
        name=f"element{k or ''}" if is_elements else f"block{k}",
        blocks=blocks,
        obeys_law=is_elements and not switches and _obeys_law(parts[0], parts[3], parts[4], machine),
        switches=is_elements and switches,
        names=names,
    )


def _obeys_law(rhs: Sequence[Node], rate: Sequence[Node], inverse_level: Sequence[Node], machine: Machine) -> bool:
    """Return True if the right side is (1) with (3) in the block's rho and level, v its first sample term.

    Compared at points over all regimes, for both signs; an effect that changes the law differs at most of them.
    """
    if len(rhs) != 1:
        return False
    outputs = [*rhs, *rate, *inverse_level]
    inputs = [n for n in walk(outputs) if n.op == "input"]
    symbols = [ca.SX.sym(n.label) for n in inputs]
    f = ca.Function(
        "law", [ca.vertcat(*symbols)], [ca.vertcat(*to_sx(outputs, dict(zip(inputs, symbols, strict=True))))]
    )
    friction, points = machine.friction, 200
    draw = np.random.default_rng(1)
    values = {n.label: draw.uniform(0.5, 1.5, points) for n in inputs}
    chi = draw.uniform(-1.3, 1.3, points)
    v = friction.stribeck_velocity * 10.0 ** draw.uniform(-2.0, 1.0, points) * draw.choice([-1.0, 1.0], points)
    values |= {"chi0": chi, "term0": v}
    found, rho, over_level = np.asarray(f(np.array([values[n.label] for n in inputs])))
    r, smoothing = chi * over_level, friction.smoothed
    window = (
        1.0
        - 0.5 * np.tanh(smoothing.lambda_ * (r + smoothing.zeta))
        + 0.5 * np.tanh(smoothing.lambda_ * (r - smoothing.zeta))
    )
    gate = 0.5 + 0.5 * np.tanh(smoothing.gamma * r * v / friction.stribeck_velocity)
    expected = rho * (v - np.abs(v) * window * gate * r)
    return bool(np.all(np.abs(found - expected) <= 1e-11 * np.abs(rho * v)))


def report(structure: Structure) -> str:
    """Readable report of the analysis: dimensions, sparsity, blocks, operation counts."""
    model = structure.model
    machine = model.machine
    lines = [
        f"Structure of {machine.name}",
        "",
        f"states      {model.n_x}: " + ", ".join(s.name for s in model.states),
        f"parameters  {model.n_p}: " + ", ".join(p.column for p in model.parameters),
        f"horizon     {machine.estimator.horizon} intervals of {machine.sampling.samples_per_update} samples",
        "",
        "Right side: which state's equation depends on which state (x)",
    ]
    width = max(len(s.name) for s in model.states)
    for spec, pattern in zip(model.states, sparsity(model.rhs, model.chi), strict=True):
        row = " ".join("x" if depends else "." for depends in pattern)
        lines.append(f"  {spec.name:<{width}}  {row}")
    names = [s.name for s in model.states] + [p.column for p in model.parameters]
    output = ca.substitute(model.output, model.chi, model.from_node)
    depends_on = ca.which_depends(output, ca.vertcat(model.x, model.theta))
    used = [n for n, u in zip(names, depends_on, strict=True) if u]
    lines += ["", "Output depends on: " + ", ".join(used), "", "Stored per step of the series (once per new sample)"]
    lines += [f"  {t.name:<14} {t.expression}" for t in structure.sample_terms]
    total = 0
    for group in structure.groups:
        stage = operations([*group.rhs, *group.d_chi, *group.d_q])
        count = sum(stage.values())
        total += count * len(group.blocks)
        lines += [
            "",
            f"Group {group.name}: {len(group.blocks)} block(s) of {group.m} state(s), the same function",
            f"  parameters enter through {group.n_q} scalar(s); "
            f"{group.m * (group.m + group.n_q)} sensitivities per block instead of {model.n_x + model.n_p} per state",
            "  one right side with sensitivities: " + ", ".join(f"{n} {op}" for op, n in stage.items()),
        ]
        if group.switches:
            lines.append("  sticks or slips: a step is a clip")
        elif group.is_elements:
            lines.append("  autonomous in displacement where the gate is saturated: displacement flow applies")
        for block in group.blocks:
            what = ", ".join(model.states[i].name for i in block.states)
            scalars = "; ".join(str(q) for q in block.parameter_terms) or "none"
            rates = f"{block.rate_per_metre:.4g} 1/m, {block.rate_per_second:.4g} 1/s"
            lines.append(f"  {what}: scalars {scalars}; rate {rates}")
    lines += ["", f"Operations of one stage over all blocks: {total}", ""]
    return "\n".join(lines)
