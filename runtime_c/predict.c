#include "predict.h"

#ifdef SGMS_NUMBERS /* of the model at hand, which others have the code in common with; each thread runs one */
static __thread double sgms_numbers[SGMS_NUMBERS];
#endif

#include SGMS_INTEGRATOR_HEADER

#define SGMS_JOIN2(a, b) a##_##b
#define SGMS_JOIN(a, b) SGMS_JOIN2(a, b)

#ifdef SGMS_STATES
#define FORCES STATES
#define SLOPES (STATES * ENTERED)
#else
#define FORCES 1
#define SLOPES PARAMETERS
#endif

/* Force at one sample; d_force = C d_x + D. Or the states, each of which knows of ENTERED parameters at most. */
static void put_force(
    const sgms_real *x,
    const sgms_real *d_x,
    const double *signals,
    const sgms_real *theta,
    double *force,
    double *d_force)
{
#ifdef SGMS_STATES
    (void)signals;
    (void)theta;
    for (int i = 0; i < STATES; i++) {
        force[i] = (double)x[i];
        for (int k = 0; d_force && k < ENTERED; k++) {
            d_force[i * ENTERED + k] = (double)d_x[i * PARAMETERS + enters[i][k]];
        }
    }
#else
    sgms_real w[SIGNALS], c[STATES], d[PARAMETERS];
    const model_point at = {.x = x, .w = w, .theta = theta};
    for (int i = 0; i < SIGNALS; i++) {
        w[i] = (sgms_real)signals[i];
    }
    *force = (double)output_force(&at, c, d);
    for (int p = 0; d_force && p < PARAMETERS; p++) {
        sgms_real sum = d[p];
        for (int i = 0; i < STATES; i++) {
            sum += c[i] * d_x[i * PARAMETERS + p];
        }
        d_force[p] = (double)sum;
    }
#endif
}

/* Terms of the step that ends at `last`, of signals that are constant through it or lines; samples lie one behind the
 * other. */
static void put_terms(const double *last, sgms_real *term)
{
    for (int node = 0; node < NODES; node++) {
        sgms_real w[SIGNALS];
        for (int i = 0; i < SIGNALS; i++) {
            double mean = last[i], slope = 0.0;
            if (MERGED > 1) { /* the least-squares line through samples at the middles of their times */
                double squares = 0.0;
                mean = 0.0;
                for (int k = 0; k < MERGED; k++) {
                    const double tau = (2.0 * k + 1.0) / MERGED - 1.0, value = last[SIGNALS * (k - MERGED + 1) + i];
                    mean += value / MERGED;
                    slope += tau * value;
                    squares += tau * tau;
                }
                slope /= squares;
            } else if (NODES > 1) { /* from one sample to the next */
                mean = 0.5 * (last[i] + last[i - SIGNALS]);
                slope = 0.5 * (last[i] - last[i - SIGNALS]);
            }
            w[i] = (sgms_real)(mean + (node - NODES / 2) * slope);
        }
        sample_terms(w, term + node * TERMS, 1);
    }
}

/* d_x = A d_x0 + B, of what the states were at the start. */
static void put_sensitivity(const interval_map *map, const sgms_real *d_start, sgms_real *d_x)
{
    for (int i = 0; i < STATES; i++) {
        sgms_real *const row = d_x + i * PARAMETERS;
        for (int p = 0; p < PARAMETERS; p++) {
            row[p] = map->b[i * PARAMETERS + p];
        }
        for (int j = 0; j < STATES; j++) {
            const sgms_real by = map->a[i * STATES + j], none = 0;
            if (!(by < none || by > none)) { /* states forget, and most never depend on each other */
                continue;
            }
            for (int p = 0; p < PARAMETERS; p++) {
                row[p] += by * d_start[j * PARAMETERS + p];
            }
        }
    }
}

int sgms_predict(
    long samples,
    long every,
    const double *signals,
    const double *theta,
    double *x,
    double *d_x,
    double *force,
    double *d_force,
    const double *numbers)
{
    SGMS_JOIN(SGMS_MACHINE, parameters) at;
    sgms_real start[STATES], d_start[STATES * PARAMETERS], sensitivity[STATES * PARAMETERS], blocks[BLOCKS_SIZE];
    interval_map map;
    if (MERGED > 1 && (force || (samples - 1) % MERGED != 0)) { /* the state is known at the ends of steps alone */
        return -1;
    }
#ifdef SGMS_NUMBERS
    for (int i = 0; i < SGMS_NUMBERS; i++) {
        sgms_numbers[i] = numbers[i];
    }
#else
    (void)numbers;
#endif
    for (int i = 0; i < STATES; i++) {
        start[i] = (sgms_real)x[i];
    }
    for (int i = 0; i < STATES * PARAMETERS; i++) {
        d_start[i] = (sgms_real)d_x[i];
    }
    for (int p = 0; p < PARAMETERS; p++) {
        at.theta[p] = (sgms_real)theta[p];
    }
    parameter_terms(&at);
    start_blocks(&at, start, blocks);
    for (long k = 0; k < samples; k++) {
        if (k > 0 && k % MERGED == 0) {
            sgms_real term[NODES * TERMS];
            put_terms(signals + SIGNALS * k, term);
            integrate_blocks(term, blocks);
        }
        if (force && (k + 1) % every == 0) {
            const long row = k / every;
            if (d_force) {
                blocks_end(&at, blocks, start, &map);
                put_sensitivity(&map, d_start, sensitivity);
            } else {
                blocks_states(&at, blocks, map.x);
            }
            put_force(
                map.x, sensitivity, signals + SIGNALS * k, at.theta, force + row * FORCES,
                d_force ? d_force + row * SLOPES : 0);
        }
    }
    blocks_end(&at, blocks, start, &map);
    put_sensitivity(&map, d_start, sensitivity);
    for (int i = 0; i < STATES; i++) {
        x[i] = (double)map.x[i];
    }
    for (int i = 0; i < STATES * PARAMETERS; i++) {
        d_x[i] = (double)sensitivity[i];
    }
    return 0;
}
