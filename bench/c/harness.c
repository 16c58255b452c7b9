/* Host program around one emitted package: replays a log or a motion of its own, prints estimates or times.
 *
 *     harness --log FILE      position_m and force_N (position_rad, torque_Nm) of a CSV log; time_s where it is there
 *     harness --motion N      a motion of its own that lasts N updates; needs no file
 *       ... --time            prints microseconds per update instead of estimates
 *     harness --selftest      runs the package's self-test
 *
 * Compiled together with a package:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_UPPER=ETEL_XY -DSGMS_MACHINE_HEADER='"etel_xy.h"'
 *     -DSGMS_CONFIG_HEADER='"etel_xy_config.h"' and, with etel_xy_selftest.c, -DSGMS_SELFTEST;
 *     -DSGMS_ROTARY for an axis that turns
 *
 * Exit codes: 0 done, 1 the self-test failed, 2 bad input. */
#define _POSIX_C_SOURCE 199309L

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include SGMS_CONFIG_HEADER
#include SGMS_MACHINE_HEADER

#define JOIN2(a, b) a##_##b
#define JOIN(a, b) JOIN2(a, b)
#define CALL(name) JOIN(SGMS_MACHINE, name)

#ifdef SGMS_ROTARY
#define POSITION_FROM position_from_radians
#define POSITION_COLUMN "position_rad"
#define FORCE_COLUMN "torque_Nm"
#define LENGTH_UNIT "rad"
#define FORCE_UNIT "Nm"
#else
#define POSITION_FROM position_from_metres
#define POSITION_COLUMN "position_m"
#define FORCE_COLUMN "force_N"
#define LENGTH_UNIT "m"
#define FORCE_UNIT "N"
#endif

typedef CALL(t) machine;
typedef CALL(real) machine_real;
typedef CALL(position) machine_position;
typedef CALL(estimate_t) machine_estimate;

enum { BAD_INPUT = 2, LINE_LENGTH = 4096 };

/* What the fast task of a controller would see, n samples. */
typedef struct {
    long n;
    double *time; /* s */
    machine_position *position;
    machine_real *force; /* N */
} series;

/* Microseconds of one update. */
typedef struct {
    double samples, feedback, prepare;
} durations;

/* All work of one update, outside of every loop that may be optimised into it: profilers toggle on this name. */
void harness_update(machine *self, const machine_position *position, const machine_real *force, durations *spent);

static void fail(const char *subject, const char *text)
{
    fprintf(stderr, "harness: %s: %s\n", subject, text);
    exit(BAD_INPUT);
}

/* --- series ---------------------------------------------------------------------------------------------------- */

static void reserve(series *s, long n)
{
    s->time = realloc(s->time, (size_t)n * sizeof *s->time);
    s->position = realloc(s->position, (size_t)n * sizeof *s->position);
    s->force = realloc(s->force, (size_t)n * sizeof *s->force);
    if (!s->time || !s->position || !s->force) {
        fail("series", "out of memory");
    }
}

static void put(series *s, long k, double time, double position, double force)
{
    s->time[k] = time;
    s->position[k] = CALL(POSITION_FROM)(position);
    s->force[k] = (machine_real)force;
}

/* Cut the next field off a line; NULL at its end. */
static char *next_field(char **rest)
{
    char *field = *rest;
    char *comma;
    if (!field) {
        return NULL;
    }
    comma = strchr(field, ',');
    *rest = comma ? comma + 1 : NULL;
    if (comma) {
        *comma = '\0';
    }
    return field;
}

/* A whole line without its end; 0 where there is none. */
static int next_line(FILE *file, const char *path, char *line)
{
    if (!fgets(line, LINE_LENGTH, file)) {
        return 0;
    }
    if (strlen(line) == LINE_LENGTH - 1 && line[LINE_LENGTH - 2] != '\n') {
        fail(path, "has a line that is too long");
    }
    line[strcspn(line, "\r\n")] = '\0';
    return 1;
}

static series read_log(const char *path)
{
    enum { TIME, POSITION, FORCE, COLUMNS };
    static const char *const names[COLUMNS] = {"time_s", POSITION_COLUMN, FORCE_COLUMN};
    int column[COLUMNS] = {-1, -1, -1};
    char line[LINE_LENGTH];
    long room = 0;
    series s = {0, NULL, NULL, NULL};
    FILE *file = fopen(path, "r");
    if (!file || !next_line(file, path, line)) {
        fail(path, "not a readable log");
    }
    {
        char *rest = line;
        int index = 0;
        for (char *field = next_field(&rest); field; field = next_field(&rest), index++) {
            for (int c = 0; c < COLUMNS; c++) {
                column[c] = strcmp(field, names[c]) == 0 ? index : column[c];
            }
        }
    }
    if (column[POSITION] < 0 || column[FORCE] < 0) {
        fail(path, "has no columns " POSITION_COLUMN " and " FORCE_COLUMN);
    }
    while (next_line(file, path, line)) {
        double value[COLUMNS] = {(double)s.n * (double)SAMPLE_TIME, (double)NAN, (double)NAN};
        char *rest = line;
        int index = 0;
        for (char *field = next_field(&rest); field; field = next_field(&rest), index++) {
            for (int c = 0; c < COLUMNS; c++) {
                if (column[c] == index) {
                    value[c] = *field ? strtod(field, NULL) : (double)NAN;
                }
            }
        }
        if (s.n == room) {
            room = room ? 2 * room : 65536;
            reserve(&s, room);
        }
        put(&s, s.n, value[TIME], value[POSITION], value[FORCE]);
        s.n++;
    }
    fclose(file);
    return s;
}

/* A slow sine with a small fast one, which holds reversals of every size, and a friction that turns round with it:
 * nothing that an estimate should be judged by, enough to keep every part of the code busy. */
static series make_motion(long updates)
{
    const double h = (double)SAMPLE_TIME, wide = 2000.0 * (double)HOLD_PATH, narrow = 50.0 * (double)HOLD_PATH;
    const double slow = 3.0, fast = 40.0; /* rad/s */
    const double level = 10.0 * (double)MEASUREMENT_SD, reach = 100.0 * (double)HOLD_PATH;
    double friction = 0.0, last = 0.0;
    series s = {updates * SAMPLES + 1, NULL, NULL, NULL};
    reserve(&s, s.n);
    for (long k = 0; k < s.n; k++) {
        const double t = (double)k * h;
        const double q = wide * (1.0 - cos(slow * t)) + narrow * (1.0 - cos(fast * t));
        const double a = wide * slow * slow * cos(slow * t) + narrow * fast * fast * cos(fast * t);
        const double move = q - last;
        friction += (move - fabs(move) * friction / level) * level / reach;
        last = q;
        put(&s, k, t, q, (double)MASS * a + friction);
    }
    return s;
}

/* --- replay ---------------------------------------------------------------------------------------------------- */

static double now_us(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

void harness_update(machine *self, const machine_position *position, const machine_real *force, durations *spent)
{
    double start = 0.0, sampled = 0.0, fed = 0.0;
    if (spent) {
        start = now_us();
    }
    for (int k = 0; k < SAMPLES; k++) {
        (void)CALL(sample)(self, position[k], force[k]);
    }
    if (spent) {
        sampled = now_us();
    }
    (void)CALL(feedback)(self);
    if (spent) {
        fed = now_us();
    }
    CALL(prepare)(self); /* in a controller: by the slower task */
    if (spent) {
        spent->samples = sampled - start;
        spent->feedback = fed - sampled;
        spent->prepare = now_us() - fed;
    }
}

static void print_header(void)
{
    printf("time_s,friction_measured_" FORCE_UNIT ",friction_" FORCE_UNIT);
    for (int i = 1; i <= ELEMENTS; i++) {
        printf(",z_%d_" LENGTH_UNIT, i);
    }
    for (int i = 1; i <= PARAMETERS; i++) {
        printf(",parameter_%d", i);
    }
    for (int i = 1; i <= PARAMETERS; i++) {
        printf(",std_parameter_%d", i);
    }
    printf(",status,innovation_" FORCE_UNIT ",test_ratio,noise_scale\n");
}

static void print_estimate(const machine *self, double time)
{
    machine_estimate estimate;
    CALL(estimate)(self, &estimate);
    printf("%.17g,%.17g,%.17g", time, (double)estimate.friction_measured, (double)estimate.friction);
    for (int i = 0; i < ELEMENTS; i++) {
        printf(",%.17g", (double)estimate.deflection[i]);
    }
    for (int i = 0; i < PARAMETERS; i++) {
        printf(",%.17g", (double)estimate.parameter[i]);
    }
    for (int i = 0; i < PARAMETERS; i++) {
        printf(",%.17g", (double)estimate.deviation[i]);
    }
    printf(
        ",%d,%.17g,%.17g,%.17g\n", estimate.status, (double)estimate.innovation, (double)estimate.test_ratio,
        (double)estimate.noise_scale);
}

static void replay(const series *s, int is_timed)
{
    static machine axis;
    /* Through a pointer that the compiler may not see through, so that the call stays a call. */
    void (*volatile update)(machine *, const machine_position *, const machine_real *, durations *) = harness_update;
    CALL(init)(&axis);
    if (is_timed) {
        printf("samples_us,feedback_us,prepare_us\n");
    } else {
        print_header();
    }
    if (s->n > 0) { /* the first sample is the first node */
        (void)CALL(sample)(&axis, s->position[0], s->force[0]);
    }
    for (long k = 1; k + SAMPLES <= s->n; k += SAMPLES) {
        durations spent = {0.0, 0.0, 0.0};
        update(&axis, s->position + k, s->force + k, is_timed ? &spent : NULL);
        if (is_timed) {
            printf("%.3f,%.3f,%.3f\n", spent.samples, spent.feedback, spent.prepare);
        } else {
            print_estimate(&axis, s->time[k + SAMPLES - 1]);
        }
    }
}

/* --- self-test --------------------------------------------------------------------------------------------------- */

static int selftest(void)
{
#ifdef SGMS_SELFTEST
    const int update = CALL(selftest)();
    if (update == 0) {
        puts("selftest passed");
    } else {
        printf("selftest FAILED in update %d\n", update);
    }
    return update != 0;
#else
    fail("--selftest", "compiled without the package's self-test");
    return BAD_INPUT;
#endif
}

int main(int argc, char **argv)
{
    series s = {0, NULL, NULL, NULL};
    int is_timed = 0;
    for (int i = 1; i < argc; i++) {
        const char *value = i + 1 < argc ? argv[i + 1] : NULL;
        if (strcmp(argv[i], "--selftest") == 0) {
            return selftest();
        }
        if (strcmp(argv[i], "--time") == 0) {
            is_timed = 1;
        } else if (strcmp(argv[i], "--log") == 0 && value) {
            s = read_log(value);
            i++;
        } else if (strcmp(argv[i], "--motion") == 0 && value) {
            const long updates = strtol(value, NULL, 10);
            if (updates < 1 || updates > 10000000) {
                fail("--motion", "a number of updates from 1 to 10000000");
            }
            s = make_motion(updates);
            i++;
        } else {
            fail(argv[i], "not one of --log FILE, --motion UPDATES, --time, --selftest");
        }
    }
    if (s.n == 0) {
        fail("arguments", "--log FILE, --motion UPDATES or --selftest is needed");
    }
    replay(&s, is_timed);
    free(s.time);
    free(s.position);
    free(s.force);
    return 0;
}
