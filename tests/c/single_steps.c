/* A task that comes in after every single instruction of a call, and asks for the estimate (the processor's trap flag,
 * x86-64 on Linux).
 *
 *     single_steps CALL    feedback: a good update; numeric: one without a solution; reset; hold
 *
 * Prints how often it came in, how many estimates were refused (OVERLAP), and how many are neither that before the call
 * nor that after it, in any bit; the status before and after, by how much the number of updates and `numeric` went up.
 * Compiled with a package:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_UPPER=ETEL_XY -DSGMS_MACHINE_HEADER='"etel_xy.h"' */
#define _GNU_SOURCE
#include <signal.h>
#include <stdio.h>
#include <string.h>

#include "tasks.h"

enum { UPDATES = 9, MOST = 64 };

static machine axis;
static machine_estimate before, after, others[MOST]; /* those that are not the one before, without repetitions */
static volatile long came_in, refused;
static volatile int found, is_on;

static void ask(machine_estimate *estimate)
{
    (void)memset(estimate, 0, sizeof *estimate);
    CALL(estimate)(&axis, estimate);
}

static int differ(const machine_estimate *a, const machine_estimate *b)
{
    return memcmp(a, b, sizeof *a) != 0;
}

static void come_in(int signal_number)
{
    machine_estimate now;
    (void)signal_number;
    if (!is_on) {
        return;
    }
    came_in++;
    ask(&now);
    if (now.status == OVERLAP) {
        refused++;
    } else if (differ(&now, &before) && (found == 0 || differ(&now, &others[found - 1])) && found < MOST) {
        others[found++] = now;
    }
}

static void set_stepping(int on)
{
    is_on = on;
    if (on) {
        __asm__ volatile("pushfq; orq $0x100, (%%rsp); popfq" ::: "cc", "memory");
    } else {
        __asm__ volatile("pushfq; andq $~0x100, (%%rsp); popfq" ::: "cc", "memory");
    }
}

static void do_call(const char *name)
{
    if (strcmp(name, "reset") == 0) {
        CALL(reset)(&axis);
    } else if (strcmp(name, "hold") == 0) {
        (void)CALL(hold)(&axis, 0, 1);
    } else {
        (void)CALL(feedback)(&axis);
    }
}

int main(int argc, char **argv)
{
    long k = 0, wrong = 0;
    if (argc != 2) {
        return 2;
    }
    (void)signal(SIGTRAP, come_in);
    CALL(init)(&axis);
    (void)take_one(&axis, k++);
    for (int update = 0; update < UPDATES; update++) {
        if (update > 0) {
            (void)CALL(feedback)(&axis);
            CALL(prepare)(&axis);
        }
        while (!CALL(due)(&axis)) {
            (void)take_one(&axis, k++);
        }
    }
    CALL(prepare)(&axis);
    if (strcmp(argv[1], "numeric") == 0) {
        const CALL(real) zero = 0;
        axis.sweep.factor[0] = zero / zero;
    }
    ask(&before);
    set_stepping(1);
    do_call(argv[1]);
    set_stepping(0);
    ask(&after);
    for (int i = 0; i < found; i++) {
        wrong += differ(&others[i], &after) != 0;
    }
    printf("%ld %ld %ld %d %d ", came_in, refused, wrong, before.status, after.status);
    printf("%d %d\n", (int)(after.update - before.update), after.numeric - before.numeric);
    return 0;
}
