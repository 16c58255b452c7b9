/* The same filter as ekf.c, its step exported by CasADi: one function of state and covariance, by casadi_filter.py. */
#include "axis.h"
#include "entry.h"

#include "casadi_step.h"

enum { STATES = 2 * ELEMENTS };

typedef struct {
    chain signals;
    float x[STATES], P[STATES * STATES], next_x[STATES], next_P[STATES * STATES], w[casadi_step_SZ_W];
    float travel;
    int32_t count;
} filter_t;

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

float entry_tick(void *memory, int64_t position, float force)
{
    filter_t *f = memory;
    chain_update(&f->signals, position, force);
    f->travel += f->signals.velocity * 1e-4f;
    if (++f->count == STEPS) {
        const float measured = f->signals.force - MASS * f->signals.acceleration;
        const float *arg[casadi_step_SZ_ARG] = {f->x, f->P, &f->travel, &f->signals.velocity, &measured};
        float *res[casadi_step_SZ_RES] = {f->next_x, f->next_P};
        casadi_int iw[casadi_step_SZ_IW + 1];
        (void)casadi_step(arg, res, iw, f->w, 0);
        for (int i = 0; i < STATES; i++) {
            f->x[i] = f->next_x[i];
        }
        for (int i = 0; i < STATES * STATES; i++) {
            f->P[i] = f->next_P[i];
        }
        f->travel = 0.0f;
        f->count = 0;
    }
    float sum = VISCOUS * f->signals.velocity;
    for (int i = 0; i < ELEMENTS; i++) {
        sum += STIFFNESS[i] * f->x[ELEMENTS + i] * f->x[i];
    }
    return sum;
}
