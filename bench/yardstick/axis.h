/* The axis as it is believed to be, for entries written by hand: the friction law and a signal chain. */
#ifndef YARDSTICK_AXIS_H
#define YARDSTICK_AXIS_H

#include <stdint.h>

enum { ELEMENTS = 4, STEPS = 10 }; /* of friction; samples of one filter step, at 1 kHz */

static const float MASS = 20.0f;                                          /* kg */
static const float COULOMB = 4.0f;                                        /* N */
static const float VISCOUS = 20.0f;                                       /* N s/m */
static const float STIFFNESS[ELEMENTS] = {120e3f, 25e3f, 7.1e3f, 7.9e3f}; /* N/m */
static const float FRACTION[ELEMENTS] = {0.067f, 0.056f, 0.047f, 0.83f};  /* of the level */
static const float PRIOR = 0.4f;                                          /* 1 sigma of a stiffness, relative */
static const float DRIFT = 0.002f * 0.3162f;                              /* per step, relative */
static const float NOISE = 0.1f;                                          /* 1 sigma of measured friction, N */
static const float DEFLECTION_NOISE = 0.01f;                              /* per step, share of break-away */

/* Second-order Butterworth low-pass at 500 Hz for 10 kHz, transposed form II. */
typedef struct {
    float s1, s2;
} low_pass;

static inline float filter(low_pass *f, float x)
{
    const float y = 0.020083366f * x + f->s1;
    f->s1 = 0.040166731f * x + 1.561018076f * y + f->s2;
    f->s2 = 0.020083366f * x - 0.641351538f * y;
    return y;
}

/* Velocity by differences, acceleration by differences of it, force: each behind the same low-pass. */
typedef struct {
    low_pass velocity_filter, force_filter;
    int64_t position;
    float velocity, acceleration, force;
    int32_t known;
} chain;

static inline void chain_update(chain *c, int64_t position, float force)
{
    if (!c->known) {
        c->position = position;
        c->known = 1;
    }
    const float speed = (float)(position - c->position) * 1e-8f; /* pm in 0.1 ms */
    const float velocity = filter(&c->velocity_filter, speed);
    c->acceleration = (velocity - c->velocity) * 1e4f;
    c->velocity = velocity;
    c->force = filter(&c->force_filter, force);
    c->position = position;
}

#endif
