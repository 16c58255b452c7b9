"""CasADi's functions of one substep of every block, of the node maps and of the output, with their Jacobians."""

import casadi as ca

from sgms_mhe.reference.blocks import Blocks, IntegratedBlock

# Of classical Runge-Kutta: stages k_i = f(y + h a_i k_(i-1)) at c_i h, y1 = y + h sum_i b_i k_i; rows are (c, a, b).
TABLEAU = ((0.0, 0.0, 1 / 6), (1 / 2, 1 / 2, 1 / 3), (1 / 2, 1 / 2, 1 / 3), (1.0, 1.0, 1 / 6))


def step_functions(blocks: Blocks) -> dict[str, ca.Function]:
    """CasADi functions with dense Jacobians: start, finish, measure; of block b step_b, flow_b, rate_b, clip_b."""
    model = blocks.model
    functions = {
        "start": _differentiate("start", [model.x, model.theta], model.from_node, (0, 1)),
        "finish": _differentiate("finish", [model.chi, model.theta], model.to_node, (0, 1)),
    }
    of_node = ca.substitute(model.output, model.chi, model.from_node)
    functions["measure"] = _differentiate("measure", [model.x, model.w, model.theta], of_node, (0, 2))
    for b, block in enumerate(blocks.all):
        if block.switches:
            functions[f"clip_{b}"] = _clip_drive(blocks, f"clip_{b}", block)
            continue
        functions[f"step_{b}"] = _step(blocks, f"step_{b}", block)
        if block.saturates:
            functions[f"flow_{b}"] = _flow_drive(blocks, f"flow_{b}", block)
        if block.slides:
            functions[f"rate_{b}"] = _differentiate(f"rate_{b}", [model.theta], model.rho[block.states[0]], (0,))
    return functions


def _flow_drive(blocks: Blocks, name: str, block: IntegratedBlock) -> ca.Function:
    """Inputs of a jump: (u, w, theta, h) to level, xi, u1 and their Jacobians in (u, theta).

    u (m - 1) are the states that set the level. With signals constant over h, du/dt = a + b u has the solution
    u1 = u e + a (e - 1) / b, e = exp(b h); the element sees the level at u1.
    """
    model = blocks.model
    h = ca.SX.sym("h")
    u, end, level = _closed_forms(blocks, block, h)
    xi = blocks.drive(block.states[0]) * h / level
    variables = ca.vertcat(u, model.theta)
    jacobians = [ca.densify(ca.jacobian(value, variables)) for value in (level, xi, end)]
    return ca.Function(name, [u, model.w, model.theta, h], [level, xi, ca.densify(end), *jacobians])


def _clip_drive(blocks: Blocks, name: str, block: IntegratedBlock) -> ca.Function:
    """Inputs of a switching element: (u, w, w at the end, theta, h) to level, move, u1, Jacobians in (u, theta).

    The displacement is that of the signals w over h; the level that of the signals at the end, and of u1.
    """
    model, i = blocks.model, block.states[0]
    h, last = ca.SX.sym("h"), ca.SX.sym("last", model.w.numel())
    u, end, level = _closed_forms(blocks, block, h)
    level = ca.substitute(level, model.w, last)
    move = model.rho[i] * model.w[1] * h
    variables = ca.vertcat(u, model.theta)
    jacobians = [ca.densify(ca.jacobian(value, variables)) for value in (level, move, end)]
    return ca.Function(name, [u, model.w, last, model.theta, h], [level, move, ca.densify(end), *jacobians])


def _closed_forms(blocks: Blocks, block: IntegratedBlock, h: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """The states u of a block beside its element, their ends u1 over h, and the level at u1."""
    model, others = blocks.model, list(block.states[1:])
    if not others:
        return ca.SX(0, 1), ca.SX(0, 1), model.level
    u = ca.vertcat(*(model.chi[j] for j in others))
    ends = []
    for j in others:
        b = ca.gradient(model.rhs[j], model.chi[j])
        a = ca.substitute(model.rhs[j], model.chi[j], 0)
        ends.append(model.chi[j] * ca.exp(b * h) + a * (ca.exp(b * h) - 1) / b)
    end = ca.vertcat(*ends)
    return u, end, ca.substitute(model.level, u, end)


def _step(blocks: Blocks, name: str, block: IntegratedBlock) -> ca.Function:
    """One Runge-Kutta substep of a block: (chi, w at start, w at end, theta, h) to chi1 and its Jacobians."""
    model, states = blocks.model, list(block.states)
    chi = ca.vertcat(*(model.chi[i] for i in states))
    rhs = ca.Function("rhs", [chi, model.w, model.theta], [ca.vertcat(*(model.rhs[i] for i in states))])
    start, end, h = ca.SX.sym("w0", model.w.numel()), ca.SX.sym("w1", model.w.numel()), ca.SX.sym("h")
    is_line = model.machine.sampling.merged > 1
    slope, total = ca.SX.zeros(len(states)), ca.SX.zeros(len(states))
    for c, a, b in TABLEAU:
        w = start + c * (end - start) if is_line else end
        slope = rhs(chi + h * (a * slope), w, model.theta)
        total += b * slope
    new = chi + h * total
    return _differentiate(name, [chi, start, end, model.theta, h], new, (0, 3))


def _differentiate(name: str, arguments: list[ca.SX], value: ca.SX, wanted: tuple[int, ...]) -> ca.Function:
    jacobians = [ca.densify(ca.jacobian(value, arguments[i])) for i in wanted]
    return ca.Function(name, arguments, [ca.densify(value), *jacobians], {"cse": True})
