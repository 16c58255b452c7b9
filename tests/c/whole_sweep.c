/* Sweep of a package that resumes it: how far the last one reached back, and to make the next one a whole one. Compiled
 * with a package: -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_HEADER='"etel_xy.h"' */
#include SGMS_MACHINE_HEADER

#include "joined.h"
typedef JOIN(SGMS_MACHINE, t) machine;

/* Older intervals that were condensed again; -1: none, and the factor was left as it was. */
int probe_sweep(const void *self)
{
    return (int)((const machine *)self)->sweep.back;
}

/* Have all older intervals condensed by the next prepare. */
void probe_forget_sweep(void *self)
{
    machine *const axis = self;
    axis->sweep.back = axis->sweep.complete;
}

/* Shifts of the window since drift entered the arrival cost. */
int probe_shifts(const void *self)
{
    return (int)((const machine *)self)->sweep.shifts;
}
