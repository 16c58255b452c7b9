/* What two tasks on one axis do in tests: samples of a motion to and fro, and estimates compared bit by bit. */
#ifndef TASKS_H
#define TASKS_H

#include SGMS_MACHINE_HEADER

#include "joined.h"

typedef CALL(t) machine;
typedef CALL(estimate_t) machine_estimate;

enum { SAMPLES = JOIN(SGMS_MACHINE_UPPER, SAMPLES), OVERLAP = JOIN(SGMS_MACHINE_UPPER, OVERLAP) };

/* Sample k. Whether a force came back. */
static inline int take_one(machine *self, long k)
{
    const double t = (double)(k % 900) / 900.0, way = t < 0.5 ? t : 1.0 - t;
    const int is_forward = t < 0.5;
    const CALL(signals) signals = {
        .position = (CALL(real))(9e-5 * way),
        .velocity = (CALL(real))((is_forward ? 2e-3 : -2e-3) * way),
        .force = (CALL(real))1,
        .friction = (CALL(real))((is_forward ? 8.0 : -8.0) * (way - 0.2)),
        .valid = 1};
    return CALL(insert)(self, &signals) != (CALL(real))0;
}

static inline int is_same(const machine_estimate *a, const machine_estimate *b)
{
    int same = a->friction == b->friction && a->friction_measured == b->friction_measured;
    for (int i = 0; i < JOIN(SGMS_MACHINE_UPPER, ELEMENTS); i++) {
        same = same && a->deflection[i] == b->deflection[i];
    }
    for (int i = 0; i < JOIN(SGMS_MACHINE_UPPER, PARAMETERS); i++) {
        same = same && a->parameter[i] == b->parameter[i] && a->deviation[i] == b->deviation[i];
    }
    return same;
}

#endif
