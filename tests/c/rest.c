/* An axis that moves, then stands: with its drive off, and with a force that stays.
 *
 * Prints, for either, how many samples behind the motion met a subnormal number, how many of the last ones did, and how
 * many of these left the filters other than zero. Of an x86 processor, whose flags tell. Compiled with a package:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_UPPER=ETEL_XY -DSGMS_MACHINE_HEADER='"etel_xy.h"' */
#include <stdio.h>
#include <xmmintrin.h>

#include SGMS_MACHINE_HEADER

#include "joined.h"

typedef CALL(real) real;

enum { MOTION = 6000, REST = 40000, LAST = 5000, DENORMAL = 2, FLAGS = 0x3f };

static CALL(t) axis;

/* One sample, and the interval's update where it is due: 1 where sample() met a subnormal number. */
static int take(int64_t nanometres, real force)
{
    int met;
    _mm_setcsr(_mm_getcsr() & ~(unsigned)FLAGS);
    (void)CALL(sample)(&axis, CALL(position_from_counts)(nanometres, 1, 1000), force);
    met = (_mm_getcsr() & DENORMAL) != 0;
    if (CALL(due)(&axis)) {
        (void)CALL(feedback)(&axis);
        CALL(prepare)(&axis);
    }
    return met;
}

int main(void)
{
    for (int on = 0; on < 2; on++) {
        int64_t position = 0;
        int decaying = 0, last = 0, moving = 0;
        CALL(init)(&axis);
        CALL(compensate)(&axis, 1);
        for (int k = 0; k < MOTION; k++) {
            position += 100 * (k < MOTION / 2 ? k : MOTION - k);
            (void)take(position, (real)(k % 700) / (real)100);
        }
        for (int k = 0; k < REST; k++) {
            const int met = take(position, (real)(2 * on));
            decaying += met;
            last += met && k >= REST - LAST;
            moving += k >= REST - LAST && axis.chain.lowpass[0] != (real)0;
        }
        printf("%d %d %d\n", decaying, last, moving);
    }
    return 0;
}
