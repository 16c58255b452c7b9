/* The same filter as ekf.c, its step exported by CasADi: one function of state and covariance, by casadi_filter.py. */
#include "filter.h"

#include "casadi_step.h"

static void filter_step(filter_t *f)
{
    float x[STATES], P[STATES * STATES], w[casadi_step_SZ_W];
    const float measured = filter_measured(f);
    const float *arg[casadi_step_SZ_ARG] = {f->x, f->P, &f->travel, &f->signals.velocity, &measured};
    float *res[casadi_step_SZ_RES] = {x, P};
    casadi_int iw[casadi_step_SZ_IW + 1];
    (void)casadi_step(arg, res, iw, w, 0);
    for (int i = 0; i < STATES; i++) {
        f->x[i] = x[i];
    }
    for (int i = 0; i < STATES * STATES; i++) {
        f->P[i] = P[i];
    }
}
