/* The signal chain in single precision over positions at both ends of its range, and beyond, one after the other in
 * every order; prints how many samples had numbers that are not finite. To be built with a sanitizer of undefined
 * behaviour and -DSGMS_SINGLE=1. */
#include <stdio.h>

#include "sgms_filter.h"

enum { SAMPLES = 300000, SETTLE = 20 };

int main(void)
{
    static const int64_t positions[] = {
        0,
        1,
        -1,
        INT32_MAX,
        INT32_MIN,
        300000000000,
        -300000000000,
        SGMS_FARTHEST_PICOMETRES - 1,
        1 - SGMS_FARTHEST_PICOMETRES,
        SGMS_FARTHEST_PICOMETRES,
        -SGMS_FARTHEST_PICOMETRES,
        INT64_MAX,
        INT64_MIN};
    const uint32_t count = sizeof positions / sizeof positions[0];
    const sgms_chain chain = {
        .lowpass = {.b0 = 0.02f, .b1 = 0.04f, .b2 = 0.02f, .a1 = -1.56f, .a2 = 0.64f},
        .rate = 1e4f,
        .settle = SETTLE,
        .wanted = SGMS_POSITION + SGMS_FORCE + SGMS_ACCELERATION};
    sgms_position position[2] = {0, 0};
    sgms_real lowpass[SGMS_FILTER_STATES] = {0}, last[SGMS_FILTER_LAST] = {0};
    int32_t counts[SGMS_FILTER_COUNTS] = {0, 0, 0};
    const sgms_filter_memory memory = {
        .position = position, .lowpass = lowpass, .last = last, .counts = counts, .mass = 20.0f};
    uint32_t random = 1;
    int strange = 0;
    for (int k = 0; k < SAMPLES; k++) {
        sgms_aligned out;
        if (k % 7 != 1) { /* now and then the same again */
            random = random * 1664525u + 1013904223u;
        }
        out = sgms_filter_step(&chain, &memory, positions[(random >> 16) % count], 1.0f);
        strange += !sgms_is_finite(out.position + out.velocity + out.acceleration + out.friction);
        strange += !(sgms_position_is_good(position[0]));
    }
    printf("%d\n", strange);
    return 0;
}
