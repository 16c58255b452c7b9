#include "predict.h"

#include SGMS_INTEGRATOR_HEADER

#define SGMS_JOIN2(a, b) a##_##b
#define SGMS_JOIN(a, b) SGMS_JOIN2(a, b)

int sgms_predict_states(void)
{
    return STATES;
}

int sgms_predict_parameters(void)
{
    return PARAMETERS;
}

/* Force at one sample; d_force = C d_x + D. */
static void put_force(
    const sgms_real *x,
    const sgms_real *d_x,
    const double *signals,
    const sgms_real *theta,
    double *force,
    double *d_force)
{
    sgms_real w[5], c[STATES], d[PARAMETERS];
    for (int i = 0; i < 5; i++) {
        w[i] = (sgms_real)signals[i];
    }
    *force = (double)output_force(x, w, theta, c, d);
    for (int p = 0; d_force && p < PARAMETERS; p++) {
        sgms_real sum = d[p];
        for (int i = 0; i < STATES; i++) {
            sum += c[i] * d_x[i * PARAMETERS + p];
        }
        d_force[p] = (double)sum;
    }
}

int sgms_predict(
    long samples,
    const double *signals,
    const double *theta,
    double *x,
    double *d_x,
    double *force,
    double *d_force)
{
    SGMS_JOIN(SGMS_MACHINE, terms) of;
    sgms_real state[STATES], sensitivity[STATES * PARAMETERS], at[PARAMETERS];
    if (MERGED != 1) {
        return -1;
    }
    for (int i = 0; i < STATES; i++) {
        state[i] = (sgms_real)x[i];
    }
    for (int i = 0; i < STATES * PARAMETERS; i++) {
        sensitivity[i] = (sgms_real)d_x[i];
    }
    for (int p = 0; p < PARAMETERS; p++) {
        at[p] = (sgms_real)theta[p];
    }
    parameter_terms(at, of.q, of.d_q, of.scale, of.d_scale);
    for (long k = 0; k < samples; k++) {
        const double *signal = signals + 5 * k;
        if (k > 0) {
            /* One step: x1 = f(x0, theta), d_x1 = A d_x0 + B. */
            sgms_real term[2 * TERMS * LANES], one[ONE_SIZE];
            sgms_real next[STATES], a[STATES * STATES], b[STATES * PARAMETERS], moved[STATES * PARAMETERS], w[5];
            for (int i = 0; i < 5; i++) {
                w[i] = (sgms_real)signal[i - (STEP_ROWS > STEPS ? 5 : 0)];
            }
            sample_terms(w, term, LANES);
            for (int i = 0; i < 5; i++) {
                w[i] = (sgms_real)signal[i];
            }
            sample_terms(w, term + TERMS * LANES, LANES);
            start_one(&of, state, one);
            integrate_one(term, of.q, one);
            one_end(&of, one, state, next, a, b);
            for (int i = 0; i < STATES; i++) {
                for (int p = 0; p < PARAMETERS; p++) {
                    sgms_real sum = b[i * PARAMETERS + p];
                    for (int j = 0; j < STATES; j++) {
                        sum += a[i * STATES + j] * sensitivity[j * PARAMETERS + p];
                    }
                    moved[i * PARAMETERS + p] = sum;
                }
            }
            for (int i = 0; i < STATES * PARAMETERS; i++) {
                sensitivity[i] = moved[i];
            }
            for (int i = 0; i < STATES; i++) {
                state[i] = next[i];
            }
        }
        put_force(state, sensitivity, signal, at, force + k, d_force ? d_force + k * PARAMETERS : 0);
    }
    for (int i = 0; i < STATES; i++) {
        x[i] = (double)state[i];
    }
    for (int i = 0; i < STATES * PARAMETERS; i++) {
        d_x[i] = (double)sensitivity[i];
    }
    return 0;
}
