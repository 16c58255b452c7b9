/* The package that is generated for the axis, called by one task. */
#include "entry.h"

#include "etel_xy.h"

uint32_t entry_size(void)
{
    return sizeof(etel_xy_t);
}

void entry_init(void *memory)
{
    etel_xy_init(memory);
}

float entry_tick(void *memory, int64_t position, float force)
{
    const etel_xy_position place = {position};
    return etel_xy_tick(memory, place, force);
}
