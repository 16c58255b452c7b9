/* What a filter by hand and one by an exported step share: states, their start, the calls at 10 kHz.
 *
 * States (8): deflections [m] and stiffness over the nominal one [1] of four elements. An entry includes this and
 * defines filter_step(), which predicts and corrects by the travel since the last step. */
#ifndef YARDSTICK_FILTER_H
#define YARDSTICK_FILTER_H

#include "axis.h"
#include "entry.h"

enum { STATES = 2 * ELEMENTS };

typedef struct {
    chain signals;
    float x[STATES], P[STATES * STATES], travel;
    int32_t count;
} filter_t;

static void filter_step(filter_t *f);

uint32_t entry_size(void)
{
    return sizeof(filter_t);
}

void entry_init(void *memory)
{
    filter_t *f = memory;
    *f = (filter_t){0};
    for (int i = 0; i < ELEMENTS; i++) {
        const float break_away = FRACTION[i] * COULOMB / STIFFNESS[i];
        f->x[ELEMENTS + i] = 1.0f;
        f->P[i * (STATES + 1)] = 0.25f * break_away * break_away;
        f->P[(ELEMENTS + i) * (STATES + 1)] = PRIOR * PRIOR;
    }
}

static float filter_friction(const filter_t *f)
{
    float sum = VISCOUS * f->signals.velocity;
    for (int i = 0; i < ELEMENTS; i++) {
        sum += STIFFNESS[i] * f->x[ELEMENTS + i] * f->x[i];
    }
    return sum;
}

/* Friction that mass and acceleration leave of the force: the measurement. */
static float filter_measured(const filter_t *f)
{
    return f->signals.force - MASS * f->signals.acceleration;
}

float entry_tick(void *memory, int64_t position, float force)
{
    filter_t *f = memory;
    chain_update(&f->signals, position, force);
    f->travel += f->signals.velocity * 1e-4f;
    if (++f->count == STEPS) {
        filter_step(f);
        f->travel = 0.0f;
        f->count = 0;
    }
    return filter_friction(f);
}

#endif
