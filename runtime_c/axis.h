/* Simulated axis: a rigid mass with Maxwell-slip friction in a closed position loop.
 *
 * The plant that estimators and diagnoses are tried on. It runs on the host only and shares nothing with the
 * generated code: the friction laws, the effects and the integrator are written here a second time, from the
 * equations, so that an error on either side shows.
 *
 * All quantities are in SI units. A force that opposes the drive counts positive, as friction does:
 *
 *     mass * acceleration = drive force - friction - sum of the effects' forces
 */
#ifndef SGMS_MHE_AXIS_H
#define SGMS_MHE_AXIS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define AXIS_MAX_ELEMENTS 10
#define AXIS_MAX_EFFECTS 128
#define AXIS_MAX_EFFECT_PARAMETERS 11
#define AXIS_HISTORY 4096 /* substeps of drive force kept for a delayed measurement, or a delayed drive */
#define AXIS_MAX_SUBSTEPS 256

enum axis_law { AXIS_LAW_SGMS = 0, AXIS_LAW_MAXWELL_SLIP = 1 };

/* The axis follows its reference exactly, is controlled to follow it, or is driven by it: by a force, by a force that a
 * log holds (linear between samples), by the command of a drive (held between samples). */
enum axis_control {
    AXIS_CONTROL_PRESCRIBED = 0,
    AXIS_CONTROL_POSITION = 1,
    AXIS_CONTROL_FORCE = 2,
    AXIS_CONTROL_LOGGED = 3,
    AXIS_CONTROL_COMMAND = 4
};

/* Command of a drive: the voltage at its motor [V], or the goal of its position loop [m]. */
enum axis_drive { AXIS_DRIVE_VOLTAGE = 1, AXIS_DRIVE_POSITION_LOOP = 2 };

/* Every setting is a double, scalar or array, so that a caller can set each by name (axis_setting). */
#define AXIS_SETTINGS(SCALAR, ARRAY)                                                                                   \
    SCALAR(law)               /* enum axis_law */                                                                      \
    SCALAR(control)           /* enum axis_control */                                                                  \
    SCALAR(rate)              /* Hz, samples of reference, controller and log */                                       \
    SCALAR(substeps)          /* integration steps per sample, 1..AXIS_MAX_SUBSTEPS */                                 \
    SCALAR(elements)          /* n_z, 1..AXIS_MAX_ELEMENTS */                                                          \
    SCALAR(mass)              /* kg */                                                                                 \
    ARRAY(stiffness)          /* kappa_i, N/m */                                                                       \
    ARRAY(fraction)           /* nu_i, sums to 1 */                                                                    \
    ARRAY(micro_viscous)      /* sigma_i, N s/m */                                                                     \
    SCALAR(viscous)           /* sigma_v, N s/m */                                                                     \
    SCALAR(coulomb)           /* f_C, N */                                                                             \
    SCALAR(stribeck_ratio)    /* beta */                                                                               \
    SCALAR(stribeck_velocity) /* v_s, m/s */                                                                           \
    SCALAR(zeta)              /* smoothing of S-GMS */                                                                 \
    SCALAR(lambda)                                                                                                     \
    SCALAR(gamma)                                                                                                      \
    SCALAR(proportional_gain)        /* N/m */                                                                         \
    SCALAR(integral_gain)            /* N/(m s) */                                                                     \
    SCALAR(derivative_gain)          /* N s/m */                                                                       \
    SCALAR(derivative_filter)        /* Hz, first order */                                                             \
    SCALAR(velocity_feedforward)     /* 0..1, share of the reference's velocity in the derivative term */              \
    SCALAR(acceleration_feedforward) /* kg, force per reference acceleration */                                        \
    SCALAR(feedforward_lead)         /* s, how far ahead of the sample that acceleration is taken */                   \
    SCALAR(current_loop_lag)         /* s, first order from command to drive force; 0: none */                         \
    SCALAR(max_force)                /* N, limit of the command; 0: none */                                            \
    SCALAR(encoder_resolution)       /* m, 0: none */                                                                  \
    SCALAR(encoder_noise)            /* m, 1 sigma per sample, inside the loop */                                      \
    SCALAR(force_noise)              /* N, 1 sigma per sample, of the measured force */                                \
    SCALAR(drive)                    /* enum axis_drive */                                                             \
    SCALAR(torque_constant)          /* N/A, and V s/m of the back-EMF */                                              \
    SCALAR(resistance)               /* ohm */                                                                         \
    SCALAR(supply)                   /* V */                                                                           \
    SCALAR(loop_gain)                /* 1/m, share of the supply per error of position */                              \
    SCALAR(loop_start)               /* share of the supply beside that, towards the goal */                           \
    SCALAR(clamp)                    /* largest share of the supply; 0: no limit */                                    \
    SCALAR(command_delay)            /* s, until a command acts */                                                     \
    SCALAR(speed_limit)              /* m/s, of the goal behind which the loop goes; 0: none */

struct axis_settings {
#define AXIS_SCALAR(name) double name;
#define AXIS_ARRAY(name) double name[AXIS_MAX_ELEMENTS];
    AXIS_SETTINGS(AXIS_SCALAR, AXIS_ARRAY)
#undef AXIS_SCALAR
#undef AXIS_ARRAY
};

/* A force of the caller's own, friction-like in sign [N], at a position [m], a velocity [m/s] and a time [s]. */
typedef double axis_force(void *context, double position, double velocity, double time);

struct axis_effect {
    const struct axis_effect_row *row;
    double parameter[AXIS_MAX_EFFECT_PARAMETERS];
    double state[2];
    axis_force *force;
    void *context;
    const double *table; /* of the caller's, as long as the axis runs */
    size_t entries;
};

/* Columns to fill, one value per sample from the caller's arrays; a null pointer skips the column. */
struct axis_record {
    double *position_m; /* as the encoder reports it */
    double *force_N;    /* as the drive reports it */
    double *true_position_m;
    double *true_velocity_m_s;
    double *true_acceleration_m_s2;
    double *true_force_N;        /* acting on the mass */
    double *true_friction_N;     /* of the friction law */
    double *true_effect_force_N; /* sum of the effects' forces: mass a = force - friction - effects */
    double *true_deflection_m;   /* row-major (samples, elements) */
};

/* Adds a force to the controller's, from what the controller can measure: a friction observer under test. */
typedef double axis_compensation(void *context, double position_m, double force_N);

struct axis {
    struct axis_settings set;
    struct axis_effect effect[AXIS_MAX_EFFECTS];
    size_t effects;
    unsigned changed; /* quantities that any of them changes, a bit each (enum axis_quantity) */
    axis_compensation *compensation;
    void *compensation_context;
    const double *enabled; /* of the caller's, per sample: a drive that is off makes no force; null: always on */

    double position, velocity, acceleration;
    double force;        /* of the current loop, that acts: what it makes is in `history` */
    double force_before; /* at the start of the drift */
    double deflection[AXIS_MAX_ELEMENTS];
    double level;       /* s(v) with all factors, N, of the latest substep */
    double transmitted; /* what the drive delivers behind friction: inertial force and forces on the load, N */
    double inertial;    /* the inertial force in it, N */
    double integral;    /* of the position error, m s */
    double measured, derivative;
    double goal; /* behind the speed limit, at sample goal_at */
    size_t goal_at;
    uint64_t substep_count;
    double history[AXIS_HISTORY];
    struct axis_random {
        uint64_t word[4];
        double spare;
        int has_spare;
    } encoder_random, force_random;

    /* derived from the settings by axis_apply */
    int law, control, elements, substeps;
    double step, half_step, decay, filter;
    double inertia, moving_mass; /* all that moves, and without what hangs on a spring */
    double late;                 /* substeps that the force is logged after it acts; below zero: before */
    double slip_root, slip_rate; /* g(root) = 0, -g'(root) of the saturated S-GMS element */
    double elastic_limit;        /* |r| below which no S-GMS element slips */
};

size_t axis_size(void);

/* Name, place (in doubles) and count of the i-th setting; null past the last. */
const char *axis_setting(size_t i, size_t *offset, size_t *count);

/* Name of an effect; null past the last. Name of its j-th parameter; null past its last. */
const char *axis_effect_name(size_t kind);
const char *axis_effect_parameter(size_t kind, size_t j);

/* Whether an effect takes the list that is its last parameter whole, by axis_set_table; of other lists it takes one
 * entry, and there are as many effects. */
int axis_effect_has_table(size_t kind);

/* Clear everything and seed the noise. Settings start at zero: set them, then axis_apply. */
void axis_init(struct axis *axis, uint64_t seed);

void axis_set(struct axis *axis, size_t offset, double value);

/* Add an effect with its parameters in the table's order; its index, or -1 if there is no room or no such kind. */
int axis_add_effect(struct axis *axis, size_t kind, const double *parameter);

/* Add a force of the caller's own as an effect, evaluated at every substep; its index, or -1 if there is no room. */
int axis_add_force(struct axis *axis, axis_force *force, void *context);

void axis_set_effect(struct axis *axis, size_t effect, size_t j, double value);

/* Give an effect its table, which stays the caller's and is read at every substep. */
void axis_set_table(struct axis *axis, size_t effect, const double *table, size_t entries);

void axis_set_compensation(struct axis *axis, axis_compensation *compensation, void *context);

/* Say at which samples of its commands a drive is on: above 0.5. The array stays the caller's. */
void axis_enable(struct axis *axis, const double *enabled);

/* Force of the drive [N] at a time, in samples of its commands, and the present motion. */
double axis_drive_force(struct axis *axis, const double *command, size_t length, double sample);

/* Make changed settings effective, between runs as well. 0, or what is out of range. */
enum axis_refusal {
    AXIS_BAD_SETTING = -1,   /* rate, substeps or elements */
    AXIS_NO_MASS = -2,       /* nothing is left to move */
    AXIS_LONG_DELAY = -3,    /* more than AXIS_HISTORY - 2 substeps, or below zero under prescribed motion */
    AXIS_FAST_RESONANCE = -4 /* a hanging mass that the substeps do not resolve */
};
int axis_apply(struct axis *axis);

/* Put the axis at rest at a position. */
void axis_place(struct axis *axis, double position);

/* Let an axis that was placed start in motion, its elements deflected by so much [m], none beyond its level. Effects
 * start as at rest. */
void axis_move(struct axis *axis, double velocity, const double *deflection);

/* Let an axis that follows a motion go on from it by itself: from this position and velocity, its elements deflected
 * further by so much of their break-away, none by that beyond it. */
void axis_start(struct axis *axis, double position, double velocity, double strain);

/* Fill row `row` of the columns with the present state, without a step. 0 where the axis left the world. */
int axis_observe(struct axis *axis, const struct axis_record *record, size_t row);

/* Run `count` samples from sample `start` of a reference [m, N or V] of `length` samples; beyond its end it stands
 * still. The samples recorded: fewer than `count` where the loop is unstable and the axis left the world, whose bounds
 * are 4e6 m and 1e9 N. */
size_t axis_run(
    struct axis *axis,
    const double *reference,
    size_t length,
    size_t start,
    size_t count,
    const struct axis_record *record);

/* Let an axis that a logged force or a command drives follow a measured motion [m] through `count` samples from sample
 * `start`: all its states become those of the motion and of what drives it [N, m or V]. Records the acceleration that
 * the force would make of it before each sample, of the means over the sample that ends there. */
void axis_follow(
    struct axis *axis,
    const double *position,
    const double *driving,
    size_t length,
    size_t start,
    size_t count,
    double *acceleration);

#ifdef __cplusplus
}
#endif

#endif
