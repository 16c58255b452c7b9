/* Runs pairs of doubles (position [m], force [N]) of a file through two axes, one by tick() and one by sample(),
 * feedback() and the units of prepare(), and prints the most operations that a call took. Compiled with a package whose
 * number type is `counted`:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_SOURCE='"etel_xy.c"' -DHAS_UNITS=1 */
#include "counted.hpp"

#include SGMS_MACHINE_SOURCE

#include <cstdio>

#include "joined.h"

static CALL(t) by_tick, by_tasks;
static long most_tick, most_sample, most_feedback, most_unit, most_prepare, most_update;

static void keep(long *most, long count)
{
    *most = count > *most ? count : *most;
}

/* Units one by one, as prepare() does them. Returns their operations. */
static long prepare_units()
{
    long all = 0;
#if HAS_UNITS
    while (next_cost(&by_tasks) > 0) {
        counted_operations = 0;
        work(&by_tasks);
        keep(&most_unit, counted_operations);
        all += counted_operations;
    }
#endif
    return all;
}

int main(int argc, char **argv)
{
    FILE *const file = argc == 2 ? std::fopen(argv[1], "rb") : nullptr;
    double sample[2];
    long update = 0;
    if (!file) {
        return 2;
    }
    CALL(init)(&by_tick);
    CALL(init)(&by_tasks);
    CALL(compensate)(&by_tick, 1);
    CALL(compensate)(&by_tasks, 1);
    while (std::fread(sample, sizeof sample, 1, file) == 1) {
        const CALL(position) position = CALL(position_from_metres)(sample[0]);
        counted_operations = 0;
        (void)CALL(tick)(&by_tick, position, sample[1]);
        keep(&most_tick, counted_operations);
        counted_operations = 0;
        (void)CALL(sample)(&by_tasks, position, sample[1]);
        keep(&most_sample, counted_operations);
        update += counted_operations;
        if (CALL(due)(&by_tasks)) {
            long prepared;
            counted_operations = 0;
            (void)CALL(feedback)(&by_tasks);
            keep(&most_feedback, counted_operations);
            update += counted_operations;
            prepared = prepare_units();
            keep(&most_prepare, prepared);
            keep(&most_update, update + prepared);
            update = 0;
        }
    }
    std::fclose(file);
    std::printf("sample %ld\ntick %ld\nunit %ld\n", most_sample, most_tick, most_unit);
    std::printf("prepare %ld\nfeedback %ld\nupdate %ld\n", most_prepare, most_feedback, most_update);
    return 0;
}
