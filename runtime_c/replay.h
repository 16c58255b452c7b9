/* Replays a recorded series through one emitted estimator, on a host. Compiled together with a package:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_HEADER='"etel_xy.h"' */
#ifndef SGMS_REPLAY_H
#define SGMS_REPLAY_H

#include <stddef.h>

/* One sample series, arrays of `samples` doubles. With `acceleration` and `friction` the aligned signals go to
 * insert(); with both NULL position and force are the raw measurements and go through the package's own signal chain.
 */
typedef struct {
    long samples;
    const double *position;     /* m */
    const double *force;        /* N */
    const double *velocity;     /* m/s, aligned */
    const double *acceleration; /* m/s^2, aligned */
    const double *friction;     /* N, aligned */
    const double *valid;        /* 1 over the factor on friction's noise, 0: it is no measurement */
    double delay;               /* s, that aligned signals are behind their samples */
} sgms_series;

enum { SGMS_REPLAY_TASKS = 0, SGMS_REPLAY_TICK = 1 };

/* Memory of one estimator in bytes, and the numbers of one result row: friction measured, friction, deflections,
 * parameters, deviations, innovation, test ratio, noise scale. */
size_t sgms_replay_memory(void);
int sgms_replay_columns(void);
int sgms_replay_samples_per_update(void);

/* Start an estimator in caller's memory; reset keeps what it has learned. */
void sgms_replay_start(void *memory);
void sgms_replay_reset(void *memory);

/* Run the series on; every update fills one row of `rows` and one status. `compensation`, if not NULL, receives the
 * friction that every sample returned. mode: SGMS_REPLAY_TASKS (prepare and feedback) or SGMS_REPLAY_TICK.
 * Returns the number of updates. */
long sgms_replay_run(
    void *memory,
    const sgms_series *series,
    int mode,
    double *rows,
    int *statuses,
    double *compensation);

#endif
