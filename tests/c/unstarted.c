/* Memory that init() has never set up, full of one byte: what each call says of it. Prints for each byte the largest
 * number that a call returned, the statuses of all calls, and whether the axis starts after that. Compiled with a
 * package:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_UPPER=ETEL_XY -DSGMS_MACHINE_HEADER='"etel_xy.h"' */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "tasks.h"

static machine axis;
static CALL(estimate_t) now;
static CALL(saved_t) saved;

/* Largest number of an estimate; whatever was in it before. */
static double largest_of_estimate(void)
{
    double largest = 0.0;
    memset(&now, 0x40, sizeof now);
    CALL(estimate)(&axis, &now);
    for (size_t i = 0; i < offsetof(CALL(estimate_t), status) / sizeof(CALL(real)); i++) {
        largest = fmax(largest, fabs((double)((const CALL(real) *)&now)[i]));
    }
    return fmax(largest, (double)now.update + (double)now.age + (double)abs(now.numeric));
}

int main(void)
{
    static const int fills[] = {0x00, 0xff, 0x55, 0x40, 0x7f};
    const CALL(position) at = CALL(position_from_metres)(1e-3);
    const CALL(signals) signals = {0, 0, 0, 1, 1, 1, 0};
    for (size_t k = 0; k < sizeof fills / sizeof *fills; k++) {
        double largest = 0.0;
        memset(&axis, fills[k], sizeof axis);
        CALL(ahead)(&axis, (CALL(real))0.01, 0);
        CALL(compensate)(&axis, 1);
        for (int round = 0; round < 2; round++) { /* a reset makes no axis of it */
            for (int i = 0; i < 3; i++) {
                largest = fmax(largest, fabs((double)CALL(tick)(&axis, at, 1)));
                largest = fmax(largest, fabs((double)CALL(sample)(&axis, at, 1)));
                largest = fmax(largest, fabs((double)CALL(insert)(&axis, &signals)));
                largest = fmax(largest, fabs((double)CALL(share)(&axis)) + abs(CALL(due)(&axis)));
                CALL(prepare)(&axis);
            }
            largest = fmax(largest, largest_of_estimate());
            memset(&saved, 0x55, sizeof saved);
            printf(
                "%d %d %d %d ", CALL(feedback)(&axis), now.status, CALL(save)(&axis, &saved),
                CALL(load)(&axis, &saved));
            printf("%d %d ", CALL(hold)(&axis, 0, 1), CALL(set_parameter)(&axis, 0, 1, 1));
            printf("%d ", CALL(set_mass)(&axis, 1));
#ifdef HAS_ORIGIN
            printf("%d ", CALL(set_origin)(&axis, at));
#endif
            CALL(reset)(&axis);
        }
        CALL(init)(&axis);
        CALL(estimate)(&axis, &now);
        printf("%g %d %d\n", largest, CALL(load)(&axis, &saved), now.status);
    }
    return 0;
}
