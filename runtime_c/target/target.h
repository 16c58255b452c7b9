/* What the start code of a target gives to the trial that runs there. */
#ifndef SGMS_TARGET_H
#define SGMS_TARGET_H

#include <stdint.h>

/* Operations of semihosting; names and numbers are those of its specification. */
enum { SYS_OPEN = 1, SYS_CLOSE = 2, SYS_WRITE = 5, SYS_READ = 6 };

/* Ask the host; arguments are words or addresses. */
int target_host(int operation, void *arguments);

/* Run `work` on a stack of its own; returns the ticks of the counter meanwhile, UINT32_MAX where it cannot hold them.
 */
uint32_t target_measure(void (*work)(void), void *stack_top);

/* Work of known length, to calibrate the counter: none at all, and 2 + 2 target_loop_count instructions more. */
void target_nothing(void);
void target_loop(void);
extern uint32_t target_loop_count;

/* Entered by the start code with the FPU on and the counter running; its result is the exit code. */
int target_main(void);

#endif
