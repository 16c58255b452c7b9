/* The package on a desk: checks itself, then runs over "position [m] force [N]" pairs from stdin, one per sample, and
 * prints what it knows in the end: friction [N], then every parameter with its standard deviation [SI]. */
#include "my_axis.h"

#include <stdio.h>

static my_axis_t axis;

int main(void)
{
    double position, force;
    my_axis_estimate_t estimate;
    if (my_axis_check(sizeof axis, MY_AXIS_HEADER) != MY_AXIS_OK || my_axis_selftest_with(&axis) != 0) {
        (void)fputs("this is not the package that was generated\n", stderr);
        return 1;
    }
    my_axis_init(&axis);
    while (scanf("%lf %lf", &position, &force) == 2) {
        (void)my_axis_tick(&axis, my_axis_position_from_metres(position), force);
    }
    my_axis_estimate(&axis, &estimate);
    (void)printf("friction %.9g\n", estimate.friction);
    for (int i = 0; i < MY_AXIS_PARAMETERS; i++) {
        (void)printf("parameter %d %.9g +- %.3g\n", i, estimate.parameter[i], estimate.deviation[i]);
    }
    return 0;
}
