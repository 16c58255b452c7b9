/* What only flipped bits make of an axis's memory: indices and marks of calls beyond all that they are, variances and
 * errors that are not there. A call keeps within its memory all the same, and comes to the same bits everywhere. */
#ifndef DAMAGE_H
#define DAMAGE_H

#include "package.h"

/* Numbers of the memory that calls use as an index, a count or a mark. */
enum {
    FILLING,
    STEP,
    PHASE,
    VERSION,
    SETTINGS,
    CHI,
#if SPREADS
    VARIANCES,
    SQUARES,
    MEANS,
#endif
#if WINDOW
    CURSOR,
#endif
#if RESUMES
    BACK,
#endif
#if HAS_INNER
    ARRIVED,
    FOLDED,
#endif
#if HAS_CHOSEN
    SLOT,
#endif
    DAMAGES
};

#if SPREADS
/* Bits of numbers into the sum over those of lasting errors. */
static inline void sum_lasting(machine *axis, const machine_real *numbers, int count)
{
    for (int i = 0; i < count; i++) {
        union {
            machine_real x;
            uint32_t narrow;
            uint64_t wide;
        } const number = {numbers[i]};
        axis->lasting.sum *= 31u;
        axis->lasting.sum += sizeof(machine_real) == 4 ? number.narrow : number.wide;
    }
}

/* Lasting errors as an axis may have found them itself. */
static inline void seal_lasting(machine *axis)
{
    axis->lasting.sum = 0;
    sum_lasting(axis, &axis->lasting.squares, 1);
    sum_lasting(axis, &axis->lasting.information, 1);
    sum_lasting(axis, axis->lasting.theta, PARAMETERS);
    sum_lasting(axis, axis->lasting.variance, PARAMETERS);
    sum_lasting(axis, axis->lasting.moved, PARAMETERS);
    sum_lasting(axis, axis->lasting.taken, PARAMETERS);
}
#endif

/* Put a number in the place of one. */
static inline void damage(machine *axis, int which, int32_t value)
{
    switch (which) {
    case FILLING:
        axis->interval.filling = value;
        break;
    case STEP:
        axis->interval.step = value;
        break;
    case PHASE:
        axis->calls.phase = (uint32_t)value;
        break;
    case VERSION:
        axis->calls.version = (uint32_t)value;
        break;
    case SETTINGS:
        axis->settings.measurement *= (machine_real)value;
        break;
    case CHI: /* about the largest that may be */
        axis->interval.blocks[0] = (machine_real)value * IMPLAUSIBLE /
                                   (inverse_initial_state[0] * axis->parameters.scale[0]);
        break;
#if SPREADS
    case VARIANCES: /* at the end of a block */
        axis->lasting.intervals = LASTING_BLOCK - 1;
        for (int p = 0; p < PARAMETERS; p++) {
            axis->lasting.variance[p] = (machine_real)0;
        }
        seal_lasting(axis);
        break;
    case SQUARES:
        axis->lasting.squares = (machine_real)value * axis->lasting.information;
        seal_lasting(axis);
        break;
    case MEANS: /* told by their sum */
        axis->lasting.taken[0] += (machine_real)value;
        break;
#endif
#if WINDOW
    case CURSOR:
        axis->sweep.cursor = value;
        break;
#endif
#if RESUMES
    case BACK:
        axis->sweep.back = value;
        break;
#endif
#if HAS_INNER
    case ARRIVED:
        axis->inner.arrived = value;
        break;
    case FOLDED:
        axis->inner.folded = value;
        break;
#endif
#if HAS_CHOSEN
    case SLOT:
        axis->linearisation.slot = value;
        break;
#endif
    default:
        break;
    }
}

#endif
