/* An extended Kalman filter written by hand: Maxwell-slip elements, their stiffness estimated, dense matrices.
 *
 * An element sticks or slips at its share of the Coulomb level. The measurement is the force that mass and
 * acceleration leave. 1 kHz. */
#include "filter.h"
#include "matrix.h"

static void predict(filter_t *f)
{
    float A[STATES * STATES] = {0}, AP[STATES * STATES];
    for (int i = 0; i < ELEMENTS; i++) {
        const float share = f->x[ELEMENTS + i];
        const float limit = FRACTION[i] * COULOMB / (STIFFNESS[i] * share);
        const float moved = f->x[i] + f->travel;
        A[(ELEMENTS + i) * (STATES + 1)] = 1.0f;
        if (moved > limit || moved < -limit) {
            f->x[i] = moved > 0.0f ? limit : -limit;
            A[i * STATES + ELEMENTS + i] = -f->x[i] / share;
        } else {
            f->x[i] = moved;
            A[i * (STATES + 1)] = 1.0f;
        }
    }
    multiply(A, f->P, AP, STATES, STATES, STATES, 0);
    multiply(AP, A, f->P, STATES, STATES, STATES, 1);
    for (int i = 0; i < ELEMENTS; i++) {
        const float noise = DEFLECTION_NOISE * FRACTION[i] * COULOMB / STIFFNESS[i];
        f->P[i * (STATES + 1)] += noise * noise;
        f->P[(ELEMENTS + i) * (STATES + 1)] += DRIFT * DRIFT;
    }
}

static void correct(filter_t *f)
{
    float H[STATES], PH[STATES], S[1], K[STATES], HP[STATES];
    for (int i = 0; i < ELEMENTS; i++) {
        H[i] = STIFFNESS[i] * f->x[ELEMENTS + i];
        H[ELEMENTS + i] = STIFFNESS[i] * f->x[i];
    }
    multiply(f->P, H, PH, STATES, STATES, 1, 0);
    multiply(H, PH, S, 1, STATES, 1, 0);
    const float innovation = filter_measured(f) - filter_friction(f);
    for (int i = 0; i < STATES; i++) {
        K[i] = PH[i] / (S[0] + NOISE * NOISE);
        f->x[i] += K[i] * innovation;
    }
    multiply(H, f->P, HP, 1, STATES, STATES, 0);
    for (int i = 0; i < STATES; i++) {
        for (int j = 0; j < STATES; j++) {
            f->P[i * STATES + j] -= K[i] * HP[j];
        }
    }
    for (int i = 0; i < ELEMENTS; i++) { /* a stiffness is no negative one */
        f->x[ELEMENTS + i] = f->x[ELEMENTS + i] < 0.2f ? 0.2f : f->x[ELEMENTS + i];
    }
}

static void filter_step(filter_t *f)
{
    predict(f);
    correct(f);
}
