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
#if SPREADS
    VARIANCES,
    SQUARES,
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
#if SPREADS
    case VARIANCES: /* at the end of a block */
        axis->lasting.intervals = LASTING_BLOCK - 1;
        for (int p = 0; p < PARAMETERS; p++) {
            axis->lasting.variance[p] = (machine_real)0;
        }
        break;
    case SQUARES:
        axis->lasting.squares = (machine_real)value * axis->lasting.information;
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
