/* Displacement flow of a Maxwell-slip element: the solution of dr/dxi = g(r) = 1 - etaA(r) max(r, 0) in closed form.
 *
 * psi linearises the flow, psi(r(xi)) = psi(r(0)) exp(-k xi), on both sides of the fixed point r*. psi and its inverse
 * are piecewise polynomials that depend on the smoothing alone. Below `start` the element is elastic (g = 1), above
 * `end` it relaxes as 1 + (r - 1) exp(-xi); there nothing is looked up. The work does not grow with xi.
 *
 * Included by the package's own flow header, which defines the table: its constants fold into the code, and the look-up
 * vectorises (no branch, indices as int). */
#ifndef SGMS_FLOW_H
#define SGMS_FLOW_H

#include "sgms_math.h"

typedef struct {
    sgms_real start, end; /* range of the polynomials in r */
    sgms_real k;          /* -g'(r*) */
    sgms_real segments_per_r;
    sgms_real cells_per_s; /* of the look-up from s = psi to a segment */
    sgms_real r_star,
        near; /* fixed point, and how close to it a sliding element stays: there a short polynomial does */
} sgms_flow_table;

typedef struct {
    sgms_real r;     /* r1 */
    sgms_real ratio; /* dr1/dr0 */
    sgms_real slope; /* dr1/dxi = g(r1) */
} sgms_flow_move;

/* x within 0 and just below `end`, by absolute values and bits alone. */
static inline sgms_real sgms_limit(sgms_real x, sgms_real end)
{
    const sgms_real positive = SGMS_R(0.5) * (x + sgms_fabs(x));
    const sgms_real last = end - SGMS_R(0.5);
    return sgms_select(sgms_less(positive, last), positive, last);
}

/* The integer below x >= 0, as a number and as an index; either neighbour where x is whole. */
static inline sgms_real sgms_whole(sgms_real x)
{
    return ((x - SGMS_R(0.5)) + SGMS_ROUND_MAGIC) - SGMS_ROUND_MAGIC;
}

static inline sgms_integer sgms_floor(sgms_real x)
{
    return sgms_bits((x - SGMS_R(0.5)) + SGMS_ROUND_MAGIC) - sgms_bits(SGMS_ROUND_MAGIC);
}

/* 1 or 0 */
static inline sgms_integer sgms_is_negative(sgms_real x)
{
    return (sgms_integer)((sgms_unsigned)sgms_bits(x) >> (8 * sizeof x - 1));
}

#endif
