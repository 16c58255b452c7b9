/* Every bit of the signal chain's counts flipped in turn, on an axis that moves, and a sample lost after that.
 *
 * Prints the bits after which measurements are still missing SECOND samples later, one a line: count, bit. Compiled
 * with a package: -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_UPPER=ETEL_XY -DSGMS_MACHINE_HEADER='"etel_xy.h"' */
#include <stdio.h>

#include SGMS_MACHINE_HEADER

#include "joined.h"

typedef CALL(real) real;

enum { SECOND = 10000 };

static CALL(t) axis;

/* A motion to and fro, its first sample without a force; returns the status of its last update. */
static int move(void)
{
    const real zero = 0;
    CALL(estimate_t) estimate;
    for (long k = 0; k < SECOND; k++) {
        const int64_t place = k % 2000 < 1000 ? k % 1000 : 1000 - k % 1000;
        const real force = k == 0 ? zero / zero : (real)(k % 7 - 3);
        (void)CALL(tick)(&axis, CALL(position_from_counts)(100 * place, 1, 1000), force);
    }
    CALL(estimate)(&axis, &estimate);
    return estimate.status;
}

int main(void)
{
    const int counts = (int)(sizeof axis.chain.counts / sizeof axis.chain.counts[0]), bits = 32;
    int before;
    CALL(init)(&axis);
    before = move();
    for (int i = 0; i < counts * bits; i++) {
        const CALL(t) good = axis;
        int after;
        axis.chain.counts[i / bits] = (int32_t)((uint32_t)axis.chain.counts[i / bits] ^ (UINT32_C(1) << i % bits));
        after = move();
        if (before < 0 || (before & JOIN(SGMS_MACHINE_UPPER, MISSING)) != 0) {
            return 1;
        }
        if (after < 0 || (after & JOIN(SGMS_MACHINE_UPPER, MISSING)) != 0) {
            printf("%d %d\n", i / bits, i % bits);
        }
        axis = good;
    }
    return 0;
}
