/* Effects of the simulated axis: see axis_effects.h. A row of the table at the end is all that there is of an effect;
 * the functions that it names stand above it.
 */
#include "axis_effects.h"

#define RESONANT 0.5 /* omega times step of a hanging mass, at most: its frequency is then right to 1 % */

static double periodic(double amplitude, double x, double period, double phase)
{
    return amplitude * sin(TWO_PI * (x / period) + phase);
}

static double approach(double t, double time_constant)
{
    return 1.0 - exp(-t / time_constant);
}

/* ---- changes that several effects make ---------------------------------------------------------------------- */

static double add_parameter(const struct axis_view *at, double value)
{
    return value + at->p[0];
}

static double add_state(const struct axis_view *at, double value)
{
    return value + at->x[0];
}

static double multiply(const struct axis_view *at, double value)
{
    return value * at->p[0];
}

static double add_ripple(const struct axis_view *at, double value)
{
    return value + periodic(at->p[0], at->position, at->p[1], at->p[2]);
}

static double multiply_ripple(const struct axis_view *at, double value)
{
    return value * (1.0 + periodic(at->p[0], at->position, at->p[1], at->p[2]));
}

/* ---- forces ------------------------------------------------------------------------------------------------- */

static double add_position_spring(const struct axis_view *at, double force)
{
    return force + at->p[0] * (at->position - at->p[1]);
}

static double add_oscillation(const struct axis_view *at, double force)
{
    return force + at->p[0] * sin(TWO_PI * at->p[1] * at->time + at->p[2]);
}

static double add_step(const struct axis_view *at, double force)
{
    return force + (at->time >= at->p[1] ? at->p[0] : 0.0);
}

static double add_unbalance(const struct axis_view *at, double force)
{
    return force + at->p[0] * sin(at->position + at->p[1]);
}

static double add_map_sine(const struct axis_view *at, double force)
{
    const double turns = at->p[1] * fmod(at->position, at->p[0]) / at->p[0];
    return force + (at->p[2] * sin(TWO_PI * turns) + at->p[3] * cos(TWO_PI * turns));
}

static double add_quadratic_drag(const struct axis_view *at, double force)
{
    return force + at->p[0] * at->v * fabs(at->v);
}

static double add_eddy_current_damping(const struct axis_view *at, double force)
{
    const double ratio = at->v / at->p[1];
    return force + at->p[0] * at->v / (1.0 + ratio * ratio);
}

/* A point of a curve over speed: rest, knots, the end. */
struct curve_point {
    double speed, force;
};

static struct curve_point point_of_curve(const struct axis_view *at, int i)
{
    const struct axis_effect *knot = at->effect + i, *behind = at->axis->effect + at->axis->effects;
    struct curve_point point = {0.0, 0.0};
    if (i >= 0 && knot < behind && knot->row == at->effect->row) {
        point.speed = knot->parameter[0];
        point.force = knot->parameter[at->v > 0.0 ? 1 : 2];
    } else if (i >= 0) {
        point.speed = at->p[3];
    }
    return point;
}

/* Slope at b of the parabola through three points. */
static double parabola_slope(struct curve_point a, struct curve_point b, struct curve_point c)
{
    const double before = (b.force - a.force) / (b.speed - a.speed), whole = (c.force - a.force) / (c.speed - a.speed);
    const double after = (c.force - b.force) / (c.speed - b.speed);
    return before + after - whole;
}

/* A knot an effect: the first of them finds the two points that |v| lies between, and joins them by a cubic whose
 * slopes are those of parabolas: through a point and its neighbours, at rest and at the end through the nearest three.
 */
static double add_curve(const struct axis_view *at, double force)
{
    const double speed = fabs(at->v);
    int i = 0;
    if ((at->effect > at->axis->effect && at->effect[-1].row == at->effect->row) || speed >= at->p[3]) {
        return force;
    }
    while (speed >= point_of_curve(at, i).speed) {
        ++i;
    }
    const struct curve_point a = point_of_curve(at, i - 1), b = point_of_curve(at, i);
    const int is_last = b.speed >= at->p[3];
    const struct curve_point before = i > 0 ? point_of_curve(at, i - 2) : point_of_curve(at, i + 1);
    const struct curve_point behind = is_last ? before : point_of_curve(at, i + 1);
    const double width = b.speed - a.speed, t = (speed - a.speed) / width, u = 1.0 - t;
    const double rise = width * parabola_slope(before, a, b), fall = width * parabola_slope(a, b, behind);
    const double c = u * u * ((1.0 + 2.0 * t) * a.force + t * rise) + t * t * ((1.0 + 2.0 * u) * b.force - u * fall);
    return force + sign(at->v) * c;
}

/* Force of a film of grease that follows speed at once: sigma_v v, and c, which a curve's first knot adds for all. */
static double film_force(const struct axis_view *at)
{
    double force = at->axis->set.viscous * at->v;
    for (size_t i = 0; i < at->axis->effects; ++i) {
        const struct axis_effect *effect = &at->axis->effect[i];
        if (effect->row->change[AXIS_OTHER_FORCE] == add_curve) {
            const struct axis_view knot = {at->axis, effect, effect->parameter, effect->state, at->v, 0.0, 0.0};
            force = add_curve(&knot, force);
        }
    }
    return force;
}

static double add_late_film(const struct axis_view *at, double force)
{
    return force + at->x[0] - film_force(at);
}

static void move_film(const struct axis *axis, struct axis_effect *effect)
{
    const struct axis_view at = {axis, effect, effect->parameter, effect->state, axis->velocity, 0.0, 0.0};
    const double prompt = film_force(&at);
    effect->state[0] = prompt + (effect->state[0] - prompt) * exp(-axis->step / effect->parameter[0]);
}

static void move_hysteresis(const struct axis *axis, struct axis_effect *effect)
{
    const double *p = effect->parameter, v = axis->velocity, end = p[1] * sign(v);
    double *force = &effect->state[0];
    *force = end + (*force - end) * exp(-p[0] * fabs(v) * axis->step / p[1]);
}

/* The i-th cubic B-spline of an even grid between two ends, which begins three cells below the lower one. */
static double grid_spline(double x, double low, double high, double cells, double i)
{
    const double u = fabs((x - low) / (high - low) * cells - i + 1.0);
    return u >= 2.0 ? 0.0 : u >= 1.0 ? pow(2.0 - u, 3.0) / 6.0 : 2.0 / 3.0 - u * u * (1.0 - 0.5 * u);
}

/* Half the scale at half way: -1 to 1 for every speed. */
static double bound_speed(double v, double scale)
{
    return v / (fabs(v) + scale);
}

static double add_table(const struct axis_view *at, double force)
{
    const double *p = at->p, cells[3] = {p[0], p[3], p[8]}, v = p[7] > 0.0 ? at->x[1] : at->v;
    const double value[3] = {at->position, bound_speed(v, p[4]), at->x[0]};
    const double low[3] = {p[1], bound_speed(p[5], p[4]), -1.0}, high[3] = {p[2], bound_speed(p[6], p[4]), 1.0};
    for (size_t k = 0; k < at->effect->entries; ++k) {
        double share = at->effect->table[k];
        size_t rest = k;
        for (int c = 2; c >= 0; --c) {
            if (cells[c] > 0.0) {
                const size_t splines = (size_t)cells[c] + 3;
                share *= grid_spline(value[c], low[c], high[c], cells[c], (double)(rest % splines));
                rest /= splines;
            }
        }
        force += share;
    }
    return force;
}

/* States of a table: travel since a reversal, and the speed that follows late. */
static void move_memory(const struct axis *axis, struct axis_effect *effect)
{
    const double *p = effect->parameter, v = axis->velocity;
    double *memory = &effect->state[0], *late = &effect->state[1];
    *memory = sign(v) + (*memory - sign(v)) * exp(-fabs(v) * axis->step / p[9]);
    *late = p[7] > 0.0 ? v + (*late - v) * exp(-axis->step / p[7]) : v;
}

static double call_own_force(const struct axis_view *at, double force)
{
    return force + at->effect->force(at->effect->context, at->position, at->v, at->time);
}

/* ---- friction ----------------------------------------------------------------------------------------------- */

static double multiply_by_direction(const struct axis_view *at, double factor)
{
    return factor * (1.0 + at->p[0] * sign(at->v));
}

static double add_by_direction(const struct axis_view *at, double viscous)
{
    return viscous + at->p[0] * sign(at->v);
}

static double multiply_drift(const struct axis_view *at, double factor)
{
    return factor * (1.0 + at->p[0] * approach(at->time, at->p[1]));
}

static double add_viscous_drift(const struct axis_view *at, double viscous)
{
    return viscous + at->axis->set.viscous * at->p[0] * approach(at->time, at->p[1]);
}

static double multiply_age(const struct axis_view *at, double factor)
{
    return factor * (1.0 + at->p[0] * at->x[0]);
}

static void move_age(const struct axis *axis, struct axis_effect *effect)
{
    const double *p = effect->parameter, rate = 1.0 / p[1] + fabs(axis->velocity) / p[2];
    double *age = &effect->state[0];
    *age += (1.0 / (p[1] * rate) - *age) * (1.0 - exp(-rate * axis->step));
}

/* Friction of a mesh is part of what the mesh carries: added = ratio |along + share added|. */
static double add_load(const struct axis_view *at, double level)
{
    const struct axis *axis = at->axis;
    const double x = at->v / axis->set.stribeck_velocity, ratio = at->p[0] + at->p[1] * exp(-x * x);
    const double torque = axis->transmitted - (1.0 - at->p[2]) * axis->inertial;
    const double friction = axis->level + level + axis->set.viscous * fabs(at->v);
    const double along = (at->v < 0.0 ? -torque : torque) + at->p[3] * friction;
    return level + ratio * fabs(along) / (1.0 - sign(along) * at->p[3] * fmin(ratio, 0.95));
}

static double add_loss(const struct axis_view *at, double level)
{
    const double transmitted = at->axis->transmitted;
    return level + fabs(transmitted) * (transmitted * at->v > 0.0 ? 1.0 / at->p[0] - 1.0 : 1.0 - at->p[0]);
}

static void place_lagging_level(const struct axis *axis, struct axis_effect *effect)
{
    effect->state[0] = axis->level;
}

static double follow_level(const struct axis *axis, struct axis_effect *effect, double level)
{
    effect->state[0] = level + (effect->state[0] - level) * exp(-axis->step / effect->parameter[0]);
    return effect->state[0];
}

/* States of a gap: its side, -1, 0 (within) or 1, and the position at which the + side touches. */
static void place_gap(const struct axis *axis, struct axis_effect *effect)
{
    effect->state[1] = axis->position + 0.5 * effect->parameter[0];
}

static double cut_friction(const struct axis_view *at, double friction)
{
    return at->x[0] == 0.0 ? 0.0 : friction;
}

/* All of a drift but what crosses the gap. */
static double engage_behind_gap(const struct axis *axis, struct axis_effect *effect, double v, double spring)
{
    double *side = &effect->state[0], *contact = &effect->state[1];
    const double gap = effect->parameter[0], from = axis->position - axis->step * v, to = axis->position;
    if (*side > 0.0 && v < 0.0 && spring <= 0.0) {
        *side = 0.0;
        *contact = from;
    } else if (*side < 0.0 && v > 0.0 && spring >= 0.0) {
        *side = 0.0;
        *contact = from + gap;
    }
    if (*side == 0.0) {
        double path = 0.0;
        if (to > *contact) {
            *side = 1.0;
            path = to - *contact;
        } else if (to < *contact - gap) {
            *side = -1.0;
            path = to - (*contact - gap);
        }
        return path / axis->step;
    }
    return v;
}

/* ---- drive and mechanics ------------------------------------------------------------------------------------ */

static double replace_by_state(const struct axis_view *at, double force)
{
    (void)force;
    return at->x[0];
}

static void move_lagging_force(const struct axis *axis, struct axis_effect *effect)
{
    const double mean = 0.5 * (axis->force_before + axis->force);
    effect->state[0] = mean + (effect->state[0] - mean) * exp(-axis->step / effect->parameter[0]);
}

static double subtract_hanging_mass(const struct axis_view *at, double mass)
{
    return mass - at->p[2];
}

static int check_resonance(const struct axis *axis, const struct axis_effect *effect)
{
    return TWO_PI * effect->parameter[0] * axis->step <= RESONANT ? 0 : AXIS_FAST_RESONANCE;
}

/* States of a hanging mass: position and velocity. */
static void place_hanging(const struct axis *axis, struct axis_effect *effect)
{
    effect->state[0] = axis->position;
}

static void kick_hanging(const struct axis *axis, struct axis_effect *effect)
{
    const double omega = TWO_PI * effect->parameter[0], c = 2.0 * effect->parameter[1] * omega * axis->half_step;
    const double pull = omega * omega * (axis->position - effect->state[0]) * axis->half_step;
    effect->state[1] = (effect->state[1] + pull + c * axis->velocity) / (1.0 + c);
}

static void move_hanging(const struct axis *axis, struct axis_effect *effect)
{
    effect->state[0] += axis->step * effect->state[1];
}

static double add_pull(const struct axis_view *at, double force)
{
    const double *p = at->p, *x = at->x, omega = TWO_PI * p[0];
    return force + p[2] * omega * (omega * (at->position - x[0]) + 2.0 * p[1] * (at->v - x[1]));
}

/* ---- table -------------------------------------------------------------------------------------------------- */

static const struct axis_effect_row table[] = {
    /* force = force_N */
    {"constant_offset", {"force_N"}, .change = {[AXIS_OUTSIDE_FORCE] = add_parameter}},
    /* force = amplitude sin(2 pi q / pitch + phase) */
    {"force_ripple", {"amplitude_N", "pitch_m", "phase_rad"}, .change = {[AXIS_OTHER_FORCE] = add_ripple}},
    /* force on the mass = logged force (1 + ratio sin(2 pi q / pitch + phase)) */
    {"force_constant_ripple", {"ratio", "pitch_m", "phase_rad"}, .change = {[AXIS_FORCE_CONSTANT] = multiply_ripple}},
    /* force = stiffness (q - centre) */
    {"position_spring", {"stiffness_N_m", "centre_m"}, .change = {[AXIS_OUTSIDE_FORCE] = add_position_spring}},
    /* Dahl: dF/dq = stiffness (1 - F sign(v) / force_N) */
    {"hose_hysteresis",
     {"stiffness_N_m", "force_N"},
     .change = {[AXIS_OTHER_FORCE] = add_state},
     .move = move_hysteresis},
    /* s(v) (1 + ratio sign(v)) */
    {"asymmetric_coulomb", {"ratio"}, .change = {[AXIS_LEVEL_FACTOR] = multiply_by_direction}},
    /* sigma_v + difference sign(v) */
    {"asymmetric_viscous", {"difference_N_s_m"}, .change = {[AXIS_VISCOUS] = add_by_direction}},
    /* s(v) (1 + ratio sin(2 pi q / pitch + phase)) */
    {"position_dependent_friction",
     {"ratio", "pitch_m", "phase_rad"},
     .change = {[AXIS_LEVEL_FACTOR] = multiply_ripple}},
    /* s(v) (1 + ratio (1 - exp(-t / time_constant))) */
    {"friction_drift", {"ratio", "time_constant_s"}, .change = {[AXIS_LEVEL_FACTOR] = multiply_drift}},
    /* sigma_v (1 + ratio (1 - exp(-t / time_constant))) */
    {"viscous_drift", {"ratio", "time_constant_s"}, .change = {[AXIS_VISCOUS] = add_viscous_drift}},
    /* true mass = mass + mass_kg */
    {"mass_mismatch", {"mass_kg"}, .change = {[AXIS_INERTIA] = add_parameter, [AXIS_MOVING_MASS] = add_parameter}},
    /* logged force = gain times the force on the mass */
    {"force_gain", {"gain"}, .change = {[AXIS_READ_FORCE] = multiply}},
    /* logged force = force on the mass, delay_s ago; below zero: force on the mass = logged force, -delay_s ago */
    {"force_delay", {"delay_s"}, .change = {[AXIS_DELAY] = add_parameter}},
    /* force on the mass follows the logged one with a first-order lag */
    {"actuator_lag", {"time_constant_s"}, .change = {[AXIS_DRIVE] = replace_by_state}, .move = move_lagging_force},
    /* force = coefficient v |v| */
    {"quadratic_drag", {"coefficient_N_s2_m2"}, .change = {[AXIS_OTHER_FORCE] = add_quadratic_drag}},
    /* force = damping v / (1 + (v / corner)^2) */
    {"eddy_current_damping",
     {"damping_N_s_m", "corner_velocity_m_s"},
     .change = {[AXIS_OTHER_FORCE] = add_eddy_current_damping}},
    /* encoder reads q + amplitude sin(2 pi q / pitch + phase) */
    {"encoder_periodic_error", {"amplitude_m", "pitch_m", "phase_rad"}, .change = {[AXIS_READ_POSITION] = add_ripple}},
    /* `mass_kg` of the mass hangs on a spring; frequency is its own, with the rest held */
    {"structural_resonance",
     {"frequency_Hz", "damping_ratio", "mass_kg"},
     .change = {[AXIS_MOVING_MASS] = subtract_hanging_mass, [AXIS_OTHER_FORCE] = add_pull},
     .check = check_resonance,
     .place = place_hanging,
     .kick = kick_hanging,
     .move = move_hanging},
    /* force = amplitude sin(2 pi frequency t + phase) */
    {"periodic_disturbance",
     {"amplitude_N", "frequency_Hz", "phase_rad"},
     .change = {[AXIS_OUTSIDE_FORCE] = add_oscillation}},
    /* force = force_N from time_s on */
    {"step_disturbance", {"force_N", "time_s"}, .change = {[AXIS_OUTSIDE_FORCE] = add_step}},
    /* friction acts behind a gap: no friction while the mass crosses it */
    {"backlash",
     {"gap_m"},
     .change = {[AXIS_FRICTION] = cut_friction},
     .place = place_gap,
     .engage = engage_behind_gap},
    /* s follows s(v) with a first-order lag */
    {"frictional_lag", {"time_constant_s"}, .place = place_lagging_level, .follow = follow_level},
    /* force = u - (sigma_v v + c(v)), u follows sigma_v v + c(v) with a first-order lag */
    {"viscous_lag", {"time_constant_s"}, .change = {[AXIS_OTHER_FORCE] = add_late_film}, .move = move_film},
    /* s(v) (1 + ratio d), dd/dt = (1 - d) / time_constant - |v| d / length: ages at rest, renewed by motion */
    {"dwell_dependence",
     {"ratio", "time_constant_s", "length_m"},
     .change = {[AXIS_LEVEL_FACTOR] = multiply_age},
     .move = move_age},
    /* sigma_i + nu_i damping */
    {"micro_viscous", {"damping_N_s_m"}, .change = {[AXIS_MICRO_VISCOUS] = add_parameter}},
    /* force = amplitude sin(q + phase), q an angle */
    {"unbalance", {"amplitude_N", "phase_rad"}, .change = {[AXIS_OUTSIDE_FORCE] = add_unbalance}},
    /* s(v) + (ratio + rise_ratio exp(-(v/v_s)^2)) |T|, T: load, and shares of inertial force and friction */
    {"load_dependent_friction",
     {"ratio", "rise_ratio", "inertia_ratio", "friction_ratio"},
     .change = {[AXIS_LOAD_LEVEL] = add_load}},
    /* s(v) + |T| (1 / efficiency - 1) where T drives the motion, s(v) + |T| (1 - efficiency) where it brakes it */
    {"drive_efficiency", {"efficiency_ratio"}, .change = {[AXIS_LOAD_LEVEL] = add_loss}},
    /* force = sum over its sines of sine sin(2 pi order q / pitch) + cosine cos(...); one effect of the plant each */
    {"position_map", {"pitch_m", "order", "sine_N", "cosine_N"}, .change = {[AXIS_OTHER_FORCE] = add_map_sine}},
    /* force = sum of force_ij times splines of place, speed (its own or a late one) or travel since a reversal */
    {"learned_residual",
     {"place_cells", "place_low_m", "place_high_m", "speed_cells", "speed_scale_m_s", "speed_low_m_s", "speed_high_m_s",
      "speed_lag_s", "travel_cells", "travel_length_m", "force_N"},
     .has_table = 1,
     .change = {[AXIS_OTHER_FORCE] = add_table},
     .move = move_memory},
    /* force = sign(v) c(|v|), c through its knots; one effect of the plant each */
    {"friction_curve", {"speed_m_s", "forward_N", "backward_N", "end_m_s"}, .change = {[AXIS_OTHER_FORCE] = add_curve}},
};

#define ROWS (sizeof table / sizeof table[0])

const char *axis_effect_name(size_t kind)
{
    return kind < ROWS ? table[kind].name : NULL;
}

const char *axis_effect_parameter(size_t kind, size_t j)
{
    return kind < ROWS && j < AXIS_MAX_EFFECT_PARAMETERS ? table[kind].parameter[j] : NULL;
}

int axis_effect_has_table(size_t kind)
{
    return kind < ROWS ? table[kind].has_table : 0;
}

static int add_row(struct axis *axis, const struct axis_effect_row *row)
{
    if (axis->effects >= AXIS_MAX_EFFECTS) {
        return -1;
    }
    axis->effect[axis->effects].row = row;
    for (unsigned quantity = 0; quantity < AXIS_QUANTITIES; ++quantity) {
        axis->changed |= row->change[quantity] != NULL ? 1u << quantity : 0u;
    }
    return (int)axis->effects++;
}

int axis_add_effect(struct axis *axis, size_t kind, const double *parameter)
{
    const int index = kind < ROWS ? add_row(axis, &table[kind]) : -1;
    for (size_t j = 0; index >= 0 && axis_effect_parameter(kind, j) != NULL; ++j) {
        axis->effect[index].parameter[j] = parameter[j];
    }
    return index;
}

int axis_add_force(struct axis *axis, axis_force *force, void *context)
{
    static const struct axis_effect_row row = {.change = {[AXIS_OTHER_FORCE] = call_own_force}};
    const int index = add_row(axis, &row);
    if (index >= 0) {
        axis->effect[index].force = force;
        axis->effect[index].context = context;
    }
    return index;
}

void axis_set_effect(struct axis *axis, size_t effect, size_t j, double value)
{
    if (effect < axis->effects && j < AXIS_MAX_EFFECT_PARAMETERS) {
        axis->effect[effect].parameter[j] = value;
    }
}

void axis_set_table(struct axis *axis, size_t effect, const double *values, size_t entries)
{
    if (effect < axis->effects) {
        axis->effect[effect].table = values;
        axis->effect[effect].entries = entries;
    }
}
