/* The board of examples/firmware/ on a host: an axis that goes to and fro, and a scheduler that lets the fast task come
 * into the slow one where a function of the package is entered. The package is compiled with -finstrument-functions.
 *
 *     program             the slow task is never interrupted
 *     program everywhere  it is at every entry at which none was interrupted yet, while samples of the interval are
 * left program late N      in every N-th update it is interrupted until feedback is due, and beyond
 *
 * Prints the bits of every force fed forward; then how often the slow task was interrupted, entries of the longest one,
 * and updates whose entries were all interrupted, in one update or another. */
#include "board.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SAMPLES = 100, UPDATES = 700, ENTRIES = 100000 };

void __cyg_profile_func_enter(void *function, void *site);
void __cyg_profile_func_exit(void *function, void *site);

static void (*fast_task)(void);
static long sample, entry, longest, interrupted, late, update;
static int is_given, in_slow, everywhere;
static unsigned char was_interrupted[ENTRIES];
static long entries[UPDATES + 1];

int64_t board_counts(void)
{
    const long k = sample % 3000;
    return 700L * (k < 1500 ? k : 3000 - k);
}

float board_force(void)
{
    return sample % 3000 < 1500 ? 4.0f : -4.0f;
}

void board_feed_forward(float force)
{
    uint32_t bits;
    memcpy(&bits, &force, sizeof bits);
    printf("%08" PRIx32 "\n", bits);
}

void board_stop(const char *why)
{
    printf("stop: %s\n", why);
}

static void take_sample(void)
{
    fast_task();
    sample++;
}

/* Samples of this interval that are left before the one that completes it; none after the last interval. */
static long left(void)
{
    return sample > (long)UPDATES * SAMPLES ? 0 : (SAMPLES - sample % SAMPLES) % SAMPLES;
}

void __cyg_profile_func_enter(void *function, void *site)
{
    (void)function;
    (void)site;
    if (!in_slow) {
        return;
    }
    const int is_late = late && update % late == 0 && entry == 1;
    const int is_due = everywhere && !was_interrupted[entry % ENTRIES] && left() > 0;
    if (is_late || is_due) {
        in_slow = 0; /* what the fast task enters does not count */
        interrupted++;
        was_interrupted[entry % ENTRIES] = 1;
        for (long k = is_late ? left() + 3 : 1; k > 0; k--) {
            take_sample();
        }
        in_slow = 1;
    }
    entry++;
}

void __cyg_profile_func_exit(void *function, void *site)
{
    (void)function;
    (void)site;
}

void rtos_give(void)
{
    is_given = 1;
}

void rtos_run(void (*fast)(void), void (*slow)(void))
{
    fast_task = fast;
    while (sample <= (long)UPDATES * SAMPLES) {
        take_sample();
        if (is_given) {
            is_given = 0;
            entry = 0;
            in_slow = 1;
            slow();
            in_slow = 0;
            longest = entry > longest ? entry : longest;
            entries[update++] = entry;
        }
    }
}

void board_run(void (*sampled)(void))
{
    fast_task = sampled;
    while (sample <= (long)UPDATES * SAMPLES) {
        take_sample();
    }
}

/* The example's own main, under another name. */
int example(void);

int main(int argc, char **argv)
{
    long unseen = 0, whole = 0;
    if (argc == 2) {
        everywhere = 1;
    } else if (argc == 3) {
        late = strtol(argv[2], NULL, 10);
    }
    const int code = example();
    while (unseen < ENTRIES && was_interrupted[unseen]) {
        unseen++;
    }
    for (long k = 0; k < update; k++) {
        whole += entries[k] <= unseen;
    }
    printf("%ld %ld %ld\n", interrupted, longest, whole);
    return code;
}
