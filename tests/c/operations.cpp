/* Runs pairs of doubles (position [m], force [N]) of a file through three axes, one by tick() and two by feedback() and
 * the units of prepare(), one of them by sample(), the other by insert() with the velocity that no filter has smoothed,
 * and prints the most operations that a call took. What is known of parameters may always grow. Compiled with a package
 * whose number type is `counted`: -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_SOURCE='"etel_xy.c"' -DHAS_UNITS=1
 * -DHAS_DRIVE=0 */
#include "counted.hpp"

#include SGMS_MACHINE_SOURCE

#include <cstdio>
#include <initializer_list>

#include "joined.h"

static CALL(t) by_tick, by_tasks, by_signals;
static long most_tick, most_sample, most_feedback, most_unit, most_prepare, most_update;

static void keep(long *most, long count)
{
    *most = count > *most ? count : *most;
}

/* Units one by one, as prepare() does them. Returns their operations. */
static long prepare_units(CALL(t) * axis)
{
    long all = 0;
#if HAS_UNITS
    while (next_cost(axis) > 0) {
        counted_operations = 0;
        work(axis);
        keep(&most_unit, counted_operations);
        all += counted_operations;
    }
#endif
    return all;
}

#if HAS_DRIVE
static CALL(drive_t) drive;
static long most_command;

static CALL(position) command_of(const CALL(position) *, double x)
{
    return CALL(position_from_metres)(x);
}

static counted command_of(const counted *, double x)
{
    return x;
}

/* Both calls of a drive. */
static void command(CALL(position) position, double x)
{
    counted_operations = 0;
    (void)CALL(drive_command)(CALL(drive_force)(&drive, position, command_of(drive.sent, x), true));
    keep(&most_command, counted_operations);
}
#endif

/* What stands behind a sample: the update where it is due. `before` is what the interval has taken. */
static void finish(CALL(t) * axis, long *before)
{
    long prepared;
    keep(&most_sample, counted_operations);
    *before += counted_operations;
    if (!CALL(due)(axis)) {
        return;
    }
    counted_operations = 0;
    (void)CALL(feedback)(axis);
    keep(&most_feedback, counted_operations);
    *before += counted_operations;
    prepared = prepare_units(axis);
    keep(&most_prepare, prepared);
    keep(&most_update, *before + prepared);
    *before = 0;
}

int main(int argc, char **argv)
{
    FILE *const file = argc == 2 ? std::fopen(argv[1], "rb") : nullptr;
    double sample[2], last = 0.0;
    long by_tasks_update = 0, by_signals_update = 0;
    if (!file) {
        return 2;
    }
    for (CALL(t) *axis : {&by_tick, &by_tasks, &by_signals}) {
        CALL(init)(axis);
        CALL(compensate)(axis, 1);
        for (auto &prior : axis->settings.parameter) {
            prior *= 4;
        }
        axis->settings_sum = sum_of(&axis->settings);
    }
    while (std::fread(sample, sizeof sample, 1, file) == 1) {
        const CALL(position) position = CALL(position_from_metres)(sample[0]);
        const CALL(signals) signals = {sample[0], (sample[0] - last) * RATE, 0.0, sample[1], sample[1], 1, 0.0};
        counted_operations = 0;
        (void)CALL(tick)(&by_tick, position, sample[1]);
        keep(&most_tick, counted_operations);
        counted_operations = 0;
        (void)CALL(sample)(&by_tasks, position, sample[1]);
        finish(&by_tasks, &by_tasks_update);
        counted_operations = 0;
        (void)CALL(insert)(&by_signals, &signals);
        finish(&by_signals, &by_signals_update);
        last = sample[0];
#if HAS_DRIVE
        command(position, sample[1]);
#endif
    }
    std::fclose(file);
    std::printf("sample %ld\ntick %ld\nunit %ld\n", most_sample, most_tick, most_unit);
    std::printf("prepare %ld\nfeedback %ld\nupdate %ld\n", most_prepare, most_feedback, most_update);
#if HAS_DRIVE
    std::printf("command %ld\n", most_command);
#endif
    return 0;
}
