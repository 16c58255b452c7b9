/* Bare target: the timer's interrupt does everything, in bounded slices. Build with board.h's functions and the package
 * of machines/etel_xy_controller.toml. */
#include "board.h"
#include "etel_xy_controller.h"

static etel_xy_controller_t axis;

static void sampled(void)
{
    const etel_xy_controller_position position = etel_xy_controller_position_from_counts(board_counts(), 1, 1000);
    board_feed_forward(etel_xy_controller_tick(&axis, position, board_force()));
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
    board_run(sampled);
    return 0;
}
