/* One package under names that do not depend on it. Compiled with
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_UPPER=ETEL_XY -DSGMS_MACHINE_HEADER='"etel_xy.h"'
 *     -DSGMS_CONFIG_HEADER='"etel_xy_config.h"' */
#ifndef PACKAGE_H
#define PACKAGE_H

#include SGMS_CONFIG_HEADER
#include SGMS_MACHINE_HEADER

#define JOIN2(a, b) a##_##b
#define JOIN(a, b) JOIN2(a, b)
#define CALL(name) JOIN(SGMS_MACHINE, name)
#define CONSTANT(name) JOIN(SGMS_MACHINE_UPPER, name)

typedef CALL(t) machine;
typedef CALL(real) machine_real;
typedef CALL(position) machine_position;
typedef CALL(signals) machine_signals;
typedef CALL(estimate_t) machine_estimate;
typedef CALL(settings_t) machine_settings;
typedef CALL(saved_t) machine_saved;

/* What statuses may be: a sum of these flags, or one of six refusals. */
enum {
    FLAGS = CONSTANT(FILLING) + CONSTANT(MISSING) + CONSTANT(HOLD) + CONSTANT(BOUND) + CONSTANT(SPEED) +
    CONSTANT(OVERRUN) + CONSTANT(DOUBT) + CONSTANT(STALE)
};

static inline int is_status(int status)
{
    return (status >= 0 && (status & ~FLAGS) == 0) || status == CONSTANT(EARLY) || status == CONSTANT(NUMERIC) ||
           status == CONSTANT(OVERLAP) || status == CONSTANT(REFUSED) || status == CONSTANT(ARITHMETIC) ||
           status == CONSTANT(UNSTARTED);
}

/* A motion that a healthy axis makes, sample k of it: loops of some hundred hold paths and back, at a few rates. */
typedef struct {
    double position, force; /* m, N */
} good_sample;

#endif
