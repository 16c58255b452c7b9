/* Two packages in one program, C and C++: alone, then interleaved sample by sample, must give the same bytes.
 * Compiled with two packages' headers:
 *     -DFIRST=etel_xy -DFIRST_HEADER='"etel_xy.h"'
 *     -DSECOND=lower -DSECOND_HEADER='"lower.h"'
 * FIRST runs twice at the same time, on two logs. */
#include FIRST_HEADER
#include SECOND_HEADER

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "joined.h"

enum { UPDATES = 40, SAMPLES = 100, AXES = 3 };

static JOIN(FIRST, t) first, twin;
static JOIN(SECOND, t) second;

/* What the axes print after every update, as text with all digits. */
static char alone[AXES][UPDATES][200], together[AXES][UPDATES][200];

static double position_at(long k, double phase)
{
    return 2e-4 * sin(0.002 * (double)k + phase) + 3e-5 * sin(0.013 * (double)k);
}

static double force_at(long k, double phase)
{
    return 4.0 * cos(0.002 * (double)k + phase) + 0.3 * sin(0.7 * (double)k);
}

static void start(int axis)
{
    if (axis == 0) {
        JOIN(FIRST, init)(&first);
    } else if (axis == 1) {
        JOIN(FIRST, init)(&twin);
    } else {
        JOIN(SECOND, init)(&second);
    }
}

static void step(int axis, long k, char (*lines)[200])
{
    const double q = position_at(k, 0.5 * axis), u = force_at(k, 0.5 * axis);
    char *line = lines[k == 0 ? 0 : (k - 1) / SAMPLES];
    if (axis < 2) {
        JOIN(FIRST, t) *self = axis == 0 ? &first : &twin;
        JOIN(FIRST, estimate_t) e;
        const double back = (double)JOIN(FIRST, tick)(self, JOIN(FIRST, position_from_metres)(q), (JOIN(FIRST, real))u);
        JOIN(FIRST, estimate)(self, &e);
        sprintf(
            line, "%.17g %.17g %.17g %.17g %d", back, (double)e.friction, (double)e.parameter[0],
            (double)e.deviation[0], e.status);
    } else {
        JOIN(SECOND, estimate_t) e;
        const double back = (double)JOIN(SECOND, tick)(
            &second, JOIN(SECOND, position_from_metres)(q), (JOIN(SECOND, real))u);
        JOIN(SECOND, estimate)(&second, &e);
        sprintf(
            line, "%.17g %.17g %.17g %.17g %d", back, (double)e.friction, (double)e.parameter[0],
            (double)e.deviation[0], e.status);
    }
}

int main(void)
{
    int wrong = 0;
    for (int axis = 0; axis < AXES; axis++) {
        start(axis);
        for (long k = 0; k <= UPDATES * SAMPLES; k++) {
            step(axis, k, alone[axis]);
        }
    }
    for (int axis = 0; axis < AXES; axis++) {
        start(axis);
    }
    for (long k = 0; k <= UPDATES * SAMPLES; k++) {
        for (int axis = 0; axis < AXES; axis++) {
            step(axis, k, together[axis]);
        }
    }
    for (int axis = 0; axis < AXES; axis++) {
        for (int u = 0; u < UPDATES; u++) {
            wrong += strcmp(alone[axis][u], together[axis][u]) != 0;
        }
        printf("%s\n", together[axis][UPDATES - 1]);
    }
    printf("%d lines differ\n", wrong);
    return wrong != 0;
}
