#include "loop.h"

#include "replay.h"

#include SGMS_MACHINE_HEADER

#define SGMS_JOIN2(a, b) a##_##b
#define SGMS_JOIN(a, b) SGMS_JOIN2(a, b)
#define CALL(name) SGMS_JOIN(SGMS_MACHINE, name)

double sgms_loop_compensate(void *context, double position, double force)
{
    sgms_loop *loop = context;
    const long k = loop->sample < loop->samples ? loop->sample++ : loop->samples - 1;
    if (loop->memory) {
        const sgms_series now = {.samples = 1, .position = &position, .force = &force};
        if (loop->velocity) {
            CALL(ahead)(loop->memory, (CALL(real))loop->velocity[k], (CALL(real))loop->acceleration[k]);
        }
        loop->updates += sgms_replay_run(
            loop->memory, &now, SGMS_REPLAY_TICK, loop->rows + loop->updates * sgms_replay_columns(),
            loop->statuses + loop->updates, loop->force + k);
    }
    return loop->force[k];
}
