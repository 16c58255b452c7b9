/* Two tasks on one axis, the one interrupting the other at a place that is chosen: the package is compiled with
 * -finstrument-functions, and the n-th function entered inside of a call is where the other task comes in. Every update
 * another place.
 *
 *     preemption NAME     feedback, reset, prepare, sample or tick inside of prepare;
 *                         prepare_in_feedback, estimate_in_feedback, init_in_feedback
 *
 * Prints how often the other task came in, how often it was refused (status OVERLAP), and how many estimates after
 * updates are not, bit by bit, those of calls one after the other. After an init() that came in, which is not allowed:
 * how often the estimate was refused when all calls were over. Compiled with a package, itself not instrumented:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_UPPER=ETEL_XY -DSGMS_MACHINE_HEADER='"etel_xy.h"' */
#include <stdio.h>
#include <string.h>

#include "tasks.h"

enum { UPDATES = 120 };

void __cyg_profile_func_enter(void *function, void *site);
void __cyg_profile_func_exit(void *function, void *site);

static machine axis, alone, undisturbed;
static machine_estimate seen;
static long entered, come_in_at = -1, in_call, sample_at; /* functions entered; the one at which to interrupt, or -1 */
static int came_in, refused, wrong;
static const char *other;

/* What the other task does. */
static void come_in(void)
{
    came_in++;
    if (strcmp(other, "feedback") == 0) {
        refused += CALL(feedback)(&axis) == OVERLAP;
    } else if (strcmp(other, "reset") == 0) {
        CALL(reset)(&axis);
    } else if (strcmp(other, "sample") == 0) {
        (void)take_one(&axis, sample_at++);
    } else if (strcmp(other, "tick") == 0) {
        (void)CALL(tick)(&axis, CALL(position_from_metres)(0.0), (CALL(real))0);
        CALL(estimate)(&axis, &seen);
        refused += seen.status == OVERLAP;
    } else if (strcmp(other, "estimate_in_feedback") == 0) {
        CALL(estimate)(&axis, &seen);
        refused += seen.status == OVERLAP;
    } else if (strcmp(other, "init_in_feedback") == 0) {
        CALL(init)(&axis);
    } else {
        CALL(prepare)(&axis);
    }
}

void __cyg_profile_func_enter(void *function, void *site)
{
    (void)function;
    (void)site;
    in_call++;
    if (entered++ == come_in_at) {
        come_in_at = -1;
        come_in();
    }
}

void __cyg_profile_func_exit(void *function, void *site)
{
    (void)function;
    (void)site;
    in_call--;
}

/* The place for the next interruption, given how many functions the last call of that kind has entered. */
static void plan(long length)
{
    static uint32_t random = 1;
    random = random * 1664525u + 1013904223u;
    entered = 0;
    come_in_at = length > 1 ? 1 + (long)(random >> 8) % (length - 1) : -1;
}

int main(int argc, char **argv)
{
    machine_estimate before, after, expected;
    long length = 0;
    int is_feedback, is_init, statuses = 0;
    if (argc != 2) {
        return 2;
    }
    other = argv[1];
    is_feedback = strstr(other, "_in_feedback") != 0;
    is_init = strcmp(other, "init_in_feedback") == 0;
    CALL(init)(&axis);
    CALL(init)(&alone);
    (void)take_one(&axis, sample_at++);
    (void)take_one(&alone, 0);
    for (long update = 0; update < UPDATES; update++) {
        const int before_end = strcmp(other, "sample") == 0; /* prepare runs while the interval is filling */
        for (long k = update * SAMPLES + 1; k <= (update + 1) * SAMPLES; k++) {
            (void)take_one(&alone, k);
        }
        (void)CALL(feedback)(&alone);
        while (sample_at <= (update + 1) * SAMPLES) {
            if (before_end && sample_at == update * SAMPLES + 40) {
                plan(length);
                CALL(prepare)(&axis);
                length = entered;
                come_in_at = -1;
            }
            (void)take_one(&axis, sample_at++);
        }
        if (!before_end && !is_feedback) { /* the slower task is late: the interval is complete */
            plan(length);
            CALL(prepare)(&axis);
            length = entered;
            come_in_at = -1;
        }
        CALL(estimate)(&axis, &before);
        seen = before;
        if (is_init) { /* further and further from the end, near which the numbers are written */
            undisturbed = axis;
            entered = 0;
            (void)CALL(feedback)(&undisturbed);
            come_in_at = entered - 1 - update;
            entered = 0;
        } else if (is_feedback) {
            plan(length);
        }
        statuses += CALL(feedback)(&axis) == OVERLAP;
        if (is_feedback) {
            length = entered;
            come_in_at = -1;
        }
        CALL(estimate)(&axis, &after);
        CALL(estimate)(&alone, &expected);
        if (is_init) {
            refused += after.status == OVERLAP;
            axis = undisturbed;
        }
        wrong += !is_same(&after, &expected) || after.status != expected.status;
        if (seen.status != OVERLAP) { /* what a third task saw is of one update */
            wrong += !is_same(&seen, &before) && !is_same(&seen, &after);
        }
    }
    printf("%d %d %d %d\n", came_in, refused, wrong, statuses);
    return in_call != 0;
}
