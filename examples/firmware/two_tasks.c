/* Two tasks of an RTOS: the fast one samples and takes the update in, the slow one prepares it and may be interrupted
 * anywhere. Build with board.h's functions and the package of machines/etel_xy_controller.toml. */
#include "board.h"
#include "etel_xy_controller.h"

static etel_xy_controller_t axis;

/* 10 kHz, the higher priority. */
static void fast_task(void)
{
    const etel_xy_controller_position position = etel_xy_controller_position_from_counts(board_counts(), 1, 1000);
    board_feed_forward(etel_xy_controller_sample(&axis, position, board_force()));
    /* OVERLAP: the slow task is late. Nothing has changed; the next sample asks again. */
    if (etel_xy_controller_due(&axis) && etel_xy_controller_feedback(&axis) != ETEL_XY_CONTROLLER_OVERLAP) {
        rtos_give();
    }
}

/* Once after every feedback; 10 ms at most. */
static void slow_task(void)
{
    etel_xy_controller_prepare(&axis);
}

int main(void)
{
    const int status = etel_xy_controller_check(sizeof axis, ETEL_XY_CONTROLLER_HEADER);
    if (status != ETEL_XY_CONTROLLER_OK) {
        board_stop(etel_xy_controller_status_text(status));
        return 1;
    }
    if (etel_xy_controller_selftest_with(&axis) != 0) {
        board_stop("self-test");
        return 1;
    }
    etel_xy_controller_init(&axis);
    rtos_run(fast_task, slow_task);
    return 0;
}
