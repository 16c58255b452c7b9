/* What the parts of the fuzzed program share: an input taken apart (fuzz_input.c), what has to hold (fuzz_checks.c),
 * what comes in between (fuzz_others.c). */
#ifndef FUZZ_H
#define FUZZ_H

#include "package.h"

/* The bytes that are left of an input; zeros behind them. */
typedef struct {
    const uint8_t *at;
    size_t left;
} bytes;

/* Arguments from an input. */
unsigned take_byte(bytes *from);
uint64_t take_bits(bytes *from);
double take_double(bytes *from); /* any bits, an edge of something, or of the size of signals */
machine_real take_real(bytes *from);
machine_position take_position(bytes *from);

/* Calls done: of all inputs, and of the one under way. */
extern unsigned long long calls, calls_of_input;

/* End the program with a message; the second one where something is not so. */
void fail(const char *what);
void hold(int is_so, const char *what);

/* Of what a call returned; each counts it. */
void check_force(machine_real force);
int check_status(int status);

/* Of an axis between two calls. */
void check_estimate(const machine *axis);
void check_fields(const machine *axis);
void check_same(const machine *a, const machine *b, const char *what);

/* Sample k of a motion as an axis makes it, the next at every call (fuzz.c). */
void next_good(machine_position *position, machine_real *force);

/* Calls that others make. */
void interrupt_call(bytes *from, machine *axis);
void load_others(bytes *from, machine *axis);

#endif
