/* What programs on an emulated microcontroller share: files of the host, painted stacks, exit codes. */
#ifndef BENCH_EMULATED_H
#define BENCH_EMULATED_H

#include "target.h"

enum { STACK_WORDS = 16384, PAINT = 0x5a17ac1d, NO_SAMPLES = 2, NO_RESULTS = 3, STACK_FULL = 4, TOO_LONG = 5 };

static inline int open_file(const char *name, uint32_t length, int mode)
{
    uintptr_t arguments[3] = {(uintptr_t)name, (uintptr_t)mode, length};
    return target_host(SYS_OPEN, arguments);
}

/* Whether all bytes were moved: the host answers with how many were not. */
static inline int move(int operation, int file, void *data, uint32_t size)
{
    uintptr_t arguments[3] = {(uintptr_t)file, (uintptr_t)data, size};
    return target_host(operation, arguments) == 0;
}

static inline void paint_stack(uint32_t *stack)
{
    for (int i = 0; i < STACK_WORDS; i++) {
        stack[i] = PAINT;
    }
}

/* Bytes of a stack that were ever written. */
static inline uint32_t used_stack(const uint32_t *stack)
{
    int free = 0;
    while (free < STACK_WORDS && stack[free] == PAINT) {
        free++;
    }
    return (uint32_t)(STACK_WORDS - free) * sizeof(uint32_t);
}

#endif
