/* An axis on a processor, or of a build, whose numbers are not those that the code is written for.
 *
 * Prints what check() and the self-test say; the statuses of the axis after init(), of an update, and of the axis at
 * the end, after all calls that might set it right; samples that were fed something forward. -DMXCSR=... sets x86's
 * control word of arithmetic. Compiled with a package and its self-test:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_UPPER=ETEL_XY -DSGMS_MACHINE_HEADER='"etel_xy.h"' */
#include <stdio.h>
#ifdef MXCSR
#include <xmmintrin.h>
#endif

#include "tasks.h"

static machine axis;

static int status(void)
{
    machine_estimate now;
    CALL(estimate)(&axis, &now);
    return now.status;
}

int main(void)
{
    volatile CALL(real) zero = 0;
    const CALL(real) none = zero / zero;
    int fed = 0, check, selftest, first, update = 0;
#ifdef MXCSR
    _mm_setcsr(MXCSR);
#endif
    check = CALL(check)(sizeof axis, JOIN(SGMS_MACHINE_UPPER, HEADER));
    selftest = CALL(selftest)();
    CALL(init)(&axis);
    first = status();
    for (long k = 0; k <= 8 * SAMPLES; k++) {
        if (k == 2 * SAMPLES) {
            CALL(reset)(&axis);
            CALL(compensate)(&axis, 1);
        }
        if (k == 4 * SAMPLES) {
            (void)CALL(hold)(&axis, 0, 1);
        }
        fed += take_one(&axis, k);
        fed += k % 50 < 3 ? CALL(tick)(&axis, CALL(position_from_metres)(0.0), none) != (CALL(real))0 : 0;
        CALL(prepare)(&axis);
        if (CALL(due)(&axis) || k == 3 * SAMPLES) {
            update = CALL(feedback)(&axis);
        }
    }
    printf("%d %d %d %d %d %d\n", check, selftest, first, update < 0 ? update : 0, status(), fed);
    return 0;
}
