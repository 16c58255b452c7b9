/* Single bits of the memory of an axis flipped between two samples of a motion, each on an axis of its own, under
 * sanitizers. Within a second the estimate has to come back to that of an axis without it, or its status has to say
 * otherwise; and whatever happens, the force is a number within its limit.
 *
 *     upset SEED FLIPS     prints byte and bit of those that are neither; how many there are of each, and of the last
 * in the settings and in the factors of the estimate
 *
 * Compiled as package.h says. */
#include "package.h"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LEAD = HORIZON + 20, SPAN = 6 /* s, of the motion */ };

typedef struct {
    machine_position position;
    machine_real force;
} sample;

static long samples, updates, second; /* of the motion; of one second */
static sample *motion;
static machine *kept; /* the axis without a flip, at every update */
static uint64_t noise = 1;

static uint32_t next_random(void)
{
    noise = noise * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (uint32_t)(noise >> 32);
}

static void fail(const char *what)
{
    fprintf(stderr, "upset: %s\n", what);
    exit(3);
}

static void *memory_of(size_t count, size_t size)
{
    void *const memory = calloc(count, size);
    if (!memory) {
        fail("no memory");
    }
    return memory;
}

/* The motion, and an axis along it whose friction is what the model says, but for noise. */
static void record(void)
{
    const double h = (double)SAMPLE_TIME, rate = 6.0, wide = 300.0 * (double)HOLD_PATH;
    machine *const axis = memory_of(1, sizeof *axis);
    double fed = 0.0;
    second = (long)(1.0 / h + 0.5);
    updates = SPAN * second / SAMPLES;
    samples = updates * SAMPLES;
    motion = memory_of((size_t)samples + 1, sizeof *motion);
    kept = memory_of((size_t)updates, sizeof *kept);
    CALL(init)(axis);
    for (long k = 0; k <= samples; k++) { /* to and fro, and on */
        const double t = (double)k * h * rate, turn = t - 4.0 * (double)(long)(t / 4.0);
        const double s = turn < 2.0 ? turn - 1.0 : 3.0 - turn;
        const double push = (double)MASS * wide * -3.0 * s * rate * rate;
        const double error = 0.3 * (double)MEASUREMENT_SD * ((double)next_random() / 2147483648.0 - 1.0);
        motion[k].position = CALL(position_from_metres)(wide * (s * (1.5 - 0.5 * s * s) + 0.1 * t));
        motion[k].force = (machine_real)(fed + push + error);
        fed = (double)CALL(tick)(axis, motion[k].position, motion[k].force);
        if (k % SAMPLES == 0 && k > 0) {
            kept[k / SAMPLES - 1] = *axis;
        }
    }
    free(axis);
}

static double size_of(double x)
{
    return x < 0.0 ? -x : x;
}

/* Whether an estimate is the other one but for what its own deviations leave open. */
static int is_back(const machine_estimate *a, const machine_estimate *b)
{
    int same = a->status == b->status && size_of((double)(a->friction - b->friction)) <= 3.0 * (double)MEASUREMENT_SD;
    for (int p = 0; p < PARAMETERS; p++) {
        const double off = size_of((double)(a->parameter[p] - b->parameter[p]));
        const double sd = (double)(a->deviation[p] > b->deviation[p] ? a->deviation[p] : b->deviation[p]);
        same = same && off <= 3.0 * sd && a->deviation[p] >= b->deviation[p] / (machine_real)3;
    }
    return same;
}

enum { BACK, TOLD, SILENT };
enum { /* that the estimate is not to be relied on */
       TELLS = CONSTANT(MISSING) + CONSTANT(DOUBT) + CONSTANT(OVERRUN) + CONSTANT(STALE) + CONSTANT(SPEED) +
       CONSTANT(BOUND)
};

/* One flip before a sample; what has become of it after a second. */
static int try_flip(machine *axis, long first, size_t bit)
{
    const long end = (first + second) / SAMPLES * SAMPLES;
    machine_estimate now = {0}, wanted = {0};
    long k;
    int is_told = 0;
    *axis = kept[first / SAMPLES - 1];
    for (k = first / SAMPLES * SAMPLES + 1; k < first; k++) {
        (void)CALL(tick)(axis, motion[k].position, motion[k].force);
    }
    ((unsigned char *)axis)[bit / 8] ^= (unsigned char)(1u << bit % 8);
    for (; k <= end; k++) {
        const machine_real given = CALL(tick)(axis, motion[k].position, motion[k].force);
        if (!(given - given == (machine_real)0)) {
            fail("a force that is no number");
        }
#ifdef FORCE_LIMIT
        if (given > FORCE_LIMIT || given < -FORCE_LIMIT) {
            fail("a force beyond its limit");
        }
#endif
        if (k % SAMPLES == 0) {
            const machine *const other = &kept[k / SAMPLES - 1];
            if (memcmp(axis, other, sizeof *axis) == 0) {
                return BACK;
            }
            CALL(estimate)(axis, &now);
            CALL(estimate)(other, &wanted);
            is_told = is_told ||
                      (now.status < 0 ? now.status != wanted.status : (now.status & ~wanted.status & TELLS) != 0);
        }
    }
    return is_back(&now, &wanted) ? BACK : is_told ? TOLD : SILENT;
}

int main(int argc, char **argv)
{
    long counts[3] = {0, 0, 0}, settings = 0, factors = 0, flips;
    machine *axis;
    if (argc != 3) {
        return 2;
    }
    record();
    noise = strtoull(argv[1], NULL, 10) * 2 + 1;
    flips = strtol(argv[2], NULL, 10);
    axis = memory_of(1, sizeof *axis);
    for (long i = 0; i < flips; i++) {
        const uint32_t places = (uint32_t)(samples - second - (long)LEAD * SAMPLES);
        const long first = (long)LEAD * SAMPLES + (long)(next_random() % places);
        const size_t bit = next_random() % (8 * sizeof *axis);
        const int outcome = try_flip(axis, first, bit);
        counts[outcome]++;
        if (outcome == SILENT) {
            settings += bit / 8 < sizeof axis->settings;
            factors += bit / 8 - offsetof(machine, sweep) < sizeof axis->sweep;
            printf("byte %lu, bit %lu, sample %ld\n", (unsigned long)(bit / 8), (unsigned long)(bit % 8), first);
        }
    }
    printf("%ld flips, %ld back, %ld told, %ld silent, ", flips, counts[BACK], counts[TOLD], counts[SILENT]);
    printf("%ld in settings, %ld in factors\n", settings, factors);
    free(axis);
    return 0;
}
