/* What the two examples ask of hardware and RTOS: the functions that a project has under other names. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* Counts of the encoder, 1 nm each; drive force of the sample before [N]. */
int64_t board_counts(void);
float board_force(void);

/* Add to the drive's command [N]. */
void board_feed_forward(float force);

/* No motion: switch the drive off, say why. Does not come back on a target. */
void board_stop(const char *why);

/* Call `sampled` at 10 kHz, from the timer's interrupt. Does not come back on a target. */
void board_run(void (*sampled)(void));

/* Two tasks: `fast` at 10 kHz, which interrupts `slow`; `slow` once after every rtos_give(), which `fast` calls. */
void rtos_run(void (*fast)(void), void (*slow)(void));
void rtos_give(void);

#endif
