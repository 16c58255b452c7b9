/* Runs one entry of the yardstick on an emulated microcontroller and counts the instructions of every sample.
 *
 * Reads samples.bin, records of sample_t; writes results.bin, 32-bit words:
 *     size of the entry's memory, ticks of nothing, per sample: ticks and friction; high-water mark of its stack
 * Exit codes as in trial.c. */
#include "emulated.h"
#include "entry.h"

typedef struct {
    int64_t position; /* pm */
    float force;      /* N */
    float unused;
} sample_t;

enum { MEMORY_WORDS = 32768 };

uint32_t target_loop_count;

static uint32_t stack[STACK_WORDS] __attribute__((aligned(16)));
static uint64_t memory[MEMORY_WORDS / 2];
static sample_t sample;
static struct {
    uint32_t ticks;
    float friction;
} result;
static int input, output;

static void do_tick(void)
{
    result.friction = entry_tick(memory, sample.position, sample.force);
}

static int put_word(uint32_t word)
{
    return move(SYS_WRITE, output, &word, sizeof word);
}

int target_main(void)
{
    input = open_file("samples.bin", 11, 1);  /* "rb" */
    output = open_file("results.bin", 11, 5); /* "wb" */
    if (entry_size() > sizeof memory) {
        return STACK_FULL;
    }
    if (!put_word(entry_size()) || !put_word(target_measure(target_nothing, stack + STACK_WORDS))) {
        return NO_RESULTS;
    }
    paint_stack(stack);
    entry_init(memory);
    int count = 0;
    while (move(SYS_READ, input, &sample, sizeof sample)) {
        result.ticks = target_measure(do_tick, stack + STACK_WORDS);
        if (result.ticks == UINT32_MAX) {
            return TOO_LONG;
        }
        if (!move(SYS_WRITE, output, &result, sizeof result)) {
            return NO_RESULTS;
        }
        count++;
    }
    if (count == 0) {
        return NO_SAMPLES;
    }
    return put_word(used_stack(stack)) ? 0 : NO_RESULTS;
}
