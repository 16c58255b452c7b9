/* Kinematics and friction from position and force: blocks V and Y of the signal chain.
 *
 * Everything leaves the chain with the delay the acceleration cannot avoid (two low-passes and one
 * sample), so that u - m a carries no transient that is not friction. Single precision takes the
 * position as an integer number of picometres: a float resolves 20 nm at 0.3 m. */
#ifndef SGMS_FILTER_H
#define SGMS_FILTER_H

#include "sgms_math.h"

/* Second-order low-pass, y = (b0 + b1/z + b2/z^2) / (1 + a1/z + a2/z^2) u; two numbers of state. */
typedef struct {
    sgms_real b0, b1, b2, a1, a2;
} sgms_lowpass;

/* A state without an input decays, in the end among subnormal numbers, with which many processors
 * are slow. No signal is as small as this. */
#define SGMS_REST SGMS_R(1e-30)

static inline void sgms_drop_rest(sgms_real *state, int count)
{
    for (int i = 0; i < count; i++) {
        state[i] = sgms_fabs(state[i]) < SGMS_REST ? SGMS_R(0.0) : state[i];
    }
}

static inline sgms_real sgms_lowpass_step(
    const sgms_lowpass *filter, sgms_real *state, sgms_real input)
{
    const sgms_real output = filter->b0 * input + state[0];
    state[0] = state[1] + filter->b1 * input - filter->a1 * output;
    state[1] = filter->b2 * input - filter->a2 * output;
    return output;
}

/* Add to the state that of a constant input that has always been there. */
static inline void sgms_lowpass_rest(const sgms_lowpass *filter, sgms_real *state, sgms_real input)
{
    state[1] += (filter->b2 - filter->a2) * input;
    state[0] += (SGMS_R(1.0) - filter->b0) * input;
}

/* A signal at or beyond these counts as missing, as NaN does. */
#define SGMS_FARTHEST SGMS_R(4e6)       /* m */
#define SGMS_LARGEST_SIGNAL SGMS_R(1e9) /* N, m/s, m/s^2 */

static inline int sgms_is_reading(sgms_real x)
{
    return sgms_fabs(x) < SGMS_LARGEST_SIGNAL; /* false for NaN */
}

#if SGMS_SINGLE
typedef int64_t sgms_position; /* pm */
/* A move of one sample mostly fits 32 bits, which a small processor converts in one instruction. */
static inline sgms_real sgms_metres(sgms_position p)
{
    const sgms_real picometres = p >= INT32_MIN && p <= INT32_MAX ? (sgms_real)(int32_t)p
                                                                  : (sgms_real)p;
    return picometres * SGMS_R(1e-12);
}

#define SGMS_FARTHEST_PICOMETRES INT64_C(4000000000000000000)

static inline int sgms_position_is_good(sgms_position p)
{
    return p > -SGMS_FARTHEST_PICOMETRES && p < SGMS_FARTHEST_PICOMETRES;
}

/* p + d for a good p, which a continued motion does not take out of the range: it stays there. */
static inline sgms_position sgms_position_ahead(sgms_position p, sgms_position d)
{
    const uint64_t sum = (uint64_t)p + (uint64_t)d; /* wraps beyond the range */
    const sgms_position next = (sgms_position)sum;
    return sgms_position_is_good(next) ? next : p;
}

/* Of a move of at most 140 m, rounded; 0 of what is no number. In two parts of 32 bits: compilers
 * make 64 bits of a float in double precision. */
static inline sgms_position sgms_position_from(sgms_real metres)
{
    const sgms_real size = sgms_fabs(metres) * SGMS_R(1e12);
    const int high = sgms_index(size / SGMS_R(65536.0), INT32_MAX);
    const int low = sgms_index(size - (sgms_real)high * SGMS_R(65536.0) + SGMS_R(0.5), 65536);
    const sgms_position found = (sgms_position)high * 65536 + low;
    return metres < SGMS_R(0.0) ? -found : found;
}

static inline sgms_position sgms_position_difference(sgms_position a, sgms_position b)
{
    const uint64_t difference = (uint64_t)a - (uint64_t)b; /* of good ones it does not wrap */
    return (sgms_position)difference;
}

/* a - b of two differences of good positions, exact but where a 64-bit integer cannot hold it. */
static inline sgms_real sgms_metres_between(sgms_position a, sgms_position b)
{
    const bool may_overflow = (a ^ b) < 0 &&
                              !(sgms_position_is_good(a) && sgms_position_is_good(b));
    return may_overflow ? sgms_metres(a) - sgms_metres(b)
                        : sgms_metres(sgms_position_difference(a, b));
}
#else
typedef double sgms_position; /* m */
static inline sgms_real sgms_metres(sgms_position p)
{
    return p;
}

static inline int sgms_position_is_good(sgms_position p)
{
    return sgms_fabs(p) < SGMS_FARTHEST;
}

static inline sgms_position sgms_position_ahead(sgms_position p, sgms_position d)
{
    return p + d;
}

static inline sgms_position sgms_position_from(sgms_real metres)
{
    return (sgms_position)metres;
}

static inline sgms_position sgms_position_difference(sgms_position a, sgms_position b)
{
    return a - b;
}

static inline sgms_real sgms_metres_between(sgms_position a, sgms_position b)
{
    return a - b;
}
#endif

enum {
    SGMS_FILTER_STATES = 16, /* eight low-passes of two states */
    SGMS_FILTER_LAST = 6,
    SGMS_FILTER_COUNTS = 4
};

/* Error of friction over the stated noise: of filters that know nothing, and the largest of a
 * measurement, which then has a tenth of its information. */
#define SGMS_UNKNOWN SGMS_R(1000.0)
#define SGMS_MOST_BRIDGED SGMS_R(3.0)

/* Signals to compute besides velocity and friction, a sum; the others are zero. */
enum { SGMS_POSITION = 1, SGMS_FORCE = 2, SGMS_ACCELERATION = 4 };

/* Constants of a chain. */
typedef struct {
    sgms_lowpass lowpass;
    sgms_real rate;     /* Hz */
    sgms_position step; /* of the encoder; 0: a reading is where the axis is */
    int32_t settle;     /* samples that a disturbance of the filters lasts */
    int wanted;         /* signals to compute */
    sgms_real fading;   /* of a disturbance, per sample: to a hundredth while they settle */
} sgms_chain;

/* Memory of the chain. Plain arrays, which the public header of a package declares without this. */
typedef struct {
    sgms_position *position; /* [2] last position of the axis, last raw difference */
    sgms_real *lowpass;      /* [SGMS_FILTER_STATES] */
    sgms_real *last; /* [SGMS_FILTER_LAST] last force, filtered velocity; force, position before;
                        change of that velocity, error of friction by bridged samples */
    int32_t *counts; /* [SGMS_FILTER_COUNTS] channels seen (1 force, 2 position), length of the
                        position's gap, samples since the last gap, length of the force's gap */
    sgms_real mass;  /* kg, that moves */
} sgms_filter_memory;

typedef struct {
    sgms_real position, velocity, acceleration, force, friction;
    sgms_real valid; /* 1 over the factor on friction's noise; 0: it is no measurement */
} sgms_aligned;

/* Where an axis is: where it was at last, as long as a reading is within a step of that. A count of
 * flicker at rest is no motion then, which would take friction from one level to the other. */
static inline sgms_position sgms_axis_at(
    const sgms_chain *chain, sgms_position last, sgms_position reading)
{
    sgms_position at = reading;
    if (chain->step > 0) {
        const sgms_position low = sgms_position_ahead(reading, -chain->step);
        const sgms_position high = sgms_position_ahead(reading, chain->step);
        at = last < low ? low : last > high ? high : last;
    }
    return at;
}

/* Take in what a sample disturbs: a channel's first good value, a gap that is bridged, filters that
 * have not settled. `rest` is the state of the filters of a force that has always been there.
 * Returns how far friction is valid.
 *
 * The axis goes on at its filtered acceleration, the force stays. What comes after the gap makes up
 * for that: position by its displacement, force by the trapezoid of its impulse. */
static SGMS_COLD sgms_real sgms_filter_disturbed(
    const sgms_chain *chain, const sgms_filter_memory *m, sgms_real *rest, sgms_position *position,
    sgms_real *force)
{
    const sgms_lowpass *const filter = &chain->lowpass;
    const int position_good = sgms_position_is_good(*position);
    const int force_good = sgms_is_reading(*force);
    sgms_real longest, *const error = &m->last[5];
    if (m->counts[2] >= chain->settle) {
        *error = SGMS_R(0.0);
    }
    /* Bits that have flipped in memory are no channels. */
    m->counts[0] &= 3;
    if ((m->counts[0] & 1) == 0 && force_good) { /* first good force */
        m->counts[0] |= 1;
        m->last[0] = *force;
        m->last[2] = *force;
        sgms_lowpass_rest(filter, rest, *force);
        sgms_lowpass_rest(filter, rest + 2, *force);
        m->counts[2] = 0;
        m->counts[3] = 0;
        *error = SGMS_UNKNOWN;
    }
    if ((m->counts[0] & 2) == 0 && position_good) { /* first good position */
        m->counts[0] |= 2;
        m->position[0] = *position;
        if ((chain->wanted & SGMS_POSITION) != 0) {
            m->last[3] = sgms_metres(*position);
            sgms_lowpass_rest(filter, m->lowpass + 12, m->last[3]);
            sgms_lowpass_rest(filter, m->lowpass + 14, m->last[3]);
        }
        m->counts[1] = 0;
        m->counts[2] = 0;
        *error = SGMS_UNKNOWN;
    }
    if (!position_good) {
        if (m->counts[1] <= chain->settle) {
            m->counts[1]++;
            m->position[1] = sgms_position_ahead(
                m->position[1], sgms_position_from(m->last[4] / chain->rate));
        }
        *position = sgms_position_ahead(m->position[0], m->position[1]);
    } else {
        *position = sgms_axis_at(chain, m->position[0], *position);
        m->position[1] = sgms_position_difference(*position, m->position[0]);
        if (m->counts[1] > chain->settle) { /* what was travelled unseen is not a velocity */
            m->position[1] = 0;
            *error = SGMS_UNKNOWN;
            m->last[3] = chain->wanted & SGMS_POSITION ? sgms_metres(*position) : SGMS_R(0.0);
        }
        m->counts[1] = 0;
    }
    if (!force_good) {
        *force = m->last[0];
        if (m->counts[3] <= chain->settle) {
            m->counts[3]++;
        }
    } else {
        const sgms_real before = m->last[0];
        m->last[0] = *force;
        if (m->counts[3] > chain->settle) {
            *error = SGMS_UNKNOWN;
        } else {
            *force += (*force - before) * (SGMS_R(0.5) * (sgms_real)m->counts[3]);
        }
        m->counts[3] = 0;
    }
    if (!position_good || !force_good) { /* where both are, both channels have been seen */
        m->counts[2] = 0;
    } else {
        m->counts[2] = sgms_place(m->counts[2], chain->settle - 1) + 1;
    }
    /* What goes on errs with the square of the time. */
    longest = (sgms_real)(m->counts[1] > m->counts[3] ? m->counts[1] : m->counts[3]);
    *error *= chain->fading;
    *error += SGMS_R(2.0) * (SGMS_R(1.0) - chain->fading) * longest * longest;
    return m->counts[0] == 3 && *error <= SGMS_MOST_BRIDGED
               ? SGMS_R(1.0) / sgms_sqrt(SGMS_R(1.0) + *error * *error)
               : SGMS_R(0.0);
}

/* One sample through the chain. */
static inline sgms_aligned sgms_filter_step(
    const sgms_chain *chain, const sgms_filter_memory *m, sgms_position position, sgms_real force)
{
    const sgms_lowpass *const filter = &chain->lowpass;
    const sgms_real rate = chain->rate;
    const int wanted = chain->wanted;
    const bool apart = (wanted & (SGMS_FORCE | SGMS_ACCELERATION)) != 0;
    sgms_real *const f = m->lowpass;
    const sgms_position earlier = m->position[1]; /* difference */
    sgms_real velocity, acceleration;
    sgms_aligned out;
    out.position = SGMS_R(0.0);
    out.acceleration = SGMS_R(0.0);
    out.force = SGMS_R(0.0);

    if (sgms_position_is_good(position) && sgms_is_reading(force) && m->counts[0] == 3 &&
        m->counts[1] == 0 && m->counts[2] >= chain->settle) {
        position = sgms_axis_at(chain, m->position[0], position);
        m->position[1] = sgms_position_difference(position, m->position[0]);
        m->last[0] = force;
        out.valid = SGMS_R(1.0);
    } else {
        out.valid = sgms_filter_disturbed(chain, m, apart ? f + 8 : f + 4, &position, &force);
    }
    m->position[0] = position;

    /* The filters are linear, so the difference of two filtered velocities is the filtered second
     * difference of the position, which is exact; in the other order floats err by 0.03 N. */
    velocity = sgms_lowpass_step(filter, f, sgms_metres(m->position[1]) * rate);
    acceleration = sgms_metres_between(m->position[1], earlier) * rate * rate;
    out.velocity = sgms_lowpass_step(filter, f + 2, m->last[1]);
    if (apart) {
        out.acceleration = sgms_lowpass_step(
            filter, f + 6, sgms_lowpass_step(filter, f + 4, acceleration));
        out.force = sgms_lowpass_step(filter, f + 10, sgms_lowpass_step(filter, f + 8, m->last[2]));
        out.friction = out.force - m->mass * out.acceleration;
    } else { /* linear again: one pair of filters serves both */
        const sgms_real friction = m->last[2] - m->mass * acceleration;
        out.friction = sgms_lowpass_step(filter, f + 6, sgms_lowpass_step(filter, f + 4, friction));
    }
    m->last[4] = velocity - m->last[1];
    m->last[1] = velocity;
    m->last[2] = force;
    if ((wanted & SGMS_POSITION) != 0) {
        out.position = sgms_lowpass_step(
            filter, f + 14, sgms_lowpass_step(filter, f + 12, m->last[3]));
        m->last[3] = sgms_metres(position);
    }
    return out;
}

#endif
