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
#include "package.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { RECOVERY = SETTLE / SAMPLES + 4 /* updates */ };

/* The bytes that are left of an input; zeros behind them. */
typedef struct {
    const uint8_t *at;
    size_t left;
} bytes;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerInitialize(int *argc, char ***argv);

static unsigned long long calls, wanted_calls = UINT64_MAX;
static unsigned long long calls_of_input;
static long sample_count; /* of the good motion */

static void fail(const char *what)
{
    fprintf(stderr, "fuzz: %s\n", what);
    abort();
}

static void hold(int is_so, const char *what)
{
    if (!is_so) {
        fail(what);
    }
}

/* --- input ------------------------------------------------------------------------------------------------------- */

static unsigned take_byte(bytes *from)
{
    unsigned byte = 0;
    if (from->left > 0) {
        byte = *from->at++;
        from->left--;
    }
    return byte;
}

static uint64_t take_bits(bytes *from)
{
    uint64_t bits = 0;
    for (int i = 0; i < 8; i++) {
        bits = bits << 8 | take_byte(from);
    }
    return bits;
}

/* A number: any bits, one that is an edge of something, or one of the size of signals. */
static double take_double(bytes *from)
{
    static const double edges[] = {
        0.0,    -0.0,   1.0,          -1.0,  1e-300, 5e-324, 1e300, -1.7976931348623157e308, 9.999e8, 1e9, -1e9, 4e6,
        -3.9e6, 1.0e38, 3.4028235e38, 1e-45, 1e-38,  1e18,   4e18,  9.2233720368547758e18,   2e9,     0.1, 1e-6, 1e-9};
    const unsigned kind = take_byte(from);
    double value;
    if (kind < 64) {
        const uint64_t bits = take_bits(from);
        memcpy(&value, &bits, sizeof value);
    } else if (kind < 80) {
        const uint64_t bits = (kind & 1 ? UINT64_C(0xfff) << 52 : UINT64_C(0x7ff) << 52) | (kind & 2 ? kind : 0);
        memcpy(&value, &bits, sizeof value);
    } else if (kind < 128) {
        value = edges[kind % (sizeof edges / sizeof edges[0])];
    } else {
        static const double sizes[] = {1e-9, 1e-7, 1e-5, 1e-3, 0.01, 0.1, 1.0, 30.0};
        value = ((double)take_byte(from) - 127.5) * sizes[kind % 8];
    }
    return value;
}

static machine_real take_real(bytes *from)
{
    const double value = take_double(from);
    machine_real real;
    if (take_byte(from) < 32) { /* any bits of its own */
        memcpy(&real, &value, sizeof real);
        return real;
    }
    /* beyond the range of a float the conversion is not defined */
    if (value == value && (value > 3.4028234e38 || value < -3.4028234e38)) {
        return (machine_real)(value > 0.0 ? 3.4028234e38 : -3.4028234e38);
    }
    return (machine_real)value;
}

static machine_position take_position(bytes *from)
{
    const unsigned kind = take_byte(from);
    machine_position position;
    if (kind < 48) {
        const uint64_t bits = take_bits(from);
        memcpy(&position, &bits, sizeof position);
        return position;
    }
    if (kind < 96) {
        const int64_t counts = (int64_t)take_bits(from);
        const int32_t per = (int32_t)take_bits(from);
        return CALL(position_from_counts)(counts, per, (int64_t)take_bits(from));
    }
    return CALL(position_from_metres)(take_double(from));
}

/* --- checks ------------------------------------------------------------------------------------------------------ */

static int is_number(machine_real x)
{
    return x - x == (machine_real)0;
}

static void check_force(machine_real force)
{
    hold(is_number(force), "a force that is no number");
#ifdef FORCE_LIMIT
    hold(force <= FORCE_LIMIT && force >= -FORCE_LIMIT, "a force beyond its limit");
#endif
    calls++;
    calls_of_input++;
}

static int check_status(int status)
{
    hold(is_status(status), "a status that is none");
    hold(CALL(status_text)(status)[0] != '\0', "a status without a text");
    calls++;
    calls_of_input++;
    return status;
}

static void check_estimate(const machine *axis)
{
    machine_estimate e;
    CALL(estimate)(axis, &e);
    (void)check_status(e.status);
    hold(is_number(e.friction) && is_number(e.friction_measured), "a friction that is no number");
    for (int i = 0; i < ELEMENTS; i++) {
        hold(is_number(e.deflection[i]), "a deflection that is no number");
    }
    for (int i = 0; i < PARAMETERS; i++) {
        const machine_real theta = axis->good_theta[i];
        hold(is_number(e.parameter[i]), "a parameter that is no number");
        hold(is_number(e.deviation[i]) && e.deviation[i] >= (machine_real)0, "a sigma that is none");
#if BOUNDED
        const machine_settings *const by = &axis->settings;
        hold(theta >= by->lower[i] && theta <= by->upper[i], "a parameter beyond its bounds");
#endif
    }
}

/* What the fields say of each other between two calls. */
static void check_fields(const machine *axis)
{
    const machine_real share = CALL(share)(axis);
    hold(share >= (machine_real)0 && share <= (machine_real)1, "a share beyond 0 and 1");
    hold(axis->filling >= 0 && axis->filling < CONSTANT(SLOTS), "a slot that is none");
    hold(axis->step >= 0 && axis->step <= STEPS, "a step that is none");
    hold(CALL(due)(axis) == (axis->step == STEPS), "due, and the interval not complete");
    hold(axis->merged_count >= 0 && axis->merged_count < MERGED, "samples of a step that are none");
    hold(axis->version % 2 == 0, "an estimate half written");
#if WINDOW
    hold(axis->complete >= 0 && axis->complete < CONSTANT(SLOTS), "intervals that are none");
    hold(axis->cursor >= 0, "units that are none");
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

static void check_same(const machine *a, const machine *b, const char *what)
{
    machine_estimate of_a, of_b;
    CALL(estimate)(a, &of_a);
    CALL(estimate)(b, &of_b);
    hold(is_same(&of_a, &of_b), what);
}

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
static void next_good(machine_position *position, machine_real *force)
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
    signals->valid = (int)take_bits(from);
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
    const unsigned kind = take_byte(from) % 4, part = take_byte(from);
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
    } else if (part < 16) {
        machine_settings settings;
        CALL(settings)(&settings);
        settings.measurement = is_any ? any : settings.measurement * factor;
        settings.state[0] *= factor;
        settings.pause = part < 8 ? any : settings.pause;
        (void)check_status(CALL(init_with)(axis, &settings));
    }
}

/* One call, whichever comes. */
static void call(bytes *from, machine *axis)
{
    machine_signals signals;
    switch (take_byte(from) % 16) {
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
        const machine_real off = (theta[i] - (machine_real)1) / PRIOR_SD;
        count += off > (machine_real)-10 && off < (machine_real)10;
    }
    return count == PARAMETERS;
}

/* After a reset nothing is left but the last good estimate, and given good data the estimator works; so it does after
 * an init, whatever was before. */
static void check_recovery(machine *axis)
{
    const int is_kept = are_sane(axis->good_theta);
    machine *const twin = memory_of(0x5a);
    machine_estimate last;
    CALL(init)(twin);
    CALL(compensate)(twin, axis->compensate);
    twin->settings = axis->settings;
    twin->moved = axis->moved;
    memcpy(twin->held, axis->held, sizeof twin->held);
    memcpy(twin->good_state, axis->good_state, sizeof twin->good_state);
    memcpy(twin->good_theta, axis->good_theta, sizeof twin->good_theta);
    memcpy(twin->good_root, axis->good_root, sizeof twin->good_root);
    twin->good_ratio = axis->good_ratio;
    twin->friction = axis->friction;
    twin->friction_measured = axis->friction_measured;
#if HAS_TIME
    twin->elapsed = axis->elapsed;
#endif
    if (is_kept) {
        CALL(reset)(axis);
        CALL(reset)(twin);
    } else {
        const int on = axis->compensate;
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
