/* What every entry of the yardstick gives: a friction observer for the axis of README.md, on caller-owned memory. */
#ifndef YARDSTICK_ENTRY_H
#define YARDSTICK_ENTRY_H

#include <stdint.h>

/* Bytes of one axis, at most those that `yardstick.c` holds. */
uint32_t entry_size(void);

/* Start from the numbers that the axis is believed to have. */
void entry_init(void *memory);

/* One sample at 10 kHz: position in picometres, force in newtons; returns the friction at this instant [N]. */
float entry_tick(void *memory, int64_t position, float force);

#endif
