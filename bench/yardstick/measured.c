/* No observer: the force that mass and acceleration leave, behind the signal chain. */
#include "axis.h"
#include "entry.h"

uint32_t entry_size(void)
{
    return sizeof(chain);
}

void entry_init(void *memory)
{
    *(chain *)memory = (chain){0};
}

float entry_tick(void *memory, int64_t position, float force)
{
    chain *c = memory;
    chain_update(c, position, force);
    return c->force - MASS * c->acceleration;
}
