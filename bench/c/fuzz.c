/* Random calls of one package on memory of any content, with arguments of any bits. What has to hold, whatever comes:
 *
 *   - no sanitizer finds anything; what is returned are finite numbers and known statuses;
 *   - parameters stay within their bounds, sigmas are not negative, the force stays within its limit;
 *   - a reset leaves nothing behind but the last good estimate, and init nothing at all: after it the axis is, bit by
 *     bit, one that was just started with these parameters on other memory; and given good data it estimates again;
 *   - one task and two give the same estimates.
 *
 * An input is a series of bytes: what is called, and with what. Compiled as package.h says, with -fsanitize=fuzzer, or
 * with -DOWN_DRIVER for inputs of its own:
 *     fuzz SEED CALLS      random inputs until so many calls are done; prints how many
 *     fuzz FILE...         what libFuzzer kept
 * libFuzzer's program ends after $CALLS calls where that is set. MOST_CALLS: of one input. */
#include "fuzz.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { RECOVERY = SETTLE / SAMPLES + 4 /* updates */ };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerInitialize(int *argc, char ***argv);

static unsigned long long wanted_calls = UINT64_MAX;
static long sample_count; /* of the good motion */

/* --- calls ------------------------------------------------------------------------------------------------------- */

/* Memory of an axis, of its size exactly, full of one byte; left as it comes where the byte is 0: whoever reads it
 * before it is written is found out. */
static machine *memory_of(unsigned fill)
{
    machine *const axis = malloc(sizeof *axis);
    if (!axis) {
        fail("no memory");
    }
    if (fill) {
        memset(axis, (int)fill, sizeof *axis);
    }
    return axis;
}

/* One sample through one task (tick), or through two. */
static void sample_by(machine *axis, int by_tasks, machine_position position, machine_real force)
{
    if (!by_tasks) {
        check_force(CALL(tick)(axis, position, force));
        return;
    }
    check_force(CALL(sample)(axis, position, force));
    if (CALL(due)(axis)) {
        (void)check_status(CALL(feedback)(axis));
        CALL(prepare)(axis);
        calls++;
    }
}

/* Sample k of a motion as an axis makes it: to and fro over hundreds of hold paths, a Coulomb level that follows. */
void next_good(machine_position *position, machine_real *force)
{
    const double wide = 300.0 * (double)HOLD_PATH, level = 8.0 * (double)MEASUREMENT_SD;
    const long period = 6L * SAMPLES + 40;
    const long k = sample_count++ % (2 * period);
    const double phase = (double)(k < period ? k : 2 * period - k) / (double)period; /* 0 to 1 to 0 */
    const double slow = (double)MAX_VELOCITY * (double)SAMPLE_TIME * (double)period * 0.2;
    *position = CALL(position_from_metres)((wide < slow ? wide : slow) * phase * phase * (3.0 - 2.0 * phase));
    *force = (machine_real)(k < period ? level : -level);
}

static void take_signals(bytes *from, machine_signals *signals)
{
    signals->position = take_real(from);
    signals->velocity = take_real(from);
    signals->acceleration = take_real(from);
    signals->force = take_real(from);
    signals->friction = take_real(from);
    signals->valid = take_real(from);
    signals->delay = take_real(from);
}

/* Many samples: of a motion that an axis makes, the same one again and again, small noise about it, or garbage from a
 * generator, here and there. */
static void run(bytes *from, machine *axis)
{
    const unsigned kind = take_byte(from), length = take_byte(from), by_tasks = take_byte(from) & 1;
    const long count = 1 + (long)length * (kind & 64 ? (SAMPLES + 3) / 4 : 1);
    uint32_t random = (uint32_t)take_bits(from) | 1u;
    machine_position position = take_position(from);
    machine_real force = take_real(from);
    for (long k = 0; k < count && calls_of_input < MOST_CALLS; k++) {
        machine_position now = position;
        machine_real pushed = force;
        random ^= random << 13;
        random ^= random >> 17;
        random ^= random << 5;
        if (kind % 4 == 0 || (kind % 4 == 1 && random % 16 != 0)) {
            next_good(&now, &pushed);
        } else if (kind % 4 == 2) {
            now = CALL(position_from_metres)(((double)(random & 0xffff) - 32768.0) * 1e-12 * (double)(1 + kind % 64));
            pushed = (machine_real)((double)(random >> 16) - 32768.0) * (machine_real)1e-3;
        }
        sample_by(axis, (int)by_tasks, now, pushed);
    }
}

/* A power cycle: what is saved is taken back, and what has one bit flipped is not. */
static void cycle(bytes *from, machine *axis)
{
    machine_saved saved;
    const size_t bit = (size_t)take_bits(from) % (8 * sizeof saved);
    hold(check_status(CALL(save)(axis, &saved)) == CONSTANT(OK), "what was learned is not saved");
    ((unsigned char *)&saved)[bit / 8] ^= (unsigned char)(1u << bit % 8);
    if (take_byte(from) % 2) {
        hold(check_status(CALL(load)(axis, &saved)) == CONSTANT(REFUSED), "a flipped bit is taken");
        check_estimate(axis);
        return;
    }
    ((unsigned char *)&saved)[bit / 8] ^= (unsigned char)(1u << bit % 8);
    hold(check_status(CALL(load)(axis, &saved)) == CONSTANT(OK), "what was saved is refused");
    check_estimate(axis);
}

/* A call that sets something, to any number or to one that may be. */
static void set(bytes *from, machine *axis)
{
    const unsigned kind = take_byte(from) % 5, part = take_byte(from);
    const machine_real any = take_real(from), factor = (machine_real)(0.5 + (double)take_byte(from) / 128.0);
    const int p = (int)(part % (PARAMETERS + 2)) - 1, is_any = take_byte(from) < 64;
    if (kind == 0) {
        (void)check_status(CALL(set_mass)(axis, is_any ? any : MASS * factor));
    } else if (kind == 1) {
        (void)check_status(CALL(hold)(axis, p, (int)take_byte(from) % 2));
    } else if (kind == 2) {
        machine_estimate e;
        CALL(estimate)(axis, &e);
        if (p >= 0 && p < PARAMETERS && !is_any) {
            (void)check_status(CALL(set_parameter)(axis, p, e.parameter[p] * factor, e.deviation[p] * factor));
        } else {
            const machine_real deviation = take_real(from);
            (void)check_status(CALL(set_parameter)(axis, p, any, deviation));
        }
    } else if (kind == 3) {
#if HAS_ORIGIN
        const double place = 0.001 * ((double)part - 128.0);
        (void)check_status(CALL(set_origin)(axis, is_any ? take_position(from) : CALL(position_from_metres)(place)));
#endif
    } else if (part < 16) {
        machine_settings settings;
        CALL(settings)(&settings);
        settings.measurement = is_any ? any : settings.measurement * factor;
        settings.state[0] *= factor;
        settings.pause[0] = part < 8 ? any : settings.pause[0];
        (void)check_status(CALL(init_with)(axis, &settings));
    }
}

/* One call, whichever comes. */
static void call(bytes *from, machine *axis)
{
    machine_signals signals;
    switch (take_byte(from) % 18) {
    case 0:
    case 1: {
        const machine_position position = take_position(from);
        check_force(CALL(sample)(axis, position, take_real(from)));
        break;
    }
    case 2: {
        const machine_position position = take_position(from);
        check_force(CALL(tick)(axis, position, take_real(from)));
        break;
    }
    case 3:
        take_signals(from, &signals);
        check_force(CALL(insert)(axis, &signals));
        break;
    case 4: {
        const machine_real velocity = take_real(from);
        CALL(ahead)(axis, velocity, take_real(from));
        break;
    }
    case 5:
        CALL(compensate)(axis, (int)take_bits(from));
        break;
    case 6:
    case 7:
        CALL(prepare)(axis);
        break;
    case 8:
    case 9: {
        const int was_due = CALL(due)(axis);
        hold((check_status(CALL(feedback)(axis)) == CONSTANT(EARLY)) == !was_due, "early, or not");
        break;
    }
    case 10:
        check_estimate(axis);
        break;
    case 11:
        (void)CALL(status_text)((int)take_bits(from));
        break;
    case 13:
        set(from, axis);
        break;
    case 14:
        if (take_byte(from) < 64) {
            cycle(from, axis);
        }
        break;
    case 12:
        if (take_byte(from) < 32) {
            CALL(reset)(axis);
        }
        if (take_byte(from) < 16) {
            CALL(init)(axis);
        }
        break;
    case 15:
        interrupt_call(from, axis);
        break;
    case 16:
        if (take_byte(from) < 64) {
            load_others(from, axis);
        }
        break;
    default:
        run(from, axis);
        break;
    }
    calls++;
    calls_of_input++;
    check_fields(axis);
}

/* --- inputs ------------------------------------------------------------------------------------------------------ */

/* Whether parameters are where data may have taken them. Those without bounds follow garbage anywhere. */
static int are_sane(const machine_real *theta)
{
    int count = 0;
    for (int i = 0; i < PARAMETERS; i++) {
        const machine_real off = (theta[i] - (machine_real)1) / prior_sd[i];
        count += off > (machine_real)-10 && off < (machine_real)10;
    }
    return count == PARAMETERS;
}

/* After a reset nothing is left but the last good estimate, and given good data the estimator works; so it does after
 * an init, whatever was before. */
static void check_recovery(machine *axis)
{
    const int is_kept = are_sane(axis->estimate.theta);
    machine *const twin = memory_of(0x5a);
    machine_estimate last;
    CALL(init)(twin);
    CALL(compensate)(twin, axis->compensation.on);
    twin->settings = axis->settings;
    twin->settings_sum = axis->settings_sum;
    twin->chain.moved = axis->chain.moved;
#if HAS_ORIGIN
    twin->chain.origin = axis->chain.origin;
#endif
    memcpy(twin->estimate.held, axis->estimate.held, sizeof twin->estimate.held);
    memcpy(twin->estimate.state, axis->estimate.state, sizeof twin->estimate.state);
    memcpy(twin->estimate.theta, axis->estimate.theta, sizeof twin->estimate.theta);
    memcpy(twin->estimate.root, axis->estimate.root, sizeof twin->estimate.root);
#if SPREADS
    memcpy(twin->estimate.spread, axis->estimate.spread, sizeof twin->estimate.spread);
#endif
    twin->estimate.ratio = axis->estimate.ratio;
    twin->estimate.friction = axis->estimate.friction;
    twin->estimate.friction_measured = axis->estimate.friction_measured;
    twin->estimate.update = axis->estimate.update;
    twin->estimate.numeric = axis->estimate.numeric;
    twin->calls.age = axis->calls.age;
#if HAS_TIME
    twin->input.elapsed = axis->input.elapsed;
#endif
    if (is_kept) {
        CALL(reset)(axis);
        CALL(reset)(twin);
    } else {
        const int on = axis->compensation.on;
        CALL(init)(axis);
        CALL(init)(twin);
        CALL(compensate)(axis, on);
        CALL(compensate)(twin, on);
    }
    sample_count = 0;
    for (long k = 0; k <= (long)RECOVERY * SAMPLES; k++) {
        machine_position position;
        machine_real force;
        next_good(&position, &force);
        sample_by(axis, 0, position, force);
        sample_by(twin, 0, position, force);
        if (k % SAMPLES == 0) {
            check_same(axis, twin, "what was before is still there");
        }
    }
    check_estimate(axis);
    CALL(estimate)(axis, &last);
    hold(last.status >= 0, "good data are refused");
    hold((last.status & (CONSTANT(MISSING) | CONSTANT(OVERRUN))) == 0, "good data are not taken");
    free(twin);
}

/* One task and two over the same samples, whatever they are. */
static void check_tasks(bytes *from, unsigned fill)
{
    machine *const one = memory_of(fill), *const two = memory_of(fill ^ 0xffu);
    CALL(init)(one);
    CALL(init)(two);
    while (from->left > 0 && calls_of_input < MOST_CALLS) {
        machine_position position = take_position(from);
        machine_real force = take_real(from);
        const int count = 1 + (int)(take_byte(from) & 63);
        const int is_good = take_byte(from) < 160;
        for (int k = 0; k < count; k++) {
            if (is_good) {
                next_good(&position, &force);
            }
            sample_by(one, 0, position, force);
            sample_by(two, 1, position, force);
        }
        if (CALL(due)(one)) { /* what its next tick() begins with */
            (void)check_status(CALL(feedback)(one));
        }
        check_same(one, two, "one task and two differ");
    }
    free(one);
    free(two);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    bytes from = {data, size};
    const unsigned kind = take_byte(&from), fill = take_byte(&from);
    calls_of_input = 0;
    sample_count = 0;
    if (kind % 8 == 0) {
        check_tasks(&from, fill);
    } else {
        machine *const axis = memory_of(fill);
        CALL(init)(axis);
        check_fields(axis);
        while (from.left > 0 && calls_of_input < MOST_CALLS) {
            call(&from, axis);
        }
        check_estimate(axis);
        if (kind % 8 < 4) {
            check_recovery(axis);
        }
        free(axis);
    }
    if (calls >= wanted_calls) {
        printf("%llu calls\n", calls);
        fflush(stdout);
        _Exit(0);
    }
    return 0;
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    const char *const wanted = getenv("CALLS");
    (void)argc;
    (void)argv;
    if (wanted) {
        wanted_calls = strtoull(wanted, NULL, 10);
    }
    return 0;
}

#ifdef OWN_DRIVER
/* Inputs from a generator, one after the other, until enough calls are done. */
static void run_inputs(uint64_t seed)
{
    static uint8_t data[2048];
    uint64_t random = seed * UINT64_C(0x9e3779b97f4a7c15) + 1;
    for (;;) {
        size_t size;
        for (size_t i = 0; i < sizeof data; i++) {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            data[i] = (uint8_t)(random >> 32);
        }
        size = (size_t)(random % sizeof data);
        (void)LLVMFuzzerTestOneInput(data, size);
    }
}

int main(int argc, char **argv)
{
    if (argc != 3) {
        return 2;
    }
    wanted_calls = strtoull(argv[2], NULL, 10);
    run_inputs(strtoull(argv[1], NULL, 10));
    return 0;
}
#endif
