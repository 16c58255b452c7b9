/* One public call of a package with any arguments, on memory of any content: what Frama-C/Eva looks at. Compiled as
 * package.h says, and with -DPROVED=CALL_... for the call. Nothing is assumed of the memory, so that what holds for one
 * call holds for every sequence of calls, and after any bit has flipped. */
#include "__fc_builtin.h"

extern double fabs(double);
extern float fabsf(float);
extern void *memcpy(void *, const void *, unsigned long);
#define __builtin_fabs fabs
#define __builtin_fabsf fabsf
#define __builtin_memcpy memcpy
#define SGMS_FENCE() ((void)0)

#include SGMS_SOURCE

#define JOIN2(a, b) a##_##b
#define JOIN(a, b) JOIN2(a, b)
#define CALL(name) JOIN(SGMS_MACHINE, name)

enum { TICK, SAMPLE, INSERT, PREPARE, FEEDBACK, ESTIMATE, SAVE_LOAD, SET, INIT };

static CALL(t) axis;
static CALL(saved_t) saved;
static CALL(signals) signals;
static CALL(settings_t) settings;
static CALL(estimate_t) estimate;

#define ANY(object) Frama_C_make_unknown((char *)&(object), sizeof(object))

int main(void)
{
    CALL(real) a, b;
    CALL(position) position;
    int i, j;
    ANY(axis);
    ANY(saved);
    ANY(signals);
    ANY(settings);
    ANY(a);
    ANY(b);
    ANY(position);
    ANY(i);
    ANY(j);
    switch (PROVED) {
    case TICK:
        a = CALL(tick)(&axis, position, a);
        break;
    case SAMPLE:
        a = CALL(sample)(&axis, position, a);
        break;
    case INSERT:
        a = CALL(insert)(&axis, &signals);
        CALL(ahead)(&axis, a, b);
        CALL(compensate)(&axis, i);
        a = CALL(share)(&axis);
        break;
    case PREPARE:
        CALL(prepare)(&axis);
        break;
    case FEEDBACK:
        i = CALL(feedback)(&axis);
        break;
    case ESTIMATE:
        CALL(estimate)(&axis, &estimate);
        i = CALL(check)((size_t)i, (uint32_t)j) + CALL(status_text)(i)[0];
        break;
    case SAVE_LOAD:
        i = CALL(save)(&axis, &saved);
        ANY(saved);
        i = CALL(load)(&axis, &saved);
        break;
    case SET:
        i = CALL(set_mass)(&axis, a);
#if HAS_ORIGIN
        i = CALL(set_origin)(&axis, position);
#endif
        i = CALL(hold)(&axis, i, j);
        i = CALL(set_parameter)(&axis, j, a, b);
        CALL(reset)(&axis);
        break;
    default:
        CALL(init)(&axis);
        i = CALL(init_with)(&axis, &settings);
        break;
    }
    return i;
}
