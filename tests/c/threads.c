/* Two tasks on one axis that run side by side: the faster one takes samples and updates, the slower one prepares.
 *
 *     threads interrupt    one core: the faster task is the handler of a timer, between any two instructions
 *     threads patient      two threads; the faster one asks for an update again until prepare has returned
 *     threads hurried      two threads; it asks once, and goes on sampling
 *     threads series       nothing: where the series lies in the memory of an axis, and its size, in bytes
 *
 * Prints updates, samples taken while prepare was under way, updates refused (OVERLAP) at least once, and estimates
 * that are not, bit by bit, those of one task. In "hurried" that is not counted: there samples are lost, and estimates
 * and statuses are told from what can be. Two threads keep to what is asked of tasks on two cores: SGMS_FENCE() is a
 * barrier, and prepare() starts after feedback() has returned, by a semaphore. Neither of prepare() and feedback() is
 * called while the other begins.
 *
 * For two threads the package is compiled with -finstrument-functions: inside of prepare the slower one waits, now and
 * then, for a sample of the faster one. So they meet on any machine. The waiting orders nothing (relaxed atomics). */
#include <pthread.h>
#include <sched.h>
#include <semaphore.h>
#include <signal.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>
#include <sys/time.h>
#include <unistd.h>

#include "tasks.h"

enum { UPDATES = 60, EVERY = 7, PERIOD_US = 40, MOST_S = 120 };

static machine axis, alone;
static sem_t updated;
/* Read by both: samples taken, prepares begun, whether one is under way, whether an update waits for it, whether all is
 * done. */
static int taken, begun, preparing, waiting, over;
static long sample_at, updates, met, refused, wrong, lost;
static int was_refused, is_hurried;

static int seen(const int *flag)
{
    return __atomic_load_n(flag, __ATOMIC_RELAXED);
}

static void tell(int *flag, int value)
{
    __atomic_store_n(flag, value, __ATOMIC_RELAXED);
}

static void take_next(void)
{
    met += seen(&preparing);
    (void)take_one(&axis, sample_at++);
    tell(&taken, seen(&taken) + 1);
}

/* Of one task, up to the update that is done. */
static void compare(void)
{
    static long k;
    machine_estimate ours, theirs;
    while (k <= updates * SAMPLES) {
        (void)take_one(&alone, k++);
    }
    (void)CALL(feedback)(&alone);
    CALL(estimate)(&axis, &ours);
    CALL(estimate)(&alone, &theirs);
    wrong += !is_same(&ours, &theirs) || ours.status != theirs.status;
}

/* Ask for the update; whether it was done. */
static int update(void)
{
    const int status = CALL(feedback)(&axis);
    if (status == OVERLAP) {
        refused += !was_refused;
        was_refused = 1;
        tell(&waiting, 1);
        return 0;
    }
    was_refused = 0;
    tell(&waiting, 0);
    updates++;
    return 1;
}

static int is_plausible(void)
{
    machine_estimate now;
    int good = 1;
    CALL(estimate)(&axis, &now);
    for (int i = 0; i < JOIN(SGMS_MACHINE_UPPER, PARAMETERS); i++) {
        good = good && now.parameter[i] > (CALL(real))0 && now.deviation[i] * (CALL(real))0 == (CALL(real))0;
    }
    lost += (now.status & JOIN(SGMS_MACHINE_UPPER, OVERRUN)) != 0;
    return good;
}

/* --- one core ---------------------------------------------------------------------------------------------------- */

/* A sample, or where the last one completed an interval, its update: until it is done no further sample is taken. */
static void interrupt(int signal_number)
{
    static int is_due;
    (void)signal_number;
    if (updates == UPDATES) {
        return;
    }
    if (!is_due) {
        take_next();
        is_due = CALL(due)(&axis);
    }
    if (is_due && update()) {
        compare();
        is_due = 0;
        tell(&over, updates == UPDATES);
    }
}

static void interrupted(void)
{
    const struct itimerval period = {{0, PERIOD_US}, {0, PERIOD_US}}, none = {{0, 0}, {0, 0}};
    (void)signal(SIGALRM, interrupt);
    (void)setitimer(ITIMER_REAL, &period, NULL);
    while (!seen(&over)) {
        tell(&preparing, 1);
        CALL(prepare)(&axis);
        tell(&preparing, 0);
    }
    (void)setitimer(ITIMER_REAL, &none, NULL);
}

/* --- two threads ------------------------------------------------------------------------------------------------- */

enum { OUTSIDE, ENTERED, BEGUN };

static __thread int is_inside; /* of prepare, in a thread of its own */

/* From here on feedback() sees that prepare is under way. */
static void has_begun(void)
{
    if (is_inside != BEGUN) {
        is_inside = BEGUN;
        tell(&begun, seen(&begun) + 1);
    }
}

static void *slower(void *unused)
{
    (void)unused;
    for (;;) {
        (void)sem_wait(&updated);
        if (seen(&over)) {
            return NULL;
        }
        tell(&preparing, 1);
        CALL(prepare)(&axis);
        tell(&preparing, 0);
    }
}

static void side_by_side(int is_patient)
{
    pthread_t thread;
    (void)sem_init(&updated, 0, 0);
    (void)pthread_create(&thread, NULL, slower, NULL);
    take_next();
    while (updates < UPDATES) {
        while (seen(&begun) < updates) {
            (void)sched_yield();
        }
        take_next();
        if (!CALL(due)(&axis)) {
            continue;
        }
        while (!update()) {
            if (is_patient) {
                (void)sched_yield();
            } else {
                (void)take_one(&axis, sample_at++); /* it is lost */
            }
        }
        if (is_patient) {
            compare();
        } else {
            wrong += !is_plausible();
        }
        (void)sem_post(&updated);
    }
    tell(&over, 1);
    (void)sem_post(&updated);
    (void)pthread_join(thread, NULL);
}

void __cyg_profile_func_enter(void *function, void *site);
void __cyg_profile_func_exit(void *function, void *site);

void __cyg_profile_func_enter(void *function, void *site)
{
    static long entered;
    (void)site;
    if (function == (void *)CALL(prepare)) {
        is_inside = ENTERED;
    } else if (is_inside == ENTERED) {
        has_begun();
        while (is_hurried && !seen(&waiting) && !seen(&over)) {
            (void)sched_yield(); /* the faster one is to come too early */
        }
    }
    if (is_inside == BEGUN && ++entered % EVERY == 0) {
        const int before = seen(&taken);
        while (seen(&taken) == before && !seen(&waiting) && !seen(&over)) {
            (void)sched_yield();
        }
    }
}

void __cyg_profile_func_exit(void *function, void *site)
{
    (void)site;
    if (is_inside && function == (void *)CALL(prepare)) {
        has_begun();
        is_inside = OUTSIDE;
    }
}

int main(int argc, char **argv)
{
    if (argc != 2) {
        return 2;
    }
    if (strcmp(argv[1], "series") == 0) {
        printf("%zu %zu\n", offsetof(machine, window), offsetof(machine, window.node) - offsetof(machine, window));
        return 0;
    }
    CALL(init)(&axis);
    CALL(init)(&alone);
    if (strcmp(argv[1], "interrupt") == 0) {
        interrupted();
    } else {
        (void)alarm(MOST_S);
        is_hurried = strcmp(argv[1], "hurried") == 0;
        side_by_side(!is_hurried);
    }
    printf("%ld %ld %ld %ld %ld\n", updates, met, refused, wrong, lost);
    return 0;
}
