/* Sets the clock of an axis. Compiled with a package whose model reads the time:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_HEADER='"etel_xy.h"' */
#include SGMS_MACHINE_HEADER

#include "joined.h"

/* As if so many samples had passed since init. */
void probe_set_clock(void *self, int64_t samples)
{
    ((JOIN(SGMS_MACHINE, t) *)self)->input.elapsed = samples;
}
