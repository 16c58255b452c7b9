/* Displacement flow of a Maxwell-slip element: the solution of dr/dxi = g(r) = 1 - etaA(r) max(r, 0) in closed form.
 *
 * psi linearises the flow, psi(r(xi)) = psi(r(0)) exp(-k xi), on both sides of the fixed point r*. psi and its inverse
 * are piecewise polynomials that depend on the smoothing alone. Below `start` the element is elastic (g = 1), above
 * `end` it relaxes as 1 + (r - 1) exp(-xi); there nothing is looked up. The work does not grow with xi. */
#ifndef SGMS_FLOW_H
#define SGMS_FLOW_H

#include "sgms_math.h"

typedef struct {
    sgms_real start, end; /* range of the polynomials in r */
    sgms_real k;          /* -g'(r*) */
    sgms_real segments_per_r;
    sgms_real cells_per_s; /* of the look-up from s = psi to a segment */
    int segments, cells, degree;
    const sgms_real *edge;    /* [segments + 1] psi at the segments' edges, falling */
    const sgms_real *forward; /* [segments][degree + 1] psi over t in [-1, 1] */
    const sgms_real *inverse; /* [segments][degree + 1] r over s in the segment, scaled to [-1, 1] */
    const uint8_t *cell;      /* [cells] segment that holds the upper end of the cell */
    sgms_real r_star,
        near; /* fixed point, and how close to it a sliding element stays: there a short polynomial does */
} sgms_flow_table;

typedef struct {
    sgms_real r;     /* r1 */
    sgms_real ratio; /* dr1/dr0 */
    sgms_real slope; /* dr1/dxi = g(r1) */
} sgms_flow_move;

/* Value and derivative of a polynomial, coefficients from the constant up. */
static inline sgms_real sgms_flow_polynomial(const sgms_real *c, int degree, sgms_real t, sgms_real *derivative)
{
    sgms_real value = c[degree];
    sgms_real slope = SGMS_R(0.0);
    for (int i = degree - 1; i >= 0; i--) {
        slope = slope * t + value;
        value = value * t + c[i];
    }
    *derivative = slope;
    return value;
}

/* Move r0 (signed along the velocity) by xi = |v| h / zs >= 0. */
static inline sgms_flow_move sgms_flow_step(const sgms_flow_table *table, sgms_real r0, sgms_real xi)
{
    sgms_flow_move move = {.r = r0 + xi, .ratio = SGMS_R(1.0), .slope = SGMS_R(1.0)};
    sgms_real t, s, decay, d_psi, d_r, half;
    int j;
    if (!(move.r > table->start)) { /* elastic all the way, or not a number */
        return move;
    }
    if (r0 < table->start) {
        xi -= table->start - r0;
        r0 = table->start;
    } else if (r0 > table->end) {
        decay = sgms_exp(-xi);
        move.r = SGMS_R(1.0) + (r0 - SGMS_R(1.0)) * decay;
        if (move.r >= table->end) {
            move.ratio = decay;
            move.slope = SGMS_R(1.0) - move.r;
            return move;
        }
        move.ratio = (table->end - SGMS_R(1.0)) / (r0 - SGMS_R(1.0));
        xi += sgms_log(move.ratio);
        r0 = table->end;
    }
    t = (r0 - table->start) * table->segments_per_r;
    j = (int)t;
    j = j < table->segments ? j : table->segments - 1;
    t = SGMS_R(2.0) * (t - (sgms_real)j) - SGMS_R(1.0);
    decay = sgms_exp(-table->k * xi);
    s = sgms_flow_polynomial(table->forward + j * (table->degree + 1), table->degree, t, &d_psi) * decay;
    d_psi *= SGMS_R(2.0) * table->segments_per_r;

    j = (int)((table->edge[0] - s) * table->cells_per_s);
    j = (int)table->cell[j < 0 ? 0 : (j < table->cells ? j : table->cells - 1)];
    while (j < table->segments - 1 && s < table->edge[j + 1]) {
        j++;
    }
    half = SGMS_R(0.5) * (table->edge[j + 1] - table->edge[j]);
    t = (s - table->edge[j]) / half - SGMS_R(1.0);
    move.r = sgms_flow_polynomial(table->inverse + j * (table->degree + 1), table->degree, t, &d_r);
    d_r /= half;
    move.ratio *= decay * d_psi * d_r;
    move.slope = -table->k * s * d_r;
    return move;
}

#endif
