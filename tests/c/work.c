/* Runs pairs of doubles (position [m], force [N]) of a file through tick() and prints, tick by tick, how many functions
 * of the package were entered: a measure of the work that is the same in every run. The package is compiled with
 * -finstrument-functions, this file without. Compiled with a package:
 *     -DSGMS_MACHINE=etel_xy -DSGMS_MACHINE_HEADER='"etel_xy.h"' */
#include <stdio.h>

#include SGMS_MACHINE_HEADER

#include "joined.h"

void __cyg_profile_func_enter(void *function, void *site);
void __cyg_profile_func_exit(void *function, void *site);

static CALL(t) axis;
static long entered;

void __cyg_profile_func_enter(void *function, void *site)
{
    (void)function;
    (void)site;
    entered++;
}

void __cyg_profile_func_exit(void *function, void *site)
{
    (void)function;
    (void)site;
}

int main(int argc, char **argv)
{
    FILE *const file = argc == 2 ? fopen(argv[1], "rb") : NULL;
    double sample[2];
    if (!file) {
        return 2;
    }
    CALL(init)(&axis);
    CALL(compensate)(&axis, 1);
    while (fread(sample, sizeof sample, 1, file) == 1) {
        entered = 0;
        (void)CALL(tick)(&axis, CALL(position_from_metres)(sample[0]), (CALL(real))sample[1]);
        printf("%ld\n", entered);
    }
    fclose(file);
    return 0;
}
