/* Simulated axis: see axis.h.
 *
 * Integration. Leapfrog (kick, drift, kick) with `substeps` steps per sample, second order. In a drift the velocity is
 * constant, so every friction element sees an exact displacement and its equation is solved on its own: by clipping
 * (Maxwell-slip) or in steps that are bounded in displacement (S-GMS), at any speed.
 */
#include "axis.h"

#include <math.h>
#include <string.h>

#define TWO_PI 6.283185307179586
#define SETTLED 3e-5  /* distance in r at which the linear equation is good to 1e-8 */
#define AT_REST 1e-12 /* dr/dxi of an element that moves no more */
#define FARTHEST 4e6  /* m; no axis is there: the loop is unstable */
#define STRONGEST 1e9 /* N, likewise */
#define RESONANT 0.5  /* omega times step of a hanging mass, at most: its frequency is then right to 1 % */

/* ---- tables ------------------------------------------------------------------------------------------------- */

enum effect_kind {
    CONSTANT_OFFSET,
    FORCE_RIPPLE,
    FORCE_CONSTANT_RIPPLE,
    POSITION_SPRING,
    HOSE_HYSTERESIS,
    ASYMMETRIC_COULOMB,
    ASYMMETRIC_VISCOUS,
    POSITION_DEPENDENT_FRICTION,
    FRICTION_DRIFT,
    VISCOUS_DRIFT,
    MASS_MISMATCH,
    FORCE_GAIN,
    FORCE_DELAY,
    ACTUATOR_LAG,
    QUADRATIC_DRAG,
    EDDY_CURRENT_DAMPING,
    ENCODER_PERIODIC_ERROR,
    STRUCTURAL_RESONANCE,
    PERIODIC_DISTURBANCE,
    STEP_DISTURBANCE,
    BACKLASH,
    FRICTIONAL_LAG,
    DWELL_DEPENDENCE,
    MICRO_VISCOUS,
    UNBALANCE,
    LOAD_DEPENDENT_FRICTION,
    DRIVE_EFFICIENCY,
    POSITION_MAP,
    EFFECT_KINDS
};

static const struct {
    const char *name;
    const char *parameter[AXIS_MAX_EFFECT_PARAMETERS];
} effect_table[EFFECT_KINDS] = {
    /* force = force_N */
    [CONSTANT_OFFSET] = {"constant_offset", {"force_N"}},
    /* force = amplitude sin(2 pi q / pitch + phase) */
    [FORCE_RIPPLE] = {"force_ripple", {"amplitude_N", "pitch_m", "phase_rad"}},
    /* force on the mass = logged force (1 + ratio sin(2 pi q / pitch + phase)) */
    [FORCE_CONSTANT_RIPPLE] = {"force_constant_ripple", {"ratio", "pitch_m", "phase_rad"}},
    /* force = stiffness (q - centre) */
    [POSITION_SPRING] = {"position_spring", {"stiffness_N_m", "centre_m"}},
    /* Dahl: dF/dq = stiffness (1 - F sign(v) / force_N) */
    [HOSE_HYSTERESIS] = {"hose_hysteresis", {"stiffness_N_m", "force_N"}},
    /* s(v) (1 + ratio sign(v)) */
    [ASYMMETRIC_COULOMB] = {"asymmetric_coulomb", {"ratio"}},
    /* sigma_v + difference sign(v) */
    [ASYMMETRIC_VISCOUS] = {"asymmetric_viscous", {"difference_N_s_m"}},
    /* s(v) (1 + ratio sin(2 pi q / pitch + phase)) */
    [POSITION_DEPENDENT_FRICTION] = {"position_dependent_friction", {"ratio", "pitch_m", "phase_rad"}},
    /* s(v) (1 + ratio (1 - exp(-t / time_constant))) */
    [FRICTION_DRIFT] = {"friction_drift", {"ratio", "time_constant_s"}},
    /* sigma_v (1 + ratio (1 - exp(-t / time_constant))) */
    [VISCOUS_DRIFT] = {"viscous_drift", {"ratio", "time_constant_s"}},
    /* true mass = mass + mass_kg */
    [MASS_MISMATCH] = {"mass_mismatch", {"mass_kg"}},
    /* logged force = gain times the force on the mass */
    [FORCE_GAIN] = {"force_gain", {"gain"}},
    /* logged force = force on the mass, delay_s ago; below zero: force on the mass = logged force, -delay_s ago */
    [FORCE_DELAY] = {"force_delay", {"delay_s"}},
    /* force on the mass follows the logged one with a first-order lag */
    [ACTUATOR_LAG] = {"actuator_lag", {"time_constant_s"}},
    /* force = coefficient v |v| */
    [QUADRATIC_DRAG] = {"quadratic_drag", {"coefficient_N_s2_m2"}},
    /* force = damping v / (1 + (v / corner)^2) */
    [EDDY_CURRENT_DAMPING] = {"eddy_current_damping", {"damping_N_s_m", "corner_velocity_m_s"}},
    /* encoder reads q + amplitude sin(2 pi q / pitch + phase) */
    [ENCODER_PERIODIC_ERROR] = {"encoder_periodic_error", {"amplitude_m", "pitch_m", "phase_rad"}},
    /* `mass_kg` of the mass hangs on a spring; frequency is its own, with the rest held */
    [STRUCTURAL_RESONANCE] = {"structural_resonance", {"frequency_Hz", "damping_ratio", "mass_kg"}},
    /* force = amplitude sin(2 pi frequency t + phase) */
    [PERIODIC_DISTURBANCE] = {"periodic_disturbance", {"amplitude_N", "frequency_Hz", "phase_rad"}},
    /* force = force_N from time_s on */
    [STEP_DISTURBANCE] = {"step_disturbance", {"force_N", "time_s"}},
    /* friction acts behind a gap: no friction while the mass crosses it */
    [BACKLASH] = {"backlash", {"gap_m"}},
    /* s follows s(v) with a first-order lag */
    [FRICTIONAL_LAG] = {"frictional_lag", {"time_constant_s"}},
    /* s(v) (1 + ratio d), dd/dt = (1 - d) / time_constant - |v| d / length: ages at rest, renewed by motion */
    [DWELL_DEPENDENCE] = {"dwell_dependence", {"ratio", "time_constant_s", "length_m"}},
    /* sigma_i + nu_i damping */
    [MICRO_VISCOUS] = {"micro_viscous", {"damping_N_s_m"}},
    /* force = amplitude sin(q + phase), q an angle */
    [UNBALANCE] = {"unbalance", {"amplitude_N", "phase_rad"}},
    /* s(v) + ratio |T|, T: what the drive transmits */
    [LOAD_DEPENDENT_FRICTION] = {"load_dependent_friction", {"ratio"}},
    /* s(v) + |T| (1 / efficiency - 1) where T drives the motion, s(v) + |T| (1 - efficiency) where it brakes it */
    [DRIVE_EFFICIENCY] = {"drive_efficiency", {"efficiency_ratio"}},
    /* force = sum over its sines of sine sin(2 pi order q / pitch) + cosine cos(...); one effect of the plant each */
    [POSITION_MAP] = {"position_map", {"pitch_m", "order", "sine_N", "cosine_N"}},
};

static const struct {
    const char *name;
    size_t offset, count;
} setting_table[] = {
#define AXIS_SCALAR(name) {#name, offsetof(struct axis_settings, name) / sizeof(double), 1},
#define AXIS_ARRAY(name) {#name, offsetof(struct axis_settings, name) / sizeof(double), AXIS_MAX_ELEMENTS},
    AXIS_SETTINGS(AXIS_SCALAR, AXIS_ARRAY)
#undef AXIS_SCALAR
#undef AXIS_ARRAY
};

size_t axis_size(void)
{
    return sizeof(struct axis);
}

const char *axis_setting(size_t i, size_t *offset, size_t *count)
{
    if (i >= sizeof setting_table / sizeof setting_table[0]) {
        return NULL;
    }
    *offset = setting_table[i].offset;
    *count = setting_table[i].count;
    return setting_table[i].name;
}

const char *axis_effect_name(size_t kind)
{
    return kind < EFFECT_KINDS ? effect_table[kind].name : NULL;
}

const char *axis_effect_parameter(size_t kind, size_t j)
{
    return kind < EFFECT_KINDS && j < AXIS_MAX_EFFECT_PARAMETERS ? effect_table[kind].parameter[j] : NULL;
}

/* ---- noise: xoshiro256** and the polar method --------------------------------------------------------------- */

static uint64_t rotate(uint64_t x, unsigned k)
{
    return (x << k) | (x >> (64u - k));
}

static void random_seed(struct axis_random *random, uint64_t seed)
{
    for (size_t i = 0; i < 4; ++i) { /* splitmix64 */
        seed += UINT64_C(0x9e3779b97f4a7c15);
        uint64_t z = seed;
        z = (z ^ (z >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
        z = (z ^ (z >> 27)) * UINT64_C(0x94d049bb133111eb);
        random->word[i] = z ^ (z >> 31);
    }
    random->has_spare = 0;
}

static double random_uniform(struct axis_random *random) /* (-1, 1) */
{
    uint64_t *s = random->word;
    const uint64_t result = rotate(s[1] * 5u, 7) * 9u, t = s[1] << 17;
    s[2] ^= s[0];
    s[3] ^= s[1];
    s[1] ^= s[2];
    s[0] ^= s[3];
    s[2] ^= t;
    s[3] = rotate(s[3], 45);
    return (double)(result >> 11) * 0x1p-52 - 1.0;
}

static double random_normal(struct axis_random *random)
{
    double x, y, square;
    if (random->has_spare) {
        random->has_spare = 0;
        return random->spare;
    }
    do {
        x = random_uniform(random);
        y = random_uniform(random);
        square = x * x + y * y;
    } while (square >= 1.0 || square == 0.0);
    const double factor = sqrt(-2.0 * log(square) / square);
    random->spare = y * factor;
    random->has_spare = 1;
    return x * factor;
}

/* ---- S-GMS element ------------------------------------------------------------------------------------------ */

static double logistic(double x)
{
    /* beyond 40 the rest is less than a unit in the last place */
    if (x > 40.0) {
        return 1.0;
    }
    if (x < -40.0) {
        return 0.0;
    }
    return 1.0 / (1.0 + exp(-x));
}

/* etaA of equation (3): the difference of two tanh is the sum of two logistics. */
static double window(const struct axis *axis, double r)
{
    const double slope = 2.0 * axis->set.lambda;
    return logistic(slope * (r - axis->set.zeta)) + logistic(-slope * (r + axis->set.zeta));
}

/* dr/dxi = 1 - etaA etaB r of an element with r signed along the motion, xi = |v| t / zs, gate = 2 gamma |v| / v_s. */
static double slip(const struct axis *axis, double r, double gate)
{
    return 1.0 - window(axis, r) * logistic(gate * r) * r;
}

/* Where the element of saturated gate settles and how fast: g(root) = 0, rate = -g'(root). */
static void find_slip_root(struct axis *axis)
{
    double low = 0.0, high = 1.0;
    while (slip(axis, high, HUGE_VAL) > 0.0 && high < 1e6) {
        high *= 2.0;
    }
    for (int i = 0; i < 100; ++i) {
        const double middle = 0.5 * (low + high);
        if (slip(axis, middle, HUGE_VAL) > 0.0) {
            low = middle;
        } else {
            high = middle;
        }
    }
    const double root = 0.5 * (low + high), d = 1e-5;
    axis->slip_root = root;
    axis->slip_rate = (slip(axis, root - d, HUGE_VAL) - slip(axis, root + d, HUGE_VAL)) / (2.0 * d);
}

/* Move an element by xi > 0 deflections in the direction of r's sign convention. */
static double sgms_move(const struct axis *axis, double r, double xi, double gate)
{
    const double limit = axis->elastic_limit;

    /* Elastic as long as it is unloaded through a closed gate or within the window. */
    if (r < limit && (r > -limit || gate * limit > 34.0)) {
        const double room = limit - r;
        if (xi <= room) {
            return r + xi;
        }
        r += room;
        xi -= room;
    }
    const double edge = axis->set.zeta + 2.5 / axis->set.lambda;
    while (xi > 0.0) {
        const int open = gate * r > 40.0;
        if (open && fabs(r - axis->slip_root) < SETTLED) {
            return axis->slip_root + (r - axis->slip_root) * exp(-axis->slip_rate * xi);
        }
        /* RK4 with steps that resolve the window, whose width in r goes with 1 / lambda; slower beyond its edge. */
        const double step = r > edge ? (open ? 0.15 : 0.05) : 0.4 / axis->set.lambda;
        const double h = step < xi ? step : xi;
        const double k1 = slip(axis, r, gate);
        if (!(fabs(k1) > AT_REST)) {
            return r; /* in balance with its gate, or not a number: however long the rest of the way, it stays */
        }
        const double k2 = slip(axis, r + 0.5 * h * k1, gate);
        const double k3 = slip(axis, r + 0.5 * h * k2, gate);
        const double k4 = slip(axis, r + h * k3, gate);
        r += h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4);
        xi -= h;
    }
    return r;
}

/* ---- effects ------------------------------------------------------------------------------------------------ */

static double sign(double x)
{
    return (double)((x > 0.0) - (x < 0.0));
}

static double periodic(double amplitude, double x, double period, double phase)
{
    return amplitude * sin(TWO_PI * (x / period) + phase);
}

static double now(const struct axis *axis)
{
    return (double)axis->substep_count * axis->step;
}

static double settled(double t, double time_constant)
{
    return 1.0 - exp(-t / time_constant);
}

/* Factor on s(v). */
static double level_factor(const struct axis *axis, double v, double position)
{
    double factor = 1.0;
    for (size_t i = 0; i < axis->effects; ++i) {
        const struct axis_effect *effect = &axis->effect[i];
        const double *p = effect->parameter;
        switch (effect->kind) {
        case ASYMMETRIC_COULOMB:
            factor *= 1.0 + p[0] * sign(v);
            break;
        case POSITION_DEPENDENT_FRICTION:
            factor *= 1.0 + periodic(p[0], position, p[1], p[2]);
            break;
        case FRICTION_DRIFT:
            factor *= 1.0 + p[0] * settled(now(axis), p[1]);
            break;
        case DWELL_DEPENDENCE:
            factor *= 1.0 + p[0] * effect->state[0];
            break;
        default:
            break;
        }
    }
    return factor;
}

/* What the torque transmitted adds to the level, N. */
static double load_level(const struct axis *axis, double v)
{
    double level = 0.0;
    for (size_t i = 0; i < axis->effects; ++i) {
        const double *p = axis->effect[i].parameter;
        switch (axis->effect[i].kind) {
        case LOAD_DEPENDENT_FRICTION:
            level += p[0] * fabs(axis->transmitted);
            break;
        case DRIVE_EFFICIENCY:
            level += fabs(axis->transmitted) * (axis->transmitted * v > 0.0 ? 1.0 / p[0] - 1.0 : 1.0 - p[0]);
            break;
        default:
            break;
        }
    }
    return level;
}

/* Viscous coefficient sigma_v. */
static double viscous(const struct axis *axis, double v)
{
    double result = axis->set.viscous;
    for (size_t i = 0; i < axis->effects; ++i) {
        const double *p = axis->effect[i].parameter;
        switch (axis->effect[i].kind) {
        case VISCOUS_DRIFT:
            result += axis->set.viscous * p[0] * settled(now(axis), p[1]);
            break;
        case ASYMMETRIC_VISCOUS:
            result += p[0] * sign(v);
            break;
        default:
            break;
        }
    }
    return result;
}

/* Micro-viscous coefficient sigma_i. */
static double micro_viscous(const struct axis *axis, int element)
{
    double result = axis->set.micro_viscous[element];
    for (size_t i = 0; i < axis->effects; ++i) {
        if (axis->effect[i].kind == MICRO_VISCOUS) {
            result += axis->effect[i].parameter[0] * axis->set.fraction[element];
        }
    }
    return result;
}

/* Forces on the load from outside: what a drive transmits beside the inertial force. */
static double outside_force(const struct axis *axis)
{
    double force = 0.0;
    for (size_t i = 0; i < axis->effects; ++i) {
        const double *p = axis->effect[i].parameter;
        switch (axis->effect[i].kind) {
        case CONSTANT_OFFSET:
            force += p[0];
            break;
        case POSITION_SPRING:
            force += p[0] * (axis->position - p[1]);
            break;
        case PERIODIC_DISTURBANCE:
            force += p[0] * sin(TWO_PI * p[1] * now(axis) + p[2]);
            break;
        case STEP_DISTURBANCE:
            force += now(axis) >= p[1] ? p[0] : 0.0;
            break;
        case UNBALANCE:
            force += p[0] * sin(axis->position + p[1]);
            break;
        default:
            break;
        }
    }
    return force;
}

/* Sum of the effects' forces, friction-like in sign. */
static double effect_force(const struct axis *axis, double v)
{
    double force = outside_force(axis);
    for (size_t i = 0; i < axis->effects; ++i) {
        const struct axis_effect *effect = &axis->effect[i];
        const double *p = effect->parameter;
        switch (effect->kind) {
        case FORCE_RIPPLE:
            force += periodic(p[0], axis->position, p[1], p[2]);
            break;
        case POSITION_MAP: {
            const double turns = p[1] * fmod(axis->position, p[0]) / p[0];
            force += p[2] * sin(TWO_PI * turns) + p[3] * cos(TWO_PI * turns);
            break;
        }
        case HOSE_HYSTERESIS:
            force += effect->state[0];
            break;
        case QUADRATIC_DRAG:
            force += p[0] * v * fabs(v);
            break;
        case EDDY_CURRENT_DAMPING:
            force += p[0] * v / (1.0 + (v / p[1]) * (v / p[1]));
            break;
        case STRUCTURAL_RESONANCE: {
            const double omega = TWO_PI * p[0];
            force += p[2] * omega * (omega * (axis->position - effect->state[0]) + 2.0 * p[1] * (v - effect->state[1]));
            break;
        }
        case EFFECT_KINDS:
            force += effect->force(effect->context, axis->position, v, now(axis));
            break;
        default:
            break;
        }
    }
    return force;
}

/* Force on the mass per force that the current loop makes, as it depends on position. */
static double force_constant(const struct axis *axis)
{
    double factor = 1.0;
    for (size_t i = 0; i < axis->effects; ++i) {
        const double *p = axis->effect[i].parameter;
        if (axis->effect[i].kind == FORCE_CONSTANT_RIPPLE) {
            factor *= 1.0 + periodic(p[0], axis->position, p[1], p[2]);
        }
    }
    return factor;
}

/* Force on the mass for the force that the current loop makes. */
static double drive_force(const struct axis *axis)
{
    double force = axis->force;
    for (size_t i = 0; i < axis->effects; ++i) {
        if (axis->effect[i].kind == ACTUATOR_LAG) {
            force = axis->effect[i].state[0];
        }
    }
    return force * force_constant(axis);
}

/* Advance the effects' own states through a drift at constant velocity. */
static void move_effects(struct axis *axis, double v, double force_before)
{
    const double h = axis->step;
    for (size_t i = 0; i < axis->effects; ++i) {
        struct axis_effect *effect = &axis->effect[i];
        const double *p = effect->parameter;
        double *x = effect->state;
        switch (effect->kind) {
        case HOSE_HYSTERESIS: {
            const double end = p[1] * sign(v);
            x[0] = end + (x[0] - end) * exp(-p[0] * fabs(v) * h / p[1]);
            break;
        }
        case ACTUATOR_LAG: {
            const double mean = 0.5 * (force_before + axis->force);
            x[0] = mean + (x[0] - mean) * exp(-h / p[0]);
            break;
        }
        case DWELL_DEPENDENCE: {
            const double rate = 1.0 / p[1] + fabs(v) / p[2];
            x[0] += (1.0 / (p[1] * rate) - x[0]) * (1.0 - exp(-rate * h));
            break;
        }
        default:
            break;
        }
    }
}

/* Leapfrog of the hanging masses: half a kick, and the drift. */
static void kick_hanging(struct axis *axis, double v)
{
    for (size_t i = 0; i < axis->effects; ++i) {
        struct axis_effect *effect = &axis->effect[i];
        if (effect->kind != STRUCTURAL_RESONANCE) {
            continue;
        }
        const double omega = TWO_PI * effect->parameter[0], c = 2.0 * effect->parameter[1] * omega * axis->half_step;
        const double pull = omega * omega * (axis->position - effect->state[0]) * axis->half_step;
        effect->state[1] = (effect->state[1] + pull + c * v) / (1.0 + c);
    }
}

static void drift_hanging(struct axis *axis)
{
    for (size_t i = 0; i < axis->effects; ++i) {
        if (axis->effect[i].kind == STRUCTURAL_RESONANCE) {
            axis->effect[i].state[0] += axis->step * axis->effect[i].state[1];
        }
    }
}

/* ---- friction ----------------------------------------------------------------------------------------------- */

static double stribeck(const struct axis *axis, double v)
{
    const double ratio = v / axis->set.stribeck_velocity, square = ratio * ratio;
    const double rise = square < 40.0 ? exp(-square) : 0.0;
    return axis->set.coulomb * (1.0 + axis->set.stribeck_ratio * rise);
}

/* Let the torque transmitted follow that of the present acceleration, halfway in a substep. The level sets the
 * acceleration and the torque sets the level: taken whole, a step would overshoot where a loss is near the torque. */
static void move_transmitted(struct axis *axis)
{
    double inertia = axis->set.mass;
    for (size_t i = 0; i < axis->effects; ++i) {
        if (axis->effect[i].kind == MASS_MISMATCH) {
            inertia += axis->effect[i].parameter[0];
        }
    }
    axis->transmitted += 0.5 * (inertia * axis->acceleration + outside_force(axis) - axis->transmitted);
}

/* Move s(v) with its factors through a drift at mean velocity v, which ends at velocity `end`. A smoothed element sees
 * the level in the middle; one that slips by the switching law ends at the last. A frictional lag keeps s as a state.
 */
static void move_level(struct axis *axis, double v, double end)
{
    const int at_end = axis->law == AXIS_LAW_MAXWELL_SLIP;
    const double velocity = at_end ? end : v;
    double level = stribeck(axis, velocity);
    for (size_t i = 0; i < axis->effects; ++i) {
        struct axis_effect *effect = &axis->effect[i];
        if (effect->kind == FRICTIONAL_LAG) {
            effect->state[0] = level + (effect->state[0] - level) * exp(-axis->step / effect->parameter[0]);
            level = effect->state[0];
        }
    }
    const double position = at_end ? axis->position : axis->position - axis->half_step * v;
    /* the direction is that of the drift, which moves the elements */
    axis->level = level * level_factor(axis, v, position) + load_level(axis, v);
}

/* Whether friction is in contact with the mass, and the crossing of the gap (state: side -1, 0, 1; where it left). */
static struct axis_effect *find_backlash(struct axis *axis)
{
    for (size_t i = 0; i < axis->effects; ++i) {
        if (axis->effect[i].kind == BACKLASH) {
            return &axis->effect[i];
        }
    }
    return NULL;
}

static double spring_force(const struct axis *axis)
{
    double force = 0.0;
    for (int i = 0; i < axis->elements; ++i) {
        force += axis->set.stiffness[i] * axis->deflection[i];
    }
    return force;
}

/* Share of the displacement in a drift that moves the friction elements: all but what crosses the gap. */
static double engaged_velocity(struct axis *axis, double v)
{
    struct axis_effect *gap = find_backlash(axis);
    if (gap == NULL) {
        return v;
    }
    double *side = &gap->state[0], *contact = &gap->state[1]; /* contact: position at which the + side touches */
    const double from = axis->position - axis->step * v, to = axis->position;
    if (*side > 0.0 && v < 0.0 && spring_force(axis) <= 0.0) {
        *side = 0.0;
        *contact = from;
    } else if (*side < 0.0 && v > 0.0 && spring_force(axis) >= 0.0) {
        *side = 0.0;
        *contact = from + gap->parameter[0];
    }
    if (*side == 0.0) {
        double path = 0.0;
        if (to > *contact) {
            *side = 1.0;
            path = to - *contact;
        } else if (to < *contact - gap->parameter[0]) {
            *side = -1.0;
            path = to - (*contact - gap->parameter[0]);
        }
        return path / axis->step;
    }
    return v;
}

/* dz/dt of an element at velocity v: for the micro-viscous force. */
static double deflection_rate(const struct axis *axis, int i, double v)
{
    const double scale = axis->set.fraction[i] * axis->level / axis->set.stiffness[i];
    const double r = axis->deflection[i] / scale * sign(v);
    if (axis->law == AXIS_LAW_MAXWELL_SLIP) {
        return r < 1.0 ? v : 0.0;
    }
    return v * slip(axis, r, 2.0 * axis->set.gamma * fabs(v) / axis->set.stribeck_velocity);
}

/* Move the elements through a drift at constant velocity. */
static void move_elements(struct axis *axis, double v)
{
    const struct axis_settings *set = &axis->set;
    const double path = v * axis->step, direction = sign(v);
    const double gate = 2.0 * set->gamma * fabs(v) / set->stribeck_velocity;

    for (int i = 0; i < axis->elements; ++i) {
        const double scale = set->fraction[i] * axis->level / set->stiffness[i];
        double *z = &axis->deflection[i];
        if (axis->law == AXIS_LAW_MAXWELL_SLIP) {
            /* Along the motion an element that a falling level leaves behind slips back to it; against it it sticks,
               whatever the level of the new direction is. */
            *z += path;
            if (path > 0.0 && *z > scale) {
                *z = scale;
            }
            if (path < 0.0 && *z < -scale) {
                *z = -scale;
            }
        } else if (path != 0.0) {
            *z = direction * scale * sgms_move(axis, direction * *z / scale, fabs(path) / scale, gate);
        }
    }
}

/* y_f of equation (2). */
static double friction_force(struct axis *axis, double v)
{
    const struct axis_effect *gap = find_backlash(axis);
    if (gap != NULL && gap->state[0] == 0.0) {
        return 0.0;
    }
    double force = spring_force(axis) + viscous(axis, v) * v;
    for (int i = 0; i < axis->elements; ++i) {
        const double sigma = micro_viscous(axis, i);
        if (sigma != 0.0) {
            force += sigma * deflection_rate(axis, i, v);
        }
    }
    return force;
}

/* ---- settings ----------------------------------------------------------------------------------------------- */

void axis_init(struct axis *axis, uint64_t seed)
{
    memset(axis, 0, sizeof *axis);
    random_seed(&axis->encoder_random, seed);
    random_seed(&axis->force_random, seed ^ UINT64_C(0x5851f42d4c957f2d));
}

void axis_set(struct axis *axis, size_t offset, double value)
{
    if (offset < sizeof axis->set / sizeof(double)) {
        memcpy((char *)&axis->set + offset * sizeof value, &value, sizeof value);
    }
}

int axis_add_effect(struct axis *axis, size_t kind, const double *parameter)
{
    if (kind >= EFFECT_KINDS || axis->effects >= AXIS_MAX_EFFECTS) {
        return -1;
    }
    struct axis_effect *effect = &axis->effect[axis->effects];
    effect->kind = (int)kind;
    for (size_t j = 0; j < AXIS_MAX_EFFECT_PARAMETERS && effect_table[kind].parameter[j] != NULL; ++j) {
        effect->parameter[j] = parameter[j];
    }
    return (int)axis->effects++;
}

int axis_add_force(struct axis *axis, axis_force *force, void *context)
{
    if (axis->effects >= AXIS_MAX_EFFECTS) {
        return -1;
    }
    axis->effect[axis->effects] = (struct axis_effect){.kind = EFFECT_KINDS, .force = force, .context = context};
    return (int)axis->effects++;
}

void axis_set_effect(struct axis *axis, size_t effect, size_t j, double value)
{
    if (effect < axis->effects && j < AXIS_MAX_EFFECT_PARAMETERS) {
        axis->effect[effect].parameter[j] = value;
    }
}

void axis_set_compensation(struct axis *axis, axis_compensation *compensation, void *context)
{
    axis->compensation = compensation;
    axis->compensation_context = context;
}

static double delay_of(const struct axis *axis)
{
    double delay = 0.0;
    for (size_t i = 0; i < axis->effects; ++i) {
        if (axis->effect[i].kind == FORCE_DELAY) {
            delay += axis->effect[i].parameter[0];
        }
    }
    return delay;
}

int axis_apply(struct axis *axis)
{
    const struct axis_settings *set = &axis->set;
    if (!(set->rate > 0.0) || !(set->substeps >= 1.0) || set->substeps > AXIS_MAX_SUBSTEPS) {
        return AXIS_BAD_SETTING;
    }
    if (!(set->elements >= 1.0) || set->elements > AXIS_MAX_ELEMENTS) {
        return AXIS_BAD_SETTING;
    }

    axis->law = (int)set->law;
    axis->control = (int)set->control;
    axis->elements = (int)set->elements;
    axis->substeps = (int)set->substeps;
    axis->step = 1.0 / (set->rate * set->substeps);
    axis->half_step = 0.5 * axis->step;
    axis->decay = set->current_loop_lag > 0.0 ? exp(-axis->step / set->current_loop_lag) : 0.0;
    axis->filter = set->derivative_filter > 0.0 ? 1.0 - exp(-TWO_PI * set->derivative_filter / set->rate) : 1.0;
    axis->moving_mass = set->mass;
    for (size_t i = 0; i < axis->effects; ++i) {
        if (axis->effect[i].kind == MASS_MISMATCH) {
            axis->moving_mass += axis->effect[i].parameter[0];
        }
        if (axis->effect[i].kind == STRUCTURAL_RESONANCE) {
            axis->moving_mass -= axis->effect[i].parameter[2];
            if (!(TWO_PI * axis->effect[i].parameter[0] * axis->step <= RESONANT)) {
                return AXIS_FAST_RESONANCE;
            }
        }
    }
    axis->late = delay_of(axis) / axis->step;
    if (!(axis->moving_mass > 0.0)) {
        return AXIS_NO_MASS;
    }
    /* no force makes a prescribed motion, so none can be logged before it acts */
    if (!(fabs(axis->late) <= AXIS_HISTORY - 2) || (axis->control == AXIS_CONTROL_PRESCRIBED && axis->late < 0.0)) {
        return AXIS_LONG_DELAY;
    }
    find_slip_root(axis);
    /* exp(-34) = 2e-15: no slip within rounding; only where the two halves of the window do not overlap */
    axis->elastic_limit = set->lambda * set->zeta > 17.0 ? set->zeta - 17.0 / set->lambda : 0.0;
    return 0;
}

void axis_place(struct axis *axis, double position)
{
    axis->position = position;
    axis->measured = position;
    axis->velocity = 0.0;
    axis->acceleration = 0.0;
    axis->force = 0.0;
    axis->integral = 0.0;
    axis->derivative = 0.0;
    memset(axis->deflection, 0, sizeof axis->deflection);
    memset(axis->history, 0, sizeof axis->history);
    for (size_t i = 0; i < axis->effects; ++i) {
        struct axis_effect *effect = &axis->effect[i];
        effect->state[0] = 0.0;
        effect->state[1] = 0.0;
        if (effect->kind == STRUCTURAL_RESONANCE) {
            effect->state[0] = position;
        }
        if (effect->kind == FRICTIONAL_LAG) {
            effect->state[0] = stribeck(axis, 0.0);
        }
        if (effect->kind == BACKLASH) {
            effect->state[1] = position + 0.5 * effect->parameter[0];
        }
    }
    axis->transmitted = outside_force(axis);
    axis->level = stribeck(axis, 0.0) * level_factor(axis, 0.0, position) + load_level(axis, 0.0);
}

/* ---- a sample ----------------------------------------------------------------------------------------------- */

static double reference_at(const double *reference, size_t length, size_t k)
{
    return reference[k < length ? k : length - 1];
}

/* Central second difference `ahead` samples beyond sample k, linear in between. */
static double acceleration_at(const double *reference, size_t length, size_t k, double ahead, double rate)
{
    const size_t at = k + (size_t)ahead;
    const double part = ahead - floor(ahead), here = reference_at(reference, length, at);
    const double before = at > 0 ? reference_at(reference, length, at - 1) : here;
    const double next = reference_at(reference, length, at + 1), last = reference_at(reference, length, at + 2);
    return ((1.0 - part) * (next - 2.0 * here + before) + part * (last - 2.0 * next + here)) * rate * rate;
}

static double measure_position(struct axis *axis)
{
    double position = axis->position;
    for (size_t i = 0; i < axis->effects; ++i) {
        const double *p = axis->effect[i].parameter;
        if (axis->effect[i].kind == ENCODER_PERIODIC_ERROR) {
            position += periodic(p[0], axis->position, p[1], p[2]);
        }
    }
    if (axis->set.encoder_noise > 0.0) {
        position += axis->set.encoder_noise * random_normal(&axis->encoder_random);
    }
    if (axis->set.encoder_resolution > 0.0) {
        position = floor(position / axis->set.encoder_resolution + 0.5) * axis->set.encoder_resolution;
    }
    return position;
}

/* What the current loop made so many substeps ago. */
static double made_before(const struct axis *axis, double substeps)
{
    const double whole = floor(substeps), part = substeps - whole;
    const uint64_t back = axis->substep_count - (uint64_t)whole;
    return (1.0 - part) * axis->history[back % AXIS_HISTORY] + part * axis->history[(back - 1) % AXIS_HISTORY];
}

static double measure_force(struct axis *axis)
{
    double force = made_before(axis, fmax(axis->late, 0.0));
    for (size_t i = 0; i < axis->effects; ++i) {
        if (axis->effect[i].kind == FORCE_GAIN) {
            force *= axis->effect[i].parameter[0];
        }
    }
    if (axis->set.force_noise > 0.0) {
        force += axis->set.force_noise * random_normal(&axis->force_random);
    }
    return force;
}

/* Position controller: PID on the filtered difference of the encoder, feed-forward of the reference. */
static double control(
    struct axis *axis,
    double measured,
    double measured_force,
    double before,
    double here,
    double reference_acceleration)
{
    const struct axis_settings *set = &axis->set;
    const double rate = set->rate, error = here - measured;
    const double velocity = (set->velocity_feedforward * (here - before) - (measured - axis->measured)) * rate;
    axis->derivative += axis->filter * (velocity - axis->derivative);
    axis->measured = measured;

    const double integral = axis->integral + error / rate;
    double command = set->proportional_gain * error + set->integral_gain * integral +
                     set->derivative_gain * axis->derivative + set->acceleration_feedforward * reference_acceleration;
    if (axis->compensation != NULL) {
        command += axis->compensation(axis->compensation_context, measured, measured_force);
    }
    if (set->max_force > 0.0 && fabs(command) > set->max_force) {
        command = sign(command) * set->max_force; /* and the integral waits */
    } else {
        axis->integral = integral;
    }
    return command;
}

static double accelerate(struct axis *axis, double v)
{
    return (drive_force(axis) - friction_force(axis, v) - effect_force(axis, v)) / axis->moving_mass;
}

static void drift(struct axis *axis, double v, double end, double command)
{
    const double force = axis->force, made = axis->history[axis->substep_count % AXIS_HISTORY];
    axis->position += axis->step * v;
    ++axis->substep_count;
    if (axis->effects > 0) {
        move_transmitted(axis);
    }
    move_level(axis, v, end);
    move_elements(axis, engaged_velocity(axis, v));
    axis->history[axis->substep_count % AXIS_HISTORY] = command + (made - command) * axis->decay;
    axis->force = made_before(axis, fmax(-axis->late, 0.0));
    if (axis->effects > 0) {
        drift_hanging(axis);
        move_effects(axis, v, force);
    }
}

static void run_controlled(struct axis *axis, double command)
{
    if (axis->decay == 0.0 && !(axis->late < 0.0)) {
        axis->force = command; /* a drive without lag follows the command at once */
        axis->acceleration = accelerate(axis, axis->velocity);
    }
    for (int s = 0; s < axis->substeps; ++s) {
        const double kick = axis->half_step * axis->acceleration;
        kick_hanging(axis, axis->velocity);
        axis->velocity += kick;
        drift(axis, axis->velocity, axis->velocity + kick, command);
        /* friction at the end of the second kick, whose velocity the first kick predicts to second order */
        axis->acceleration = accelerate(axis, axis->velocity + kick);
        axis->velocity += axis->half_step * axis->acceleration;
        kick_hanging(axis, axis->velocity);
    }
}

/* The mass follows the reference exactly, at constant velocity between samples. */
static void run_prescribed(struct axis *axis, double here, double next)
{
    axis->velocity = (next - here) * axis->set.rate;
    for (int s = 0; s < axis->substeps; ++s) {
        kick_hanging(axis, axis->velocity);
        drift(axis, axis->velocity, axis->velocity, axis->force);
        kick_hanging(axis, axis->velocity);
    }
    axis->position = next; /* without the rounding of the sum */
}

static void put(double *column, size_t row, double value)
{
    if (column != NULL) {
        column[row] = value;
    }
}

size_t axis_run(
    struct axis *axis,
    const double *reference,
    size_t length,
    size_t start,
    size_t count,
    const struct axis_record *record)
{
    const double rate = axis->set.rate;
    const int prescribed = axis->control == AXIS_CONTROL_PRESCRIBED;
    for (size_t row = 0; row < count; ++row) {
        const size_t k = start + row;
        const double here = reference_at(reference, length, k), next = reference_at(reference, length, k + 1);
        const double before = k > 0 ? reference_at(reference, length, k - 1) : here;

        const double friction = friction_force(axis, axis->velocity), effects = effect_force(axis, axis->velocity);
        if (prescribed) {
            axis->acceleration = (next - 2.0 * here + before) * rate * rate;
            axis->force = (axis->moving_mass * axis->acceleration + friction + effects) / force_constant(axis);
            axis->history[axis->substep_count % AXIS_HISTORY] = axis->force;
        } else {
            axis->acceleration = (drive_force(axis) - friction - effects) / axis->moving_mass;
        }
        const double measured = measure_position(axis), measured_force = measure_force(axis);
        if (!(fabs(measured) < FARTHEST && fabs(measured_force) < STRONGEST)) {
            return row;
        }
        const double wanted = acceleration_at(reference, length, k, axis->set.feedforward_lead * rate, rate);

        put(record->position_m, row, measured);
        put(record->force_N, row, measured_force);
        put(record->true_position_m, row, axis->position);
        put(record->true_velocity_m_s, row, axis->velocity);
        put(record->true_acceleration_m_s2, row, axis->acceleration);
        put(record->true_force_N, row, prescribed ? axis->force * force_constant(axis) : drive_force(axis));
        put(record->true_friction_N, row, friction);
        put(record->true_effect_force_N, row, effects);
        if (record->true_deflection_m != NULL) {
            memcpy(
                record->true_deflection_m + row * (size_t)axis->elements, axis->deflection,
                (size_t)axis->elements * sizeof(double));
        }

        if (prescribed) {
            run_prescribed(axis, here, next);
        } else {
            run_controlled(axis, control(axis, measured, measured_force, before, here, wanted));
        }
    }
    return count;
}
