/* Simulated axis: see axis.h.
 *
 * Integration. Leapfrog (kick, drift, kick) with `substeps` steps per sample, second order. In a drift the velocity is
 * constant, so every friction element sees an exact displacement and its equation is solved on its own: by clipping
 * (Maxwell-slip) or in steps that are bounded in displacement (S-GMS), at any speed.
 */
#include "axis_effects.h"

#include <string.h>

#define SETTLED 3e-5  /* distance in r at which the linear equation is good to 1e-8 */
#define AT_REST 1e-12 /* dr/dxi of an element that moves no more */
#define FARTHEST 4e6  /* m; no axis is there: the loop is unstable */
#define STRONGEST 1e9 /* N, likewise */

/* ---- table of settings -------------------------------------------------------------------------------------- */

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

static double change_each(const struct axis *axis, enum axis_quantity quantity, double value, double v, double position)
{
    struct axis_view at = {
        .axis = axis, .v = v, .position = position, .time = (double)axis->substep_count * axis->step};
    for (size_t i = 0; i < axis->effects; ++i) {
        axis_change *own = axis->effect[i].row->change[quantity];
        if (own != NULL) {
            at.effect = &axis->effect[i];
            at.p = at.effect->parameter;
            at.x = at.effect->state;
            value = own(&at, value);
        }
    }
    return value;
}

/* A quantity as the effects change it, one after the other. */
static double change(const struct axis *axis, enum axis_quantity quantity, double value, double v, double position)
{
    return axis->changed & (1u << quantity) ? change_each(axis, quantity, value, v, position) : value;
}

/* Likewise, for the axis as it moves. */
static double change_now(const struct axis *axis, enum axis_quantity quantity, double value)
{
    return change(axis, quantity, value, axis->velocity, axis->position);
}

/* Sum of the effects' forces, friction-like in sign. */
static double effect_force(const struct axis *axis, double v)
{
    const double outside = change(axis, AXIS_OUTSIDE_FORCE, 0.0, v, axis->position);
    return change(axis, AXIS_OTHER_FORCE, outside, v, axis->position);
}

/* Force on the mass for the force that the current loop makes. */
static double drive_force(const struct axis *axis)
{
    return change_now(axis, AXIS_DRIVE, axis->force) * change_now(axis, AXIS_FORCE_CONSTANT, 1.0);
}

static void kick_effects(struct axis *axis)
{
    for (size_t i = 0; i < axis->effects; ++i) {
        struct axis_effect *effect = &axis->effect[i];
        if (effect->row->kick != NULL) {
            effect->row->kick(axis, effect);
        }
    }
}

static void move_effects(struct axis *axis)
{
    for (size_t i = 0; i < axis->effects; ++i) {
        struct axis_effect *effect = &axis->effect[i];
        if (effect->row->move != NULL) {
            effect->row->move(axis, effect);
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

/* s of the law times the effects' factor, and what the load adds. */
static void set_level(struct axis *axis, double level, double v, double position)
{
    axis->level = level * change(axis, AXIS_LEVEL_FACTOR, 1.0, v, position);
    axis->level += change(axis, AXIS_LOAD_LEVEL, 0.0, v, position);
}

/* Deflection at which an element breaks away. */
static double break_away(const struct axis *axis, int i)
{
    return axis->set.fraction[i] * axis->level / axis->set.stiffness[i];
}

/* Let the torque transmitted follow that of the present acceleration, halfway in a substep. The level sets the
 * acceleration and the torque sets the level: taken whole, a step would overshoot where a loss is near the torque. */
static void move_transmitted(struct axis *axis)
{
    const double inertial = axis->inertia * axis->acceleration;
    const double force = inertial + change_now(axis, AXIS_OUTSIDE_FORCE, 0.0);
    axis->transmitted += 0.5 * (force - axis->transmitted);
    axis->inertial += 0.5 * (inertial - axis->inertial);
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
        if (effect->row->follow != NULL) {
            level = effect->row->follow(axis, effect, level);
        }
    }
    const double position = at_end ? axis->position : axis->position - axis->half_step * v;
    /* the direction is that of the drift, which moves the elements */
    set_level(axis, level, v, position);
}

static double spring_force(const struct axis *axis)
{
    double force = 0.0;
    for (int i = 0; i < axis->elements; ++i) {
        force += axis->set.stiffness[i] * axis->deflection[i];
    }
    return force;
}

/* Share of a drift at velocity v that moves the friction elements. */
static double engaged_velocity(struct axis *axis, double v)
{
    for (size_t i = 0; i < axis->effects; ++i) {
        struct axis_effect *effect = &axis->effect[i];
        if (effect->row->engage != NULL) {
            v = effect->row->engage(axis, effect, v, spring_force(axis));
        }
    }
    return v;
}

/* dz/dt of an element at velocity v: for the micro-viscous force. */
static double deflection_rate(const struct axis *axis, int i, double v)
{
    const double scale = break_away(axis, i);
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
        const double scale = break_away(axis, i);
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
static double friction_force(const struct axis *axis, double v)
{
    double force = spring_force(axis) + change(axis, AXIS_VISCOUS, axis->set.viscous, v, axis->position) * v;
    const double shared = change(axis, AXIS_MICRO_VISCOUS, 0.0, v, axis->position);
    for (int i = 0; i < axis->elements; ++i) {
        const double sigma = axis->set.micro_viscous[i] + shared * axis->set.fraction[i];
        if (sigma != 0.0) {
            force += sigma * deflection_rate(axis, i, v);
        }
    }
    return change(axis, AXIS_FRICTION, force, v, axis->position);
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

void axis_set_compensation(struct axis *axis, axis_compensation *compensation, void *context)
{
    axis->compensation = compensation;
    axis->compensation_context = context;
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
    for (size_t i = 0; i < axis->effects; ++i) {
        const struct axis_effect *effect = &axis->effect[i];
        const int refusal = effect->row->check != NULL ? effect->row->check(axis, effect) : 0;
        if (refusal != 0) {
            return refusal;
        }
    }
    axis->inertia = change_now(axis, AXIS_INERTIA, set->mass);
    axis->moving_mass = change_now(axis, AXIS_MOVING_MASS, set->mass);
    axis->late = change_now(axis, AXIS_DELAY, 0.0) / axis->step;
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
    axis->level = stribeck(axis, 0.0);
    for (size_t i = 0; i < axis->effects; ++i) {
        struct axis_effect *effect = &axis->effect[i];
        memset(effect->state, 0, sizeof effect->state);
        if (effect->row->place != NULL) {
            effect->row->place(axis, effect);
        }
    }
    axis->transmitted = change_now(axis, AXIS_OUTSIDE_FORCE, 0.0);
    axis->inertial = 0.0;
    set_level(axis, axis->level, axis->velocity, axis->position);
}

void axis_move(struct axis *axis, double velocity, const double *deflection)
{
    axis->velocity = velocity;
    set_level(axis, stribeck(axis, velocity), velocity, axis->position);
    for (int i = 0; i < axis->elements; ++i) {
        const double most = break_away(axis, i);
        axis->deflection[i] = fmin(fmax(deflection[i], -most), most);
    }
}

void axis_start(struct axis *axis, double position, double velocity, double strain)
{
    axis->position = position;
    axis->velocity = velocity;
    for (int i = 0; i < axis->elements; ++i) {
        const double level = break_away(axis, i), most = fmax(level, fabs(axis->deflection[i]));
        axis->deflection[i] = fmin(fmax(axis->deflection[i] + strain * level, -most), most);
    }
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
    double position = change_now(axis, AXIS_READ_POSITION, axis->position);
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
    double force = change_now(axis, AXIS_READ_FORCE, made_before(axis, fmax(axis->late, 0.0)));
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

static double accelerate(const struct axis *axis, double v)
{
    return (drive_force(axis) - friction_force(axis, v) - effect_force(axis, v)) / axis->moving_mass;
}

static void drift(struct axis *axis, double v, double end, double command)
{
    const double made = axis->history[axis->substep_count % AXIS_HISTORY];
    axis->force_before = axis->force;
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
        move_effects(axis);
    }
}

/* Reference of a run. */
struct course {
    const double *values;
    size_t length;
};

/* `commands`: of a drive, whose force depends on the motion within the sample; null: the command is a force. */
static void run_controlled(struct axis *axis, double command, const struct course *commands, size_t k)
{
    if (commands != NULL) {
        command = axis_drive_force(axis, commands->values, commands->length, (double)k);
    }
    if (axis->decay == 0.0 && !(axis->late < 0.0)) {
        axis->force = command; /* a drive without lag follows the command at once */
        axis->acceleration = accelerate(axis, axis->velocity);
    }
    for (int s = 0; s < axis->substeps; ++s) {
        const double kick = axis->half_step * axis->acceleration;
        kick_effects(axis);
        if (commands != NULL) {
            const double sample = (double)k + (s + 0.5) / axis->substeps;
            command = axis_drive_force(axis, commands->values, commands->length, sample);
        }
        axis->velocity += kick;
        drift(axis, axis->velocity, axis->velocity + kick, command);
        /* friction at the end of the second kick, whose velocity the first kick predicts to second order */
        axis->acceleration = accelerate(axis, axis->velocity + kick);
        axis->velocity += axis->half_step * axis->acceleration;
        kick_effects(axis);
    }
}

/* The mass follows the reference exactly, at constant velocity between samples. */
static void run_prescribed(struct axis *axis, double here, double next, double command)
{
    axis->velocity = (next - here) * axis->set.rate;
    for (int s = 0; s < axis->substeps; ++s) {
        kick_effects(axis);
        drift(axis, axis->velocity, axis->velocity, command);
        kick_effects(axis);
    }
    axis->position = next; /* without the rounding of the sum */
}

static void put(double *column, size_t row, double value)
{
    if (column != NULL) {
        column[row] = value;
    }
}

/* What sensors say and what they do not, at an acceleration and forces that are known. */
static int observe(
    struct axis *axis,
    double friction,
    double effects,
    const struct axis_record *record,
    size_t row,
    double *measured,
    double *measured_force)
{
    const int prescribed = axis->control == AXIS_CONTROL_PRESCRIBED;
    *measured = measure_position(axis);
    *measured_force = measure_force(axis);
    if (!(fabs(*measured) < FARTHEST && fabs(*measured_force) < STRONGEST)) {
        return 0;
    }
    put(record->position_m, row, *measured);
    put(record->force_N, row, *measured_force);
    put(record->true_position_m, row, axis->position);
    put(record->true_velocity_m_s, row, axis->velocity);
    put(record->true_acceleration_m_s2, row, axis->acceleration);
    put(record->true_force_N, row,
        prescribed ? axis->force * change_now(axis, AXIS_FORCE_CONSTANT, 1.0) : drive_force(axis));
    put(record->true_friction_N, row, friction);
    put(record->true_effect_force_N, row, effects);
    if (record->true_deflection_m != NULL) {
        memcpy(
            record->true_deflection_m + row * (size_t)axis->elements, axis->deflection,
            (size_t)axis->elements * sizeof(double));
    }
    return 1;
}

int axis_observe(struct axis *axis, const struct axis_record *record, size_t row)
{
    double measured, measured_force;
    const double friction = friction_force(axis, axis->velocity), effects = effect_force(axis, axis->velocity);
    axis->acceleration = (drive_force(axis) - friction - effects) / axis->moving_mass;
    return observe(axis, friction, effects, record, row, &measured, &measured_force);
}

/* Mean force of the drive over sample k [N] behind a logged one: before what makes the log late, or scales it. */
static double force_behind_log(const struct axis *axis, const double *logged, size_t length, size_t k)
{
    const double at = (double)k + 0.5 + fmax(axis->late, 0.0) / axis->substeps, part = at - floor(at);
    const double before = reference_at(logged, length, (size_t)at), next = reference_at(logged, length, (size_t)at + 1);
    return ((1.0 - part) * before + part * next) / change_now(axis, AXIS_READ_FORCE, 1.0);
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
    const struct course commands = {reference, length};
    for (size_t row = 0; row < count; ++row) {
        const size_t k = start + row;
        const double here = reference_at(reference, length, k), next = reference_at(reference, length, k + 1);
        const double before = k > 0 ? reference_at(reference, length, k - 1) : here;

        const double friction = friction_force(axis, axis->velocity), effects = effect_force(axis, axis->velocity);
        double measured, measured_force;
        if (prescribed) {
            axis->acceleration = (next - 2.0 * here + before) * rate * rate;
            axis->force = (axis->moving_mass * axis->acceleration + friction + effects) /
                          change_now(axis, AXIS_FORCE_CONSTANT, 1.0);
            axis->history[axis->substep_count % AXIS_HISTORY] = axis->force;
        } else {
            axis->acceleration = (drive_force(axis) - friction - effects) / axis->moving_mass;
        }
        if (!observe(axis, friction, effects, record, row, &measured, &measured_force)) {
            return row;
        }
        if (prescribed) {
            run_prescribed(axis, here, next, axis->force);
        } else if (axis->control == AXIS_CONTROL_FORCE) {
            run_controlled(axis, here, NULL, k);
        } else if (axis->control == AXIS_CONTROL_LOGGED) {
            run_controlled(axis, force_behind_log(axis, reference, length, k), NULL, k);
        } else if (axis->control == AXIS_CONTROL_COMMAND) {
            run_controlled(axis, 0.0, &commands, k);
        } else {
            const double wanted = acceleration_at(reference, length, k, axis->set.feedforward_lead * rate, rate);
            run_controlled(axis, control(axis, measured, measured_force, before, here, wanted), NULL, k);
        }
    }
    return count;
}

void axis_follow(
    struct axis *axis,
    const double *position,
    const double *driving,
    size_t length,
    size_t start,
    size_t count,
    double *acceleration)
{
    for (size_t k = start; k < start + count; ++k) {
        acceleration[k - start] = axis->acceleration = accelerate(axis, axis->velocity);
        const double force = axis->control == AXIS_CONTROL_COMMAND
                                 ? axis_drive_force(axis, driving, length, (double)k + 0.5)
                                 : force_behind_log(axis, driving, length, k);
        run_prescribed(axis, reference_at(position, length, k), reference_at(position, length, k + 1), force);
    }
}
