/* Drives whose command is no force: a voltage, or the goal of a position loop in their firmware. See axis.h. */
#include "axis.h"

#include <math.h>

#define STEEP 10.0

static double limit(double value, double most)
{
    return fmin(fmax(value, -most), most);
}

void axis_enable(struct axis *axis, const double *enabled)
{
    axis->enabled = enabled;
}

/* Goal at a time in samples, held between them, which firmware lets go no faster than the speed limit. */
static double limited_goal(struct axis *axis, const double *goal, double sample)
{
    const size_t k = (size_t)sample;
    const double most = axis->set.speed_limit / axis->set.rate;
    if (!(most > 0.0)) {
        return goal[k];
    }
    if (axis->goal_at == 0 || axis->goal_at > k) {
        axis->goal_at = 0;
        axis->goal = goal[0];
    }
    for (; axis->goal_at < k; ++axis->goal_at) {
        axis->goal += limit(goal[axis->goal_at] - axis->goal, most);
    }
    return axis->goal + limit(goal[k] - axis->goal, most * (sample - (double)k));
}

double axis_drive_force(struct axis *axis, const double *command, size_t length, double sample)
{
    const struct axis_settings *set = &axis->set;
    const double late = sample - set->command_delay * set->rate, at = fmin(fmax(late, 0.0), (double)(length - 1));
    const size_t k = (size_t)at;
    double volts = command[k];
    if (set->drive == AXIS_DRIVE_POSITION_LOOP) {
        const double error = limited_goal(axis, command, at) - axis->position;
        const double share = set->loop_gain * error; /* STEEP: a step at the goal would have the loop chatter there */
        volts = set->supply * (share + limit(STEEP * share, set->loop_start));
    }
    if (set->clamp > 0.0) {
        volts = limit(volts, set->clamp * set->supply);
    }
    if (axis->enabled != NULL && !(axis->enabled[k] > 0.5)) {
        return 0.0; /* its windings are open */
    }
    return (volts - set->torque_constant * axis->velocity) * set->torque_constant / set->resistance;
}
