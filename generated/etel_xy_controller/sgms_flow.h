/* Flow of a Maxwell-slip element: dr/dxi = g(r) = 1 - etaA(r) max(r, 0), in closed form.
 *
 * psi linearises the flow, psi(r(xi)) = psi(r(0)) exp(-k xi), on both sides of the fixed point r*.
 * psi and its inverse are piecewise polynomials that depend on the smoothing alone. Below `start`
 * the element is elastic (g = 1), above `end` it relaxes as 1 + (r - 1) exp(-xi); there nothing is
 * looked up. The work does not grow with xi.
 *
 * The package's own flow header defines the table and what reads it, so that the constants fold
 * into the code. */
#ifndef SGMS_FLOW_H
#define SGMS_FLOW_H

#include "sgms_math.h"

typedef struct {
    sgms_real start, end; /* range of the polynomials in r */
    sgms_real k;          /* -g'(r*) */
    sgms_real segments_per_r;
    sgms_real cells_per_s;  /* of the look-up from s = psi to a segment */
    sgms_real r_star, near; /* fixed point, and how close to it a sliding element stays: there a
                               short polynomial does */
} sgms_flow_table;

typedef struct {
    sgms_real r;     /* r1 */
    sgms_real ratio; /* dr1/dr0 */
    sgms_real slope; /* dr1/dxi = g(r1) */
} sgms_flow_move;

/* Runge-Kutta steps below the gate: `most` of them at the gate, and the slower the fewer, none
 * longer than these. `pace` is the velocity over the gate's, at most 1 in size. */
static SGMS_INLINE int sgms_flow_slow_steps(sgms_real most, sgms_real pace)
{
    return (int)sgms_fmin(most, most * sgms_fabs(pace) + (sgms_real)1);
}

#endif
