/* Tables looked up by position, in a bounded number of operations whatever their length. */
#ifndef SGMS_TABLE_H
#define SGMS_TABLE_H

#include "sgms_math.h"

/* From here on every number is an integer; added to a smaller one, not negative, it rounds to the
 * nearest. */
#if SGMS_SINGLE
#define SGMS_WHOLE 8388608.0f /* 2^23 */
#else
#define SGMS_WHOLE 4503599627370496.0 /* 2^52 */
#endif

/* The largest integer that is not above x. */
static inline sgms_real sgms_floor(sgms_real x)
{
    const sgms_real size = sgms_fabs(x);
    const sgms_real whole = (size + SGMS_WHOLE) - SGMS_WHOLE;
    const sgms_real nearest = size < SGMS_WHOLE ? (x < SGMS_R(0.0) ? -whole : whole) : x;
    return nearest > x ? nearest - SGMS_R(1.0) : nearest;
}

/* Entry `place`, a whole number from 0 to `last`, of a table; of any other number, NaN included,
 * one of its entries. */
static inline sgms_real sgms_entry(const sgms_real *table, int last, sgms_real place)
{
    return table[sgms_index(place, last)];
}

#endif
