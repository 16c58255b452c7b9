/* Runs one single-precision package on an emulated microcontroller and counts what it costs there.
 *
 * Two estimators take the same samples: one as two tasks would call it (sample, feedback, prepare), one as a single
 * task would (tick). Every call runs on a stack of its own, painted before, and between two readings of the counter.
 *
 * Reads samples.bin, records of sample_t; writes results.bin, 32-bit words and estimates as they lie in memory:
 *     size of the axis, size of an estimate, ticks of nothing, ticks of each calibration loop
 *     first sample: ticks of sample(), of tick()
 *     per update: ticks of sample(), of tick() per sample; of feedback(), of prepare(), of estimate(); both estimates
 *     high-water mark of each stack in bytes
 *
 * Compiled with -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_UPPER=ETEL_XY -DSGMS_MACHINE_HEADER='"etel_xy.h"' and with
 * -DSGMS_LOOPS=<counts of the calibration loops>. Exit codes: 0 done, 2 no samples, 3 results cannot be written,
 * 4 a stack was too small, 5 a call was too long for the counter; 100 and more, from the start code: a fault. */
#include "emulated.h"

#include SGMS_MACHINE_HEADER

#define JOIN2(a, b) a##_##b
#define JOIN(a, b) JOIN2(a, b)
#define CALL(name) JOIN(SGMS_MACHINE, name)

typedef CALL(t) machine;
typedef CALL(estimate_t) machine_estimate;

typedef struct {
    CALL(position) position; /* pm */
    float force;             /* N */
    float unused;
} sample_t;

enum { SAMPLES = JOIN(SGMS_MACHINE_UPPER, SAMPLES) };

/* One stack per call; init and estimate are called now and then, by whoever has the time. */
enum { INIT, SAMPLE, FEEDBACK, PREPARE, TICK, ESTIMATE, CALLS };

uint32_t target_loop_count;

static uint32_t stacks[CALLS + 1][STACK_WORDS] __attribute__((aligned(16)));
static machine two_tasks, one_task;
static sample_t sample;
static machine_estimate estimate;
static volatile float compensation;
static int input, output, too_long;

/* --- what is measured -------------------------------------------------------------------------------------------- */

static void do_init(void)
{
    CALL(init)(&two_tasks);
}

static void do_sample(void)
{
    compensation = CALL(sample)(&two_tasks, sample.position, sample.force);
}

static void do_feedback(void)
{
    (void)CALL(feedback)(&two_tasks);
}

static void do_prepare(void)
{
    CALL(prepare)(&two_tasks);
}

static void do_tick(void)
{
    compensation = CALL(tick)(&one_task, sample.position, sample.force);
}

static void do_estimate(void)
{
    CALL(estimate)(&two_tasks, &estimate);
}

static uint32_t measure(int call, void (*work)(void))
{
    const uint32_t ticks = target_measure(work, stacks[call] + STACK_WORDS);
    too_long |= ticks == UINT32_MAX;
    return ticks;
}

/* --- stacks ------------------------------------------------------------------------------------------------------ */

static void paint_stacks(void)
{
    for (int call = 0; call < CALLS; call++) {
        paint_stack(stacks[call]);
    }
}

/* --- host -------------------------------------------------------------------------------------------------------- */

static void close_file(int file)
{
    uintptr_t arguments[1] = {(uintptr_t)file};
    (void)target_host(SYS_CLOSE, arguments);
}

static int put_word(uint32_t word)
{
    return move(SYS_WRITE, output, &word, sizeof word);
}

static int next_sample(void)
{
    return move(SYS_READ, input, &sample, sizeof sample);
}

/* --- trial ------------------------------------------------------------------------------------------------------- */

static int calibrate(void)
{
    static const uint32_t loops[] = {SGMS_LOOPS};
    int good = put_word(measure(CALLS, target_nothing));
    for (unsigned i = 0; i < sizeof loops / sizeof loops[0]; i++) {
        target_loop_count = loops[i];
        good = good && put_word(measure(CALLS, target_loop));
    }
    return good;
}

static int put_estimates(void)
{
    static machine next; /* one_task as the next tick() begins, which makes its update */
    int good = put_word(measure(ESTIMATE, do_estimate)) && move(SYS_WRITE, output, &estimate, sizeof estimate);
    next = one_task;
    (void)CALL(feedback)(&next);
    CALL(estimate)(&next, &estimate);
    return good && move(SYS_WRITE, output, &estimate, sizeof estimate);
}

/* One interval; 0 at the end of the series, where a call was too long, or where nothing can be written. */
static int update(void)
{
    uint32_t ticks[2 * SAMPLES];
    for (int k = 0; k < SAMPLES; k++) {
        if (too_long || !next_sample()) {
            return 0;
        }
        ticks[2 * k] = measure(SAMPLE, do_sample);
        ticks[2 * k + 1] = measure(TICK, do_tick);
    }
    return move(SYS_WRITE, output, ticks, sizeof ticks) && put_word(measure(FEEDBACK, do_feedback)) &&
           put_word(measure(PREPARE, do_prepare)) && put_estimates();
}

int target_main(void)
{
    input = open_file("samples.bin", 11, 1);  /* "rb" */
    output = open_file("results.bin", 11, 5); /* "wb" */
    paint_stacks();
    if (output < 0 || !put_word(sizeof(machine)) || !put_word(sizeof(machine_estimate)) || !calibrate()) {
        return NO_RESULTS;
    }
    (void)measure(INIT, do_init);
    CALL(init)(&one_task);
    if (input < 0 || !next_sample()) {
        return NO_SAMPLES;
    }
    if (!put_word(measure(SAMPLE, do_sample)) || !put_word(measure(TICK, do_tick))) {
        return NO_RESULTS;
    }
    while (update()) {
    }
    if (too_long) { /* calibration included */
        return TOO_LONG;
    }
    for (int call = 0; call < CALLS; call++) {
        const uint32_t used = used_stack(stacks[call]);
        if (used == sizeof stacks[call]) {
            return STACK_FULL;
        }
        if (!put_word(used)) {
            return NO_RESULTS;
        }
    }
    close_file(output);
    return 0;
}
