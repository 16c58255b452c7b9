/* The public functions of one package under fixed names, one call each. Compiled with a package:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_UPPER=ETEL_XY -DSGMS_MACHINE_HEADER='"etel_xy.h"'
 * Uses nothing but the public header. */
#include <stddef.h>
#include <string.h>

#include SGMS_MACHINE_HEADER

#include "joined.h"
#define CONSTANT(name) JOIN(SGMS_MACHINE_UPPER, name)

typedef CALL(t) machine;
typedef CALL(real) machine_real;

size_t probe_size(void)
{
    return sizeof(machine);
}

/* init is to rely on nothing that was there: memory full of one byte. */
void probe_init_on(void *self, int byte)
{
    memset(self, byte, sizeof(machine));
    CALL(init)((machine *)self);
}

void probe_init(void *self)
{
    probe_init_on(self, 0xA5);
}

void probe_reset(void *self)
{
    CALL(reset)((machine *)self);
}

/* The position as it lies in memory, 64 bits. */
void probe_position_from_counts(int64_t counts, int32_t per, int64_t picometres, void *position)
{
    const CALL(position) made = CALL(position_from_counts)(counts, per, picometres);
    memcpy(position, &made, sizeof made);
}

/* Positions of counts that start over, as they lie in memory. */
void probe_position_from_wrapped_counts(
    const uint32_t *counts,
    int number,
    int bits,
    int32_t per,
    int64_t picometres,
    int64_t *whole,
    void *position)
{
    CALL(counter) counter = {picometres, 0, per, 0, 0};
    for (int i = 0; i < number; i++) {
        const CALL(position) made = CALL(position_from_wrapped_counts)(&counter, counts[i], bits);
        memcpy((char *)position + (size_t)i * sizeof made, &made, sizeof made);
        whole[i] = counter.whole;
    }
}

void probe_position_from_metres(double metres, void *position)
{
    const CALL(position) made = CALL(position_from_metres)(metres);
    memcpy(position, &made, sizeof made);
}

double probe_tick(void *self, double position, double force)
{
    return (double)CALL(tick)((machine *)self, CALL(position_from_metres)(position), (machine_real)force);
}

double probe_sample(void *self, double position, double force)
{
    return (double)CALL(sample)((machine *)self, CALL(position_from_metres)(position), (machine_real)force);
}

double probe_insert_late(void *self, const double *signals, int valid, double delay)
{
    CALL(signals) s = {0};
    s.delay = (machine_real)delay;
    s.position = (machine_real)signals[0];
    s.velocity = (machine_real)signals[1];
    s.acceleration = (machine_real)signals[2];
    s.force = (machine_real)signals[3];
    s.friction = (machine_real)signals[4];
    s.valid = valid;
    return (double)CALL(insert)((machine *)self, &s);
}

double probe_insert(void *self, const double *signals, int valid)
{
    return probe_insert_late(self, signals, valid, 0.0);
}

int probe_due(const void *self)
{
    return CALL(due)((const machine *)self);
}

void probe_prepare(void *self)
{
    CALL(prepare)((machine *)self);
}

int probe_feedback(void *self)
{
    return CALL(feedback)((machine *)self);
}

/* numbers: friction, friction measured, deflections, parameters, deviations. Returns the status. */
int probe_estimate(const void *self, double *numbers)
{
    CALL(estimate_t) estimate;
    int k = 0;
    CALL(estimate)((const machine *)self, &estimate);
    numbers[k++] = (double)estimate.friction;
    numbers[k++] = (double)estimate.friction_measured;
    for (int i = 0; i < CONSTANT(ELEMENTS); i++) {
        numbers[k++] = (double)estimate.deflection[i];
    }
    for (int i = 0; i < CONSTANT(PARAMETERS); i++) {
        numbers[k++] = (double)estimate.parameter[i];
    }
    for (int i = 0; i < CONSTANT(PARAMETERS); i++) {
        numbers[k++] = (double)estimate.deviation[i];
    }
    return estimate.status;
}

/* Number of updates, samples since the last one, cause of the last NUMERIC. */
void probe_age(const void *self, uint32_t *numbers)
{
    CALL(estimate_t) estimate;
    CALL(estimate)((const machine *)self, &estimate);
    numbers[0] = estimate.update;
    numbers[1] = estimate.age;
    numbers[2] = (uint32_t)estimate.numeric;
}

int probe_numbers(void)
{
    return 2 + CONSTANT(ELEMENTS) + 2 * CONSTANT(PARAMETERS);
}

/* Statuses by their names. */
int probe_status(int which)
{
    const int values[] = {CONSTANT(OK),      CONSTANT(FILLING),    CONSTANT(MISSING),  CONSTANT(HOLD),
                          CONSTANT(BOUND),   CONSTANT(SPEED),      CONSTANT(OVERRUN),  CONSTANT(EARLY),
                          CONSTANT(NUMERIC), CONSTANT(OVERLAP),    CONSTANT(MISMATCH), CONSTANT(REFUSED),
                          CONSTANT(STALE),   CONSTANT(ARITHMETIC), CONSTANT(UNSTARTED)};
    return values[which];
}

const char *probe_status_text(int status)
{
    return CALL(status_text)(status);
}

void probe_ahead(void *self, double velocity, double acceleration)
{
    CALL(ahead)((machine *)self, (machine_real)velocity, (machine_real)acceleration);
}

void probe_compensate(void *self, int on)
{
    CALL(compensate)((machine *)self, on);
}

double probe_share(const void *self)
{
    return (double)CALL(share)((const machine *)self);
}
