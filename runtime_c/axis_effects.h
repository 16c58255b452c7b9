/* Effects of the simulated axis, as its loop (axis.c) sees them: each is one row of the table in axis_effects.c. */
#ifndef SGMS_MHE_AXIS_EFFECTS_H
#define SGMS_MHE_AXIS_EFFECTS_H

#include "axis.h"

#include <math.h>

#define TWO_PI 6.283185307179586

/* Quantities that effects change, one effect after the other. Forces are friction-like in sign. */
enum axis_quantity {
    AXIS_OUTSIDE_FORCE,  /* N, on the load: what a drive transmits beside the inertial force */
    AXIS_OTHER_FORCE,    /* N, on the mass */
    AXIS_FRICTION,       /* N, of the law */
    AXIS_LEVEL_FACTOR,   /* on s(v) */
    AXIS_LOAD_LEVEL,     /* N, added to the level by the torque transmitted */
    AXIS_VISCOUS,        /* N s/m, sigma_v */
    AXIS_MICRO_VISCOUS,  /* N s/m, shared out over the elements by their fractions */
    AXIS_DRIVE,          /* N, of the current loop, behind its lag */
    AXIS_FORCE_CONSTANT, /* force on the mass per force of the current loop */
    AXIS_INERTIA,        /* kg, of all that moves */
    AXIS_MOVING_MASS,    /* kg, without a mass that hangs on a spring */
    AXIS_DELAY,          /* s, of the logged force behind the force on the mass */
    AXIS_READ_POSITION,  /* m, by the encoder */
    AXIS_READ_FORCE,     /* N, logged */
    AXIS_QUANTITIES
};

/* State of the axis at the instant of a change. */
struct axis_view {
    const struct axis *axis;
    const struct axis_effect *effect;
    const double *p, *x; /* the effect's parameters and states */
    double v, position, time;
};

/* The changed value of a quantity. */
typedef double axis_change(const struct axis_view *at, double value);

struct axis_effect_row {
    const char *name;
    const char *parameter[AXIS_MAX_EFFECT_PARAMETERS];
    int has_table; /* see axis_effect_has_table */
    axis_change *change[AXIS_QUANTITIES];

    /* 0, or why the axis cannot have the effect (enum axis_refusal). */
    int (*check)(const struct axis *axis, const struct axis_effect *effect);
    /* States at rest at axis->position and axis->level; they are 0 before. */
    void (*place)(const struct axis *axis, struct axis_effect *effect);
    /* States through half a kick, and through a drift at axis->velocity. */
    void (*kick)(const struct axis *axis, struct axis_effect *effect);
    void (*move)(const struct axis *axis, struct axis_effect *effect);
    /* The level behind s(v), N, at the end of a drift. */
    double (*follow)(const struct axis *axis, struct axis_effect *effect, double level);
    /* Share of a drift at velocity v that moves the elements, m/s; `spring` is the sum of their forces, N. */
    double (*engage)(const struct axis *axis, struct axis_effect *effect, double v, double spring);
};

static inline double sign(double x)
{
    return (double)((x > 0.0) - (x < 0.0));
}

#endif
