/* The runtime's static functions under exported names, over arrays. Compiled with -DSGMS_SINGLE=0 or 1.
 * Relies on: sgms_exp, sgms_exp2_core, sgms_tanh, sgms_sin, sgms_cos, their forms for lanes, sgms_log, sgms_sqrt,
 * sgms_inverse_sqrt, sgms_is_finite; sgms_qr, sgms_qr_add_row, sgms_qr_grow, sgms_back_substitute, sgms_variances,
 * sgms_box, sgms_box_least_squares; sgms_chain, sgms_filter_step, sgms_filter_memory; sgms_floor, sgms_entry. */
#include "sgms_filter.h"
#include "sgms_linalg.h"
#include "sgms_table.h"

#define OVER_ARRAYS(name)                                                                                              \
    void probe_##name(long n, const sgms_real *x, sgms_real *y)                                                        \
    {                                                                                                                  \
        for (long i = 0; i < n; i++) {                                                                                 \
            y[i] = sgms_##name(x[i]);                                                                                  \
        }                                                                                                              \
    }

OVER_ARRAYS(exp)
OVER_ARRAYS(exp2_core)
OVER_ARRAYS(tanh)
OVER_ARRAYS(sin)
OVER_ARRAYS(cos)
OVER_ARRAYS(lane_exp)
OVER_ARRAYS(lane_sin)
OVER_ARRAYS(lane_cos)
OVER_ARRAYS(log)
OVER_ARRAYS(sqrt)
OVER_ARRAYS(inverse_sqrt)
OVER_ARRAYS(fabs)
OVER_ARRAYS(sign)
OVER_ARRAYS(floor)

void probe_entry(const sgms_real *table, int last, long n, const sgms_real *x, sgms_real *y)
{
    for (long i = 0; i < n; i++) {
        y[i] = sgms_entry(table, last, x[i]);
    }
}

void probe_is_finite(long n, const sgms_real *x, sgms_real *y)
{
    for (long i = 0; i < n; i++) {
        y[i] = (sgms_real)sgms_is_finite(x[i]);
    }
}

void probe_qr(sgms_real *a, int rows, int stride, int width, int columns)
{
    sgms_real reflector[64];
    sgms_qr(a, rows, stride, width, columns, reflector);
}

void probe_qr_add_row(sgms_real *r, int n, sgms_real *row)
{
    sgms_qr_add_row(r, n, row);
}

void probe_qr_grow(sgms_real *r, int n, int count, const sgms_real *growth)
{
    sgms_real carrier[64];
    sgms_qr_grow(r, n, count, growth, carrier);
}

void probe_back_substitute(const sgms_real *r, int n, int width, const sgms_real *b, sgms_real *x)
{
    sgms_back_substitute(r, n, width, b, x);
}

void probe_variances(const sgms_real *r, int n, int width, sgms_real *variance)
{
    sgms_real work[64];
    sgms_variances(r, n, width, variance, work);
}

/* `problems` box least-squares problems of n variables one after the other. */
void probe_box(
    long problems,
    int n,
    const sgms_real *r,
    const sgms_real *b,
    const sgms_real *lower,
    const sgms_real *upper,
    sgms_real *x,
    int *pinned,
    int *active)
{
    sgms_real work[64 * 65];
    for (long k = 0; k < problems; k++) {
        const sgms_box box = {
            .r = r + k * n * n, .n = n, .width = n, .b = b + k * n, .lower = lower + k * n, .upper = upper + k * n};
        active[k] = sgms_box_least_squares(&box, x + k * n, pinned + k * n, work);
    }
}

/* The signal chain over a record; rows of out: position, velocity, acceleration, force, friction. */
void probe_chain(
    long n,
    const double *coefficients,
    double rate,
    double mass,
    double step,
    int settle,
    double fading,
    int wanted,
    const sgms_position *position,
    const sgms_real *force,
    sgms_real *out,
    sgms_real *valid)
{
    const sgms_chain chain = {
        .lowpass =
            {.b0 = (sgms_real)coefficients[0],
             .b1 = (sgms_real)coefficients[1],
             .b2 = (sgms_real)coefficients[2],
             .a1 = (sgms_real)coefficients[3],
             .a2 = (sgms_real)coefficients[4]},
        .rate = (sgms_real)rate,
        .step = (sgms_position)(SGMS_SINGLE ? step * 1e12 + 0.5 : step),
        .settle = settle,
        .wanted = wanted,
        .fading = (sgms_real)fading};
    sgms_position positions[2] = {0, 0};
    sgms_real states[SGMS_FILTER_STATES] = {0}, last[SGMS_FILTER_LAST] = {0};
    int32_t counts[SGMS_FILTER_COUNTS] = {0};
    const sgms_filter_memory memory = {
        .position = positions, .lowpass = states, .last = last, .counts = counts, .mass = (sgms_real)mass};
    for (long k = 0; k < n; k++) {
        const sgms_aligned s = sgms_filter_step(&chain, &memory, position[k], force[k]);
        out[k] = s.position;
        out[n + k] = s.velocity;
        out[2 * n + k] = s.acceleration;
        out[3 * n + k] = s.force;
        out[4 * n + k] = s.friction;
        valid[k] = s.valid;
    }
}
