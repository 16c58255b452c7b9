/* The model of one package alone, along a measured motion, on a host. Compiled with a package's headers:
 *     -DSGMS_INTEGRATOR_HEADER='"etel_xy_integrator.h"' -DSGMS_MACHINE=etel_xy */
#ifndef SGMS_PREDICT_H
#define SGMS_PREDICT_H

/* Friction force [N] at the last of every `every` samples and its derivatives in theta (as many x parameters), each
 * unless NULL.
 *
 * signals: samples x 5, position, velocity, acceleration, force, time; theta: scaled parameters; x: node state at the
 * first sample, on return at the last one; d_x: its derivatives in theta (states x parameters), likewise; zeros to
 * start. A long record can be run in pieces, the first row of each being the last row of the piece before. A package
 * that merges samples knows the state at the ends of its steps alone: there `force` must be NULL and samples - 1 a
 * number of whole steps, or -1 is returned, else 0. numbers: SGMS_NUMBERS of them, where the headers name them so.
 *
 * With -DSGMS_STATES `force` takes the states (as many x states), and `d_force` the derivatives of each in the
 * parameters that enter it (as many x states x ENTERED). */
int sgms_predict(
    long samples,
    long every,
    const double *signals,
    const double *theta,
    double *x,
    double *d_x,
    double *force,
    double *d_force,
    const double *numbers);

#endif
