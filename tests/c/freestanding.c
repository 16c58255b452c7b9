/* A program without a library: -ffreestanding -nostdlib. Linking it is the test; running it moves the axis a little. */
#include SGMS_MACHINE_HEADER

#include "joined.h"

static CALL(t) axis;
volatile int status_out;

void _start(void);

void _start(void)
{
    CALL(estimate_t) estimate;
    CALL(init)(&axis);
    for (int k = 0; k < 350; k++) {
        (void)CALL(tick)(&axis, CALL(position_from_counts)(k, 1, 1000), (CALL(real))1);
    }
    CALL(prepare)(&axis);
    CALL(estimate)(&axis, &estimate);
    status_out = estimate.status + CALL(status_text)(estimate.status)[0] + CALL(feedback)(&axis);
    CALL(reset)(&axis);
    for (;;) {
    }
}
