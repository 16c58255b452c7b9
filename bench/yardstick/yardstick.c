/* Runs one entry of the yardstick on an emulated microcontroller and counts the instructions of every sample.
 *
 * Reads samples.bin, records of sample_t; writes results.bin, 32-bit words:
 *     size of the entry's memory, ticks of nothing, per sample: ticks and friction; high-water mark of its stack
 * Exit codes as in trial.c. */
#include "entry.h"
#include "target.h"

typedef struct {
    int64_t position; /* pm */
    float force;      /* N */
    float unused;
} sample_t;

enum {
    MEMORY_WORDS = 32768,
    STACK_WORDS = 16384,
    PAINT = 0x5a17ac1d,
    NO_SAMPLES = 2,
    NO_RESULTS = 3,
    STACK_FULL = 4,
    TOO_LONG = 5
};

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

static int open_file(const char *name, uint32_t length, int mode)
{
    uintptr_t arguments[3] = {(uintptr_t)name, (uintptr_t)mode, length};
    return target_host(SYS_OPEN, arguments);
}

static int move(int operation, int file, void *data, uint32_t size)
{
    uintptr_t arguments[3] = {(uintptr_t)file, (uintptr_t)data, size};
    return target_host(operation, arguments) == 0;
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
    for (int i = 0; i < STACK_WORDS; i++) {
        stack[i] = PAINT;
    }
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
    int untouched = 0;
    while (untouched < STACK_WORDS && stack[untouched] == PAINT) {
        untouched++;
    }
    return put_word((uint32_t)(STACK_WORDS - untouched) * sizeof(uint32_t)) ? 0 : NO_RESULTS;
}
