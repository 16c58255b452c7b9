/* Every public call of one package along a motion that asks for much, on two axes, one task and two: presliding, moves
 * up to speed and beyond, standstill, gaps, readings that are none, samples lost, resets, signals of a chain of its
 * own. Prints digest of the bits of all that came out, numbers that it is of, statuses that were seen (one bit each: 0
 * OK, 1 to 8 the flags in their order, 9 to 13 the refusals) the same wherever arithmetic is that of IEEE 754 and
 * nothing contracts it. Compiled as package.h says; on an emulated microcontroller (-DON_TARGET) the three go to
 * results.bin, 64 bits each. */
#include "damage.h"

#ifdef ON_TARGET
#include "target.h"
#else
#include <inttypes.h>
#include <stdio.h>
#ifdef __SSE2__
#include <xmmintrin.h>
#endif
#endif

static machine by_tick, by_tasks;
static uint64_t digest = UINT64_C(0xcbf29ce484222325), numbers, statuses;
static uint32_t noise = 1;
static double position, velocity, friction; /* of the axis, m, m/s, N */
static double fed;                          /* N, by the last sample */
static int is_late;                         /* the slower task does not come */
static double share = 1.0;                  /* of the friction's usual level */
static int obeys_model;                     /* friction is what was fed forward, otherwise one that parameters chase */

/* --- digest ------------------------------------------------------------------------------------------------------ */

static int is_low_first(void)
{
    const uint16_t one = 1;
    return *(const unsigned char *)&one == 1;
}

/* Numbers of `size` bytes, the low byte of each first. */
static void digest_numbers(const void *bytes, unsigned size, unsigned count)
{
    const unsigned char *byte = bytes;
    for (; count > 0; count--, byte += size) {
        for (unsigned i = 0; i < size; i++) { /* FNV-1a */
            digest = (digest ^ byte[is_low_first() ? i : size - 1 - i]) * UINT64_C(0x100000001b3);
        }
    }
}

static void take_number(machine_real number)
{
    digest_numbers(&number, sizeof number, 1);
    numbers++;
}

/* A structure of one number. */
static void take_position(const machine_position *given)
{
    digest_numbers(given, sizeof *given, 1);
    numbers++;
}

static void take_status(int status)
{
    const int32_t value = status;
    digest_numbers(&value, sizeof value, 1);
    numbers++;
    statuses |= status < 0 ? UINT64_C(1) << (8 - status) : status == 0 ? 1u : (uint64_t)status << 1;
    for (const char *text = CALL(status_text)(status); *text; text++) {
        digest_numbers(text, 1, 1);
    }
}

static void take_estimate(const machine *axis)
{
    machine_estimate e;
    CALL(estimate)(axis, &e);
    take_number(e.friction);
    take_number(e.friction_measured);
    for (int i = 0; i < ELEMENTS; i++) {
        take_number(e.deflection[i]);
    }
    for (int i = 0; i < PARAMETERS; i++) {
        take_number(e.parameter[i]);
        take_number(e.deviation[i]);
    }
    take_number(e.innovation);
    take_number(e.test_ratio);
    take_number(e.noise_scale);
    digest_numbers(&e.update, sizeof e.update, 1);
    digest_numbers(&e.age, sizeof e.age, 1);
    digest_numbers(&e.numeric, sizeof e.numeric, 1);
    take_status(e.status);
    take_number(CALL(share)(axis));
}

/* --- samples ----------------------------------------------------------------------------------------------------- */

/* After a sample: the slower task, where it comes in time. */
static void follow_sample(void)
{
    if (!CALL(due)(&by_tasks)) {
        return;
    }
    if (!is_late) {
        take_status(CALL(feedback)(&by_tasks));
        CALL(prepare)(&by_tasks);
        take_estimate(&by_tasks);
        take_estimate(&by_tick);
    }
}

static void take_sample(machine_position at, machine_real force)
{
    const machine_real given = CALL(tick)(&by_tick, at, force);
    fed = (double)given;
    take_number(given);
    take_number(CALL(sample)(&by_tasks, at, force));
    follow_sample();
}

/* The same from a chain of the caller's, who looks after the feedback. */
static void insert_both(const machine_signals *signals)
{
    if (CALL(due)(&by_tick) && !is_late) {
        take_status(CALL(feedback)(&by_tick));
    }
    take_number(CALL(insert)(&by_tick, signals));
    take_number(CALL(insert)(&by_tasks, signals));
    follow_sample();
}

/* A number of -1 to 1. */
static double next_noise(void)
{
    noise = noise * 1664525u + 1013904223u;
    return (double)(int32_t)noise * 4.656612873077393e-10;
}

/* So many samples at an acceleration, with a friction that turns round over some distance. */
static void move(double acceleration, long count)
{
    const double level = share * 8.0 * (double)MEASUREMENT_SD, reach = 100.0 * (double)HOLD_PATH;
    for (long k = 0; k < count; k++) {
        double way;
        velocity += acceleration * (double)SAMPLE_TIME;
        way = velocity * (double)SAMPLE_TIME;
        position += way;
        friction += (way - (way > 0.0 ? way : -way) * friction / level) * level / reach;
        friction = friction > level ? level : friction < -level ? -level : friction;
        take_sample(
            CALL(position_from_metres)(position),
            (machine_real)((obeys_model ? fed : friction) + (double)MASS * acceleration + 0.02 * level * next_noise()));
    }
}

static void stand(long count)
{
    velocity = 0.0;
    move(0.0, count);
}

/* It stands, and the set-point says that it will not for long. */
static void stand_and_wait(long count)
{
    for (long k = 0; k < count; k++) {
        const machine_real soon = k % 8 < 4 ? (machine_real)0 : (machine_real)MAX_VELOCITY;
        CALL(ahead)(&by_tick, soon, (machine_real)0);
        CALL(ahead)(&by_tasks, soon, (machine_real)0);
        stand(1);
    }
}

/* To and fro over a distance, with this speed at the most, in a whole number of samples. */
static void stroke(double speed, double distance)
{
    const double h = (double)SAMPLE_TIME;
    const long count = 2 + (long)(distance / (speed * h));
    const double acceleration = speed / ((double)count * h);
    velocity = 0.0;
    move(acceleration, count);
    move(-acceleration, 2 * count);
    move(acceleration, count);
}

/* --- phases ------------------------------------------------------------------------------------------------------ */

/* Calls before there is anything to do, and conversions. */
static void begin(void)
{
    for (unsigned i = 0; i < sizeof by_tick; i++) { /* of any content */
        ((unsigned char *)&by_tick)[i] = 0x5a;
        ((unsigned char *)&by_tasks)[i] = 0x5a;
    }
    CALL(init)(&by_tick);
    CALL(init)(&by_tasks);
    CALL(prepare)(&by_tasks);
    take_status(CALL(feedback)(&by_tasks));
    take_estimate(&by_tasks);
    CALL(compensate)(&by_tick, 1);
    CALL(compensate)(&by_tasks, 1);
    for (int64_t counts = -3; counts <= 3; counts += 2) {
        const machine_position of_counts[] = {
            CALL(position_from_counts)(counts * 123456789, 16384, 20000000),
            CALL(position_from_counts)(counts * 1234567890123, 1, 4000000), CALL(position_from_counts)(counts, 0, 1000),
            CALL(position_from_counts)(counts, 4, -1000)};
        for (unsigned i = 0; i < sizeof of_counts / sizeof of_counts[0]; i++) {
            take_position(&of_counts[i]);
        }
    }
}

/* The first reading of one channel comes late, at every place of an interval. */
static void begin_late(void)
{
    const double zero = position - position;
    for (int place = 0; place < 2 * SAMPLES; place++) {
        const machine_position none = CALL(position_from_metres)(zero / zero);
        const machine_position good = CALL(position_from_metres)(position);
        CALL(init)(&by_tick);
        CALL(init)(&by_tasks);
        for (int k = 0; k <= place / 2; k++) {
            take_sample(place % 2 ? none : good, place % 2 ? (machine_real)1 : (machine_real)(zero / zero));
        }
        stand(SETTLE + 2L * SAMPLES);
    }
}

/* On and on at a low speed, until all doubt is gone, then at one that a gate knows from standstill, while every element
 * slips; then an error of the model that seems to have stayed for long. */
static void glide(void)
{
    const double speed = 0.05 * (double)MAX_VELOCITY, over_interval = speed / ((double)SAMPLES * (double)SAMPLE_TIME);
    velocity = 0.0;
    move(over_interval, SAMPLES);
    move(0.0, 150L * SAMPLES);
    move(-0.8 * over_interval, SAMPLES);
    move(0.0, 10L * SAMPLES);
#if SPREADS
    damage(&by_tasks, SQUARES, 3);
    move(0.0, 2L * SAMPLES);
    damage(&by_tasks, SQUARES, 1);
#endif
}

#if SPREADS
/* To and fro over some blocks of intervals, with a friction that is another one in each: parameters wander farther than
 * they take from their variances. */
static void wander(void)
{
    for (int k = 0; k < 60; k++) {
        share = k / 12 % 2 == 0 ? 0.5 : 1.5;
        stroke(0.01 * (double)MAX_VELOCITY, 0.01 * (double)MAX_VELOCITY * (double)SAMPLE_TIME * (double)SAMPLES);
    }
    share = 1.0;
}
#endif

/* Loops of growing size through presliding, then moves up to the largest speed. */
static void go_round(void)
{
    const double hold = (double)HOLD_PATH, fastest = (double)MAX_VELOCITY;
    for (double size = 0.2; size < 400.0; size *= 2.5) {
        const double wanted = 4.0 * size * hold / ((double)SAMPLES * (double)SAMPLE_TIME);
        stroke(wanted < 0.5 * fastest ? wanted : 0.5 * fastest, size * hold);
    }
    for (double speed = 0.01; speed < 1.1; speed *= 4.0) {
        const double way = 60.0 * speed * fastest * (double)SAMPLE_TIME;
        stroke(speed * fastest, way);
    }
}

/* Readings that are none: one, a few, more than the filters bridge; of one channel and of both. */
static void lose_readings(void)
{
    const double zero = position - position;
    const machine_real nan = (machine_real)(zero / zero), infinite = (machine_real)1e30 * (machine_real)1e30;
    for (int round = 0; round < 3; round++) {
        const long count = round == 0 ? 1 : round == 1 ? 5 : (long)SETTLE + 40;
        for (int channels = 1; channels < 4; channels++) {
            for (long k = 0; k < count; k++) {
                const machine_position none = CALL(position_from_metres)(channels == 3 ? 5e6 : zero / zero);
                const machine_position good = CALL(position_from_metres)(position);
                const machine_real force = k % 2 ? nan : infinite;
                take_sample(channels & 1 ? none : good, channels & 2 ? force : (machine_real)1);
            }
            stroke(0.2 * (double)MAX_VELOCITY, 200.0 * (double)HOLD_PATH);
        }
    }
}

/* A reading that is none, of either channel, at every place of an interval. */
static void lose_one(void)
{
    const double zero = position - position;
    const long between = (SETTLE / SAMPLES + 1L) * SAMPLES;
    velocity = 0.1 * (double)MAX_VELOCITY;
    for (int place = 0; place < SAMPLES; place++) {
        const machine_position none = CALL(position_from_metres)(zero / zero);
        const machine_position good = CALL(position_from_metres)(position);
        take_sample(place % 2 ? none : good, place % 2 ? (machine_real)1 : (machine_real)(zero / zero));
        move(0.0, between);
    }
    for (long lost = SETTLE; lost <= (long)SETTLE + 1; lost++) { /* as long as the last velocity holds, and longer */
        for (long k = 0; k < lost; k++) {
            take_sample(CALL(position_from_metres)(zero / zero), (machine_real)1);
        }
        move(0.0, between);
    }
}

/* The slower task does not come for an interval; then it does. */
static void be_late(void)
{
    is_late = 1;
    stroke(0.1 * (double)MAX_VELOCITY, 100.0 * (double)HOLD_PATH);
    move(0.0, SAMPLES + 2);
    is_late = 0;
    move(0.0, 2L * SAMPLES);
}

/* Signals of a chain of the controller's own, the set-point ahead, the force off and on. */
static void insert_signals(long count)
{
    const double level = 8.0 * (double)MEASUREMENT_SD, speed = 0.3 * (double)MAX_VELOCITY;
    for (long k = 0; k < count; k++) {
        const int forth = k % 140 < 70;
        const double v = (forth ? speed : -speed) * (k % 35 < 30 ? 1.0 : 0.001);
        const machine_signals signals = {
            (machine_real)position,
            (machine_real)v,
            (machine_real)0,
            (machine_real)(forth ? level : -level),
            (machine_real)(k % 97 == 0 ? 1e12
                           : forth     ? level
                                       : -level),
            k % 89 != 0,
            (machine_real)SAMPLE_TIME};
        position += v * (double)SAMPLE_TIME;
        if (k % 3 == 0) {
            const machine_real none = (machine_real)1e30 * (machine_real)1e30;
            CALL(ahead)(&by_tick, (machine_real)v, (machine_real)(k % 9));
            CALL(ahead)(&by_tasks, k % 9 ? (machine_real)v : none, k % 6 ? (machine_real)0 : none);
        }
        if (k % 200 == 0) {
            CALL(compensate)(&by_tasks, k % 400 == 0);
        }
        insert_both(&signals);
    }
    CALL(compensate)(&by_tasks, 1);
}

/* Signals of which one is no reading, and a first sample that comes through insert(). */
static void insert_none(void)
{
    for (int which = 0; which < 5; which++) {
        machine_signals signals = {
            (machine_real)0, (machine_real)0, (machine_real)0, (machine_real)1, (machine_real)1, 1, (machine_real)0};
        const machine_real none = (machine_real)1e30 * (machine_real)(which % 2 ? 1e30 : 0);
        signals.velocity = which == 1 ? none : (machine_real)(which == 0 ? 0.1 : 0.0) * MAX_VELOCITY;
        signals.position = which == 2 ? (machine_real)4.5e6 : signals.position;
        signals.acceleration = which == 3 ? none : signals.acceleration;
        signals.force = which == 4 ? (machine_real)-2e9 : signals.force;
        insert_both(&signals);
    }
}

/* The force off until nothing is left of its ramp, and on again. */
static void switch_off(void)
{
    CALL(compensate)(&by_tick, 0);
    CALL(compensate)(&by_tasks, 0);
    move(0.0, 2L * SAMPLES + 200);
    CALL(compensate)(&by_tick, 1);
    CALL(compensate)(&by_tasks, 1);
}

/* What no axis does: forces and jumps that leave no solution, faster than the machine may be. */
static void go_wild(void)
{
    for (long k = 0; k < 3L * SAMPLES + 50; k++) {
        const double jump = k % 7 ? 0.0 : 3e3 * next_noise();
        take_sample(CALL(position_from_metres)(position + jump), (machine_real)(9e8 * next_noise()));
    }
    for (long k = 0; k < 2L * SAMPLES + 50; k++) {
        const double to = (k % 2 ? 3.9e6 : -3.9e6);
        take_sample(CALL(position_from_metres)(to), (machine_real)(k % 3 ? 9.9e8 : -9.9e8));
    }
    for (long k = 0; k < 30; k++) { /* a motion that goes on would leave the range, on either side */
        const double to = k % 6 < 3 ? k % 2 ? 3.9e6 : -3.9e6 : 5e6;
        take_sample(CALL(position_from_metres)(k < 15 ? to : -to), (machine_real)1);
    }
}

static void start_anew(void)
{
    CALL(reset)(&by_tick);
    CALL(reset)(&by_tasks);
    CALL(prepare)(&by_tasks);
    take_status(CALL(feedback)(&by_tasks));
}

/* A call that sets something, and what it said. */
static void set_number(machine_real value, machine_real deviation)
{
    machine_estimate e;
    CALL(estimate)(&by_tick, &e);
    for (int p = -1; p <= PARAMETERS; p++) {
        const machine_real now = p < 0 || p == PARAMETERS ? (machine_real)0 : e.parameter[p];
        take_status(CALL(set_parameter)(&by_tick, p, now * value, deviation));
        take_status(CALL(set_parameter)(&by_tasks, p, now * value, deviation));
    }
}

/* Payload; parameters held, set and let go. */
static void set_and_hold(void)
{
    const machine_real none = (machine_real)1e30 * (machine_real)1e30;
    take_status(CALL(set_mass)(&by_tick, MASS * (machine_real)30));
    take_status(CALL(set_mass)(&by_tick, MASS * (machine_real)0.01));
    take_status(CALL(set_mass)(&by_tick, MASS));
    take_status(CALL(set_mass)(&by_tasks, MASS));
#if HAS_ORIGIN
    take_status(CALL(set_origin)(&by_tick, CALL(position_from_metres)(5e6)));
    for (int k = 0; k < 2; k++) {
        take_status(CALL(set_origin)(&by_tick, CALL(position_from_metres)(0.0123)));
        take_status(CALL(set_origin)(&by_tasks, CALL(position_from_metres)(0.0123)));
        go_round();
    }
#endif
    stand(SETTLE + 10L);
    for (int on = 1; on >= 0; on--) {
        for (int p = -1; p <= PARAMETERS; p++) {
            take_status(CALL(hold)(&by_tick, p, on));
            take_status(CALL(hold)(&by_tasks, p, on));
            take_estimate(&by_tick);
        }
        go_round();
    }
    set_number((machine_real)1, (machine_real)0);
    go_round();
    set_number((machine_real)1, (machine_real)1e4);
    set_number((machine_real)1, (machine_real)-1);
    set_number((machine_real)1, (machine_real)1e-20);
    set_number((machine_real)1, none);
    set_number(none, (machine_real)1);
    set_number((machine_real)0, (machine_real)1); /* a level of zero, where there are no bounds */
    set_number((machine_real)-100, (machine_real)1);
    take_estimate(&by_tasks);
}

/* Load what was saved with one of its words another, and with the checksum of what it then is (CRC-32). */
static void load_sealed(const machine_saved *saved, unsigned word, uint32_t value)
{
    machine_saved changed = *saved;
    unsigned char *const bytes = (unsigned char *)&changed;
    const unsigned is_half = word >= offsetof(machine_saved, theta) / 4 && sizeof(machine_real) == 8;
    const unsigned at = is_half && !is_low_first() ? word ^ 1u : word; /* the same half of the number everywhere */
    uint32_t sum = UINT32_C(0xffffffff);
    for (unsigned i = 0; i < sizeof value; i++) {
        bytes[4u * at + i] = ((const unsigned char *)&value)[i];
    }
    for (unsigned i = 4; i < sizeof changed; i++) {
        sum ^= bytes[i];
        for (int bit = 0; bit < 8; bit++) {
            sum = (sum >> 1) ^ (UINT32_C(0xedb88320) & (0u - (sum & 1u)));
        }
    }
    changed.checksum = ~sum;
    take_status(CALL(load)(&by_tasks, &changed));
}

/* The largest and the least deviation of a measurement that the settings take, to some percent. */
static void find_limits(void)
{
    for (int is_large = 0; is_large < 2; is_large++) {
        double limit = 1.0;
        for (int k = 8; k >= -4; k--) { /* factors of 2^(2^k) down to 1.04 */
            machine_settings settings;
            double factor = k >= 0 ? 2.0 : 1.0 + 1.0 / (double)(1 << -k);
            int status;
            for (int i = 0; i < k; i++) {
                factor *= factor;
            }
            factor = is_large ? limit * factor : limit / factor;
            CALL(settings)(&settings);
            settings.measurement = (machine_real)factor;
            status = CALL(init_with)(&by_tick, &settings);
            take_status(status);
            limit = status == CONSTANT(REFUSED) ? limit : factor;
        }
    }
}

/* Every number of the settings as none that it may be. */
static void set_wrong(void)
{
    const machine_real size = sizeof(machine_real) == 4 ? (machine_real)1e30
                                                        : (machine_real)1e30 * (machine_real)1e30 * (machine_real)1e30;
    const machine_real large = size * size * size * size, wrong[] = {(machine_real)-9, large * 0, large, -large};
    machine_settings settings;
    machine_real *const numbers = (machine_real *)&settings;
    for (unsigned i = 0; i < sizeof settings / sizeof *numbers; i++) {
        for (int k = 0; k < 5; k++) {
            CALL(settings)(&settings);
            numbers[i] = k < 4 ? wrong[k] : (machine_real)1;
            take_status(CALL(init_with)(&by_tick, &settings));
        }
    }
    find_limits();
}

/* A power cycle, with what was saved, and with what no one saved; other weights. */
static void save_and_load(void)
{
    machine_saved saved;
    machine_settings settings;
    take_status(CALL(save)(&by_tasks, &saved));
    digest_numbers(saved.theta, sizeof saved.theta[0], sizeof saved.theta / sizeof saved.theta[0]);
    digest_numbers(saved.root, sizeof saved.root[0], sizeof saved.root / sizeof saved.root[0]);
    numbers += 2;
    for (unsigned word = 1; word < sizeof saved / 4; word++) {
        load_sealed(&saved, word, UINT32_C(0xc0f00000)); /* below every bound */
        load_sealed(&saved, word, UINT32_C(0x7ff80000)); /* no number */
        load_sealed(&saved, word, UINT32_C(0x47f80000)); /* beyond */
        load_sealed(&saved, word, UINT32_C(0x7f000000)); /* a number, not its square */
        load_sealed(&saved, word, UINT32_C(0x3f000000)); /* less than one */
        load_sealed(&saved, word, UINT32_C(0x1ed00000)); /* nor the inverse of its square */
        load_sealed(&saved, word, 0);
    }
    set_wrong();
    CALL(settings)(&settings);
#if DRIFTS
    for (int i = 0; i < PARAMETERS; i++) {
        settings.drift[i] = (machine_real)0;
    }
#endif
    settings.measurement = MEASUREMENT_SD * (machine_real)2;
    take_status(CALL(init_with)(&by_tick, &settings));
    take_status(CALL(init_with)(&by_tasks, &settings));
    take_status(CALL(hold)(&by_tick, 0, 1)); /* before the first sample */
    take_status(CALL(load)(&by_tick, &saved));
    take_status(CALL(load)(&by_tasks, &saved));
    take_estimate(&by_tick);
    obeys_model = 0;
    stand((HORIZON + 3L) * SAMPLES);
    go_round();
    take_estimate(&by_tick);
}

/* Signals too early and too late, and an estimate of long ago. */
static void be_out_of_time(void)
{
    for (int which = 0; which < 2; which++) {
        const machine_signals signals = {
            (machine_real)0,
            (machine_real)0,
            (machine_real)0,
            (machine_real)1,
            (machine_real)1,
            1,
            which ? (machine_real)1e12 : (machine_real)-1};
        insert_both(&signals);
    }
    is_late = 1;
    move(0.0, 3L * SAMPLES + 2);
    take_estimate(&by_tasks);
    is_late = 0;
    move(0.0, 2L * SAMPLES);
}

static long alone; /* samples */

/* Samples of one axis whose friction is what the model says, to and fro; the slower task comes. */
static void run_alone(long count)
{
    const double h = (double)SAMPLE_TIME, most = 0.3 * (double)MAX_VELOCITY / (16.0 * h);
    for (long k = 0; k < count; k++, alone++) {
        const double acceleration = (alone + 16) % 64 < 32 ? most : -most;
        const machine_real force = (machine_real)(fed + (double)MASS * acceleration);
        velocity += acceleration * h;
        position += velocity * h;
        fed = (double)CALL(sample)(&by_tasks, CALL(position_from_metres)(position), force);
        take_number((machine_real)fed);
        if (CALL(due)(&by_tasks)) {
            take_status(CALL(feedback)(&by_tasks));
            CALL(prepare)(&by_tasks);
        }
    }
}

/* Bits of the memory that flip: in the middle of an interval, and before a reset. */
static void be_damaged(void)
{
    static const int32_t values[] = {-5, 1, 3, 4, 1000, INT32_MAX};
    for (int which = 0; which < DAMAGES; which++) {
        for (unsigned k = 0; k < sizeof values / sizeof values[0]; k++) {
            CALL(init)(&by_tasks);
            CALL(compensate)(&by_tasks, 1);
            alone = 0;
            velocity = position = fed = 0.0;
            run_alone((HORIZON + 2L) * SAMPLES + SAMPLES / 2);
            damage(&by_tasks, which, values[k]);
            take_estimate(&by_tasks);
            CALL(prepare)(&by_tasks);
            run_alone(4L * SAMPLES); /* where the window starts anew: until it has gone on */
            take_estimate(&by_tasks);
            damage(&by_tasks, which, values[k]);
            CALL(reset)(&by_tasks);
            take_status(CALL(feedback)(&by_tasks));
            run_alone(SAMPLES);
            take_estimate(&by_tasks);
        }
    }
}

static void exercise(void)
{
    take_status(CALL(check)(sizeof by_tick, CONSTANT(HEADER)));
    take_status(CALL(check)(sizeof by_tick, CONSTANT(HEADER) + 1u));
    take_status(CALL(check)(sizeof by_tick - 1, CONSTANT(HEADER)));
    begin_late();
    begin();
    take_sample(CALL(position_from_metres)(5e6), (machine_real)1); /* the first readings come one by one */
    start_anew();
    take_sample(CALL(position_from_metres)(0.0), (machine_real)1e30 * (machine_real)1e30);
    stand(3L * SAMPLES);
    obeys_model = 1;
    stand((HORIZON + 3L) * SAMPLES);
    glide();
    go_round();
    stand_and_wait(100);
    obeys_model = 0;
    go_round();
#if SPREADS
    wander();
#endif
    lose_readings();
    lose_one();
    be_late();
    velocity = 1.5 * (double)MAX_VELOCITY;
    move(0.0, SAMPLES + 5L);
    velocity = 3.0 * (double)MAX_VELOCITY;
    move(0.0, SAMPLES + 5L);
    start_anew();
    go_round();
    insert_signals(6L * SAMPLES + 400);
    go_wild();
    stand(2L * SAMPLES);
    go_round();
    start_anew();
    insert_none();
    insert_signals(2L * SAMPLES + 40);
    switch_off();
    go_round();
    set_and_hold();
    go_round();
    save_and_load();
    be_out_of_time();
    be_damaged();
}

#ifdef ON_TARGET
uint32_t target_loop_count; /* the start code counts with it; nothing here does */

int target_main(void)
{
    uintptr_t opened[3] = {(uintptr_t)"results.bin", 5, 11}; /* "wb" */
    const int file = target_host(SYS_OPEN, opened);
    uint64_t results[3];
    uintptr_t written[3] = {(uintptr_t)file, (uintptr_t)results, sizeof results};
    exercise();
    results[0] = digest;
    results[1] = numbers;
    results[2] = statuses;
    return file < 0 || target_host(SYS_WRITE, written) != 0;
}
#else
#ifdef __SSE2__
/* True if an axis does not start where subnormals are zero, or sums are rounded up. */
static int is_refused_without_ieee_numbers(void)
{
    const unsigned usual = _mm_getcsr();
    int refusals = 0;
    for (int k = 0; k < 2; k++) {
        _mm_setcsr(usual | (k == 0 ? 0x8000u : 0x4000u));
        refusals += CALL(check)(sizeof by_tick, CONSTANT(HEADER)) == CONSTANT(ARITHMETIC);
        CALL(init)(&by_tick);
        refusals += CALL(feedback)(&by_tick) == CONSTANT(ARITHMETIC);
        _mm_setcsr(usual);
    }
    return refusals == 4;
}
#endif

int main(void)
{
#ifdef __SSE2__
    if (!is_refused_without_ieee_numbers()) {
        return 1;
    }
#endif
    exercise();
    printf("%016" PRIx64 " %" PRIu64 " %" PRIu64 "\n", digest, numbers, statuses);
    return 0;
}
#endif
