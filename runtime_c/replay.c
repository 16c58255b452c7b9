#include "replay.h"

#ifndef SGMS_MACHINE
#error "compile with -DSGMS_MACHINE=<machine> -DSGMS_MACHINE_HEADER='\"<machine>.h\"'"
#endif
#include SGMS_MACHINE_HEADER

#define SGMS_JOIN2(a, b) a##_##b
#define SGMS_JOIN(a, b) SGMS_JOIN2(a, b)
#define CALL(name) SGMS_JOIN(SGMS_MACHINE, name)

#ifdef SGMS_ROTARY
#define POSITION_FROM position_from_radians
#else
#define POSITION_FROM position_from_metres
#endif

#ifdef SGMS_FREE /* numbers of the package that its caller sets */
double sgms_free[SGMS_FREE];
#endif

typedef CALL(t) machine;
typedef CALL(real) machine_real;
typedef CALL(signals) machine_signals;
typedef CALL(estimate_t) machine_estimate;

/* Constants of the header, out of names that the preprocessor cannot build. */
enum {
    N_DEFLECTIONS = sizeof(((machine_estimate *)0)->deflection) / sizeof(machine_real),
    N_PARAMETERS = sizeof(((machine_estimate *)0)->parameter) / sizeof(machine_real),
    COLUMNS = 5 + N_DEFLECTIONS + 2 * N_PARAMETERS
};

size_t sgms_replay_memory(void)
{
    return sizeof(machine);
}

int sgms_replay_columns(void)
{
    return COLUMNS;
}

int sgms_replay_samples_per_update(void)
{
    return SGMS_JOIN(SGMS_MACHINE_UPPER, SAMPLES);
}

void sgms_replay_start(void *memory)
{
    CALL(init)(memory);
}

void sgms_replay_reset(void *memory)
{
    CALL(reset)(memory);
}

static void write_row(const machine *self, double *row)
{
    machine_estimate estimate;
    CALL(estimate)(self, &estimate);
    *row++ = (double)estimate.friction_measured;
    *row++ = (double)estimate.friction;
    for (int i = 0; i < N_DEFLECTIONS; i++) {
        *row++ = (double)estimate.deflection[i];
    }
    for (int i = 0; i < N_PARAMETERS; i++) {
        *row++ = (double)estimate.parameter[i];
    }
    for (int i = 0; i < N_PARAMETERS; i++) {
        *row++ = (double)estimate.deviation[i];
    }
    *row++ = (double)estimate.innovation;
    *row++ = (double)estimate.test_ratio;
    *row++ = (double)estimate.noise_scale;
}

static machine_real one_sample(machine *self, const sgms_series *series, long k)
{
    if (series->friction) {
        const machine_signals signals = {
            .position = (machine_real)series->position[k],
            .velocity = (machine_real)series->velocity[k],
            .acceleration = (machine_real)series->acceleration[k],
            .force = (machine_real)series->force[k],
            .friction = (machine_real)series->friction[k],
            .valid = (machine_real)series->valid[k],
            .delay = (machine_real)series->delay};
        return CALL(insert)(self, &signals);
    }
    return CALL(sample)(self, CALL(POSITION_FROM)(series->position[k]), (machine_real)series->force[k]);
}

long sgms_replay_run(
    void *memory,
    const sgms_series *series,
    int mode,
    double *rows,
    int *statuses,
    double *compensation)
{
    machine *self = memory;
    long updates = 0;
    for (long k = 0; k < series->samples; k++) {
        const machine_real friction = mode == SGMS_REPLAY_TICK ? CALL(tick)(
                                                                     self, CALL(POSITION_FROM)(series->position[k]),
                                                                     (machine_real)series->force[k])
                                                               : one_sample(self, series, k);
        if (compensation) {
            compensation[k] = (double)friction;
        }
        if (CALL(due)(self)) {
            machine_estimate estimate;
            (void)CALL(feedback)(
                self); /* what the next tick() begins with, while the signals are those of the estimate */
            if (mode != SGMS_REPLAY_TICK) {
                CALL(prepare)(self); /* in a controller: by the slower task */
            }
            CALL(estimate)(self, &estimate);
            statuses[updates] = estimate.status;
            write_row(self, rows + updates * COLUMNS);
            updates++;
        }
    }
    return updates;
}
