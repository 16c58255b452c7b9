/* What has to hold of one call, or of an axis between two, whatever came in. */
#include "fuzz.h"

#include <stdio.h>
#include <stdlib.h>

unsigned long long calls, calls_of_input;

void fail(const char *what)
{
    fprintf(stderr, "fuzz: %s\n", what);
    abort();
}

void hold(int is_so, const char *what)
{
    if (!is_so) {
        fail(what);
    }
}

static int is_number(machine_real x)
{
    return x - x == (machine_real)0;
}

void check_force(machine_real force)
{
    hold(is_number(force), "a force that is no number");
#ifdef FORCE_LIMIT
    hold(force <= FORCE_LIMIT && force >= -FORCE_LIMIT, "a force beyond its limit");
#endif
    calls++;
    calls_of_input++;
}

int check_status(int status)
{
    hold(is_status(status), "a status that is none");
    hold(CALL(status_text)(status)[0] != '\0', "a status without a text");
    calls++;
    calls_of_input++;
    return status;
}

void check_estimate(const machine *axis)
{
    machine_estimate e;
    CALL(estimate)(axis, &e);
    (void)check_status(e.status);
    hold(is_number(e.friction) && is_number(e.friction_measured), "a friction that is no number");
    for (int i = 0; i < ELEMENTS; i++) {
        hold(is_number(e.deflection[i]), "a deflection that is no number");
    }
    for (int i = 0; i < PARAMETERS; i++) {
        const machine_real theta = axis->estimate.theta[i];
        hold(is_number(e.parameter[i]), "a parameter that is no number");
        hold(is_number(e.deviation[i]) && e.deviation[i] >= (machine_real)0, "a sigma that is none");
#if BOUNDED
        const machine_settings *const by = &axis->settings;
        hold(theta >= by->lower[i] && theta <= by->upper[i], "a parameter beyond its bounds");
#endif
    }
}

/* What the fields say of each other between two calls. */
void check_fields(const machine *axis)
{
    const machine_real share = CALL(share)(axis);
    hold(share >= (machine_real)0 && share <= (machine_real)1, "a share beyond 0 and 1");
    hold(axis->interval.filling >= 0 && axis->interval.filling < CONSTANT(SLOTS), "a slot that is none");
    hold(axis->interval.step >= 0 && axis->interval.step <= STEPS, "a step that is none");
    hold(CALL(due)(axis) == (axis->interval.step == STEPS), "due, and the interval not complete");
    hold(axis->input.count >= 0 && axis->input.count < MERGED, "samples of a step that are none");
    hold(axis->calls.version % 2 == 0, "an estimate half written");
#if WINDOW
    hold(axis->sweep.complete >= 0 && axis->sweep.complete < CONSTANT(SLOTS), "intervals that are none");
    hold(axis->sweep.cursor >= 0, "units that are none");
#endif
}

static int is_same(const machine_estimate *a, const machine_estimate *b)
{
    int same = a->friction == b->friction && a->friction_measured == b->friction_measured && a->status == b->status;
    for (int i = 0; i < ELEMENTS; i++) {
        same = same && a->deflection[i] == b->deflection[i];
    }
    for (int i = 0; i < PARAMETERS; i++) {
        same = same && a->parameter[i] == b->parameter[i] && a->deviation[i] == b->deviation[i];
    }
    return same;
}

void check_same(const machine *a, const machine *b, const char *what)
{
    machine_estimate of_a, of_b;
    CALL(estimate)(a, &of_a);
    CALL(estimate)(b, &of_b);
    hold(is_same(&of_a, &of_b), what);
}
