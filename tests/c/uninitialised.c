/* Calls of one package in orders that a controller may well choose, on memory that nothing has written to: to be run
 * where reading it does not go unnoticed. Compiled with a package:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_UPPER=ETEL_XY -DSGMS_MACHINE_HEADER='"etel_xy.h"' */
#include <stdio.h>
#include <stdlib.h>

#include SGMS_MACHINE_HEADER

#include "joined.h"

typedef CALL(t) machine;

enum { SAMPLES = JOIN(SGMS_MACHINE_UPPER, SAMPLES) };

/* Print every number, so that none of unknown origin goes unnoticed. */
static void print_estimate(const machine *self)
{
    CALL(estimate_t) estimate;
    CALL(estimate)(self, &estimate);
    printf("%.17g %.17g %d", (double)estimate.friction, (double)estimate.friction_measured, estimate.status);
    for (int i = 0; i < JOIN(SGMS_MACHINE_UPPER, ELEMENTS); i++) {
        printf(" %.17g", (double)estimate.deflection[i]);
    }
    for (int i = 0; i < JOIN(SGMS_MACHINE_UPPER, PARAMETERS); i++) {
        printf(" %.17g %.17g", (double)estimate.parameter[i], (double)estimate.deviation[i]);
    }
    printf("\n");
}

/* A short motion; the slower task runs `often` times between two samples. */
static void run(machine *self, int updates, int often)
{
    for (int k = 0; k <= updates * SAMPLES; k++) {
        const double t = (double)(k % 400) / 400.0, fraction = t < 0.5 ? t : 1.0 - t;
        const CALL(signals) signals = {
            .position = (CALL(real))(2e-5 * fraction),
            .velocity = (CALL(real))(t < 0.5 ? 1e-3 : -1e-3),
            .force = (CALL(real))1,
            .friction = (CALL(real))(t < 0.5 ? 3 : -3),
            .valid = k % 700 != 0};
        const double fed = (double)CALL(insert)(self, &signals);
        if (fed != 0.0) {
            printf("%.17g\n", fed);
        }
        if (CALL(due)(self)) {
            (void)CALL(feedback)(self);
            print_estimate(self);
        }
        for (int i = 0; i < often; i++) {
            CALL(prepare)(self);
        }
    }
}

int main(void)
{
    for (int order = 0; order < 4; order++) {
        machine *const self = malloc(sizeof *self);
        if (!self) {
            return 2;
        }
        CALL(init)(self);
        CALL(compensate)(self, 1);
        if (order & 1) { /* the slower task starts first */
            CALL(prepare)(self);
        }
        print_estimate(self);
        run(self, 3, order & 1);
        CALL(reset)(self);
        if (order & 2) {
            CALL(prepare)(self);
            (void)CALL(feedback)(self);
            CALL(reset)(self);
        }
        run(self, 8, order >> 1);
        free(self);
    }
    return 0;
}
