/* One emitted estimator in the loop of a simulated axis, on a host. Compiled together with a package and replay.c. */
#ifndef SGMS_LOOP_H
#define SGMS_LOOP_H

/* Compensation of one axis over a run, and what it leaves behind. */
typedef struct {
    void *memory;           /* of sgms_replay_start; NULL: `force` is read, not written */
    const double *velocity; /* [samples] m/s, of the set-point ahead of each sample; NULL: the drive does not tell */
    const double *acceleration; /* [samples] m/s^2, likewise */
    double *force;              /* [samples] N, fed forward */
    double *rows;               /* [updates][sgms_replay_columns()] */
    int *statuses;              /* [updates] */
    long samples, sample, updates;
} sgms_loop;

/* The axis's callback (axis.h); its context is an sgms_loop. */
double sgms_loop_compensate(void *context, double position, double force);

#endif
