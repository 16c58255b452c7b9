"""Export a step of the filter of ekf.c by CasADi, as its users write it: one symbolic function."""

import sys
from pathlib import Path

import casadi as ca

MASS, COULOMB, VISCOUS, NOISE, DRIFT, DEFLECTION_NOISE = 20.0, 4.0, 20.0, 0.1, 0.002 * 0.3162, 0.01
STIFFNESS = ca.DM([120e3, 25e3, 7.1e3, 7.9e3])
FRACTION = ca.DM([0.067, 0.056, 0.047, 0.83])


def make_step() -> ca.Function:
    """(x, P, travel, velocity, measured friction) to (x, P), single precision in its C."""
    n = STIFFNESS.numel()
    x, P = ca.SX.sym("x", 2 * n), ca.SX.sym("P", 2 * n, 2 * n)
    travel, velocity, measured = (ca.SX.sym(name) for name in ("travel", "velocity", "measured"))
    share, limit = x[n:], FRACTION * COULOMB / (STIFFNESS * x[n:])
    moved = x[:n] + travel
    slips = ca.logic_or(moved > limit, moved < -limit)
    after = ca.vertcat(ca.if_else(slips, ca.sign(moved) * limit, moved), share)
    A = ca.jacobian(after, x)
    noise = ca.vertcat(DEFLECTION_NOISE * FRACTION * COULOMB / STIFFNESS, ca.DM.ones(n) * DRIFT)
    predicted = A @ P @ A.T + ca.diag(noise**2)
    state = ca.SX.sym("state", 2 * n)
    output = ca.Function("output", [state], [ca.dot(STIFFNESS * state[n:], state[:n])])
    H = ca.jacobian(output(state), state)
    H = ca.substitute(H, state, after)
    gain = predicted @ H.T / (H @ predicted @ H.T + NOISE**2)
    corrected = after + gain * (measured - output(after) - VISCOUS * velocity)
    corrected = ca.vertcat(corrected[:n], ca.if_else(corrected[n:] < 0.2, 0.2, corrected[n:]))  # no library
    options = {"cse": True}
    return ca.Function(
        "casadi_step", [x, P, travel, velocity, measured], [corrected, predicted - gain @ H @ predicted], options
    )


if __name__ == "__main__":
    generator = ca.CodeGenerator("casadi_step.c", {"with_header": True, "casadi_real": "float", "casadi_int": "int"})
    generator.add(make_step())
    generator.generate(f"{Path(sys.argv[1])}/")
