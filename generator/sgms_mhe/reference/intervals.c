/* Driver of the reference integrator: the loops over intervals, blocks, steps and substeps, around functions that CasADi
   generates. What precedes this file in its translation unit: those functions; N_X, N_P, N_W, N_BLOCKS, LARGEST_BLOCK;
   SZ_ARG, SZ_RES, SZ_IW, SZ_W; BLOCK_SIZE, BLOCK_STATES (block after block); STEP, CLIP, FLOW, RATE (0 where a block has
   none); N_CHEBYSHEV, NEAR, BEFORE_TURN, N_READINGS. Matrices are column-major, as CasADi has them. */

#include <math.h>
#include <string.h>

struct flow {
    double r_star, k, curvature, r_max, lambda, zeta, edge_below, edge_above; /* edge: L at either end of its tables */
    const double *below, *above;
    long long n_below, n_above;
};

/* g(r* + d), with full relative accuracy near d = 0. */
static double flow_g(const struct flow *f, double d)
{
    const double r = f->r_star + d;
    const double x = f->lambda * d;
    const double eta = 1.0 - 0.5 * tanh(f->lambda * (r + f->zeta)) + 0.5 * tanh(f->lambda * (r - f->zeta));
    if (fabs(x) > 1.0)
        return 1.0 - eta * r;
    const double lower = fmin(f->lambda * (f->r_star - f->zeta), 350.0);
    const double upper = fmin(f->lambda * (f->r_star + f->zeta), 350.0);
    const double change = 0.5 * sinh(x) * (1.0 / (cosh(lower + x) * cosh(lower)) - 1.0 / (cosh(upper + x) * cosh(upper)));
    return -(d * eta + f->r_star * change);
}

/* L(d), by Clenshaw's recurrence on its panel. */
static double flow_level(const struct flow *f, double d)
{
    const int is_below = d < 0.0;
    const double start = is_below ? -f->r_star : 0.0;
    const long long n = is_below ? f->n_below : f->n_above;
    const double width = (is_below ? f->r_star : f->r_max - f->r_star) / (double)n;
    long long index = (long long)((d - start) / width);
    index = index < 0 ? 0 : index >= n ? n - 1 : index;
    const double t = 2.0 * (d - start - (double)index * width) / width - 1.0;
    const double *c = (is_below ? f->below : f->above) + index * N_CHEBYSHEV;
    double b1 = 0.0, b2 = 0.0;
    for (int j = N_CHEBYSHEV - 1; j > 0; j--) {
        const double b = 2.0 * t * b1 - b2 + c[j];
        b2 = b1;
        b1 = b;
    }
    return t * b1 - b2 + c[0];
}

static struct flow flow_unpack(const double *packed)
{
    struct flow f;
    f.r_star = packed[0];
    f.k = packed[1];
    f.curvature = packed[2];
    f.r_max = packed[3];
    f.lambda = packed[4];
    f.zeta = packed[5];
    f.n_below = (long long)packed[6];
    f.n_above = (long long)packed[7];
    f.below = packed + 8;
    f.above = f.below + f.n_below * N_CHEBYSHEV;
    f.edge_below = f.n_below > 0 ? flow_level(&f, -f.r_star) : 0.0;
    f.edge_above = f.n_above > 0 ? flow_level(&f, f.r_max - f.r_star) : 0.0;
    return f;
}

static double flow_solve(const struct flow *f, double d0, double xi)
{
    const double sign = d0 < 0.0 ? -1.0 : 1.0;
    double upper = log(fabs(d0));
    const double target = upper + flow_level(f, d0) - f->k * xi;
    if (target < -600.0)
        return 0.0;
    double lower = fmin(target - fmax(d0 < 0.0 ? f->edge_below : f->edge_above, 0.0) - 1.0, upper - 1e-3);
    /* A short flow is nearly a straight line, a long one has only its tail left. */
    const double line = sign * (d0 + flow_g(f, d0) * xi);
    double x = fmin(fmax(line > 0.5 * fabs(d0) ? log(line) : target, lower), upper);
    for (int i = 0; i < 200; i++) {
        const double d = sign * exp(x);
        const double residual = x + flow_level(f, d) - target;
        if (residual > 0.0)
            upper = fmin(upper, x);
        else
            lower = fmax(lower, x);
        double next = x + residual * flow_g(f, d) / (f->k * d); /* 1 + L'(d) d = -k d / g */
        if (!(next >= lower && next <= upper))
            next = 0.5 * (lower + upper);
        const double step = fabs(next - x);
        x = next;
        if (step <= 1e-10) /* quadratic: the next one would be rounding */
            break;
    }
    return sign * exp(x);
}

/* Flow over xi >= 0: r1, a = dr1/dr0, g1 = dr1/dxi. */
static double flow_advance(const struct flow *f, double r0, double xi, double *a, double *g1)
{
    double slope = 1.0; /* dr/dr0 before the table takes over, over g there */
    if (!isfinite(r0) || !isfinite(xi)) {
        *a = *g1 = NAN;
        return NAN;
    }
    if (r0 < 0.0) {
        if (r0 + xi <= 0.0) {
            *a = *g1 = 1.0;
            return r0 + xi;
        }
        xi += r0;
        r0 = 0.0;
    } else if (r0 > f->r_max) {
        const double until = log((r0 - 1.0) / (f->r_max - 1.0));
        if (xi <= until) {
            *a = exp(-xi);
            *g1 = -(r0 - 1.0) * *a;
            return 1.0 - *g1;
        }
        slope = (f->r_max - 1.0) / (r0 - 1.0);
        xi -= until;
        r0 = f->r_max;
    }
    if (r0 + xi <= f->zeta - 20.0 / f->lambda) { /* etaA is 0 within double precision */
        *a = *g1 = 1.0;
        return r0 + xi;
    }
    const double d0 = r0 - f->r_star;
    if (d0 == 0.0) {
        *a = exp(-f->k * xi);
        *g1 = 0.0;
        return r0;
    }
    const double d1 = flow_solve(f, d0, xi);
    *g1 = d1 == 0.0 ? 0.0 : flow_g(f, d1);
    *a = slope * *g1 / flow_g(f, d0);
    return f->r_star + d1;
}

/* phi(x) = 1 + e^-x - 2 (1 - e^-x)/x and its derivative, x >= 0; below 1/2 by the series sum (n - 1)/(n + 1)! (-x)^n. */
static double relaxation(double x, double *derivative)
{
    if (x < 0.5) {
        double phi = 0.0, power = x, factor = 1.0 / 2.0; /* of n = 1: x^n, (-1)^(n + 1) / (n + 1)! */
        *derivative = 0.0;
        for (int n = 2; n <= 14; n++) {
            factor /= -(double)(n + 1);
            const double term = -(double)(n - 1) * factor;
            *derivative += (double)n * term * power;
            power *= x;
            phi += term * power;
        }
        return phi;
    }
    const double decay = exp(-x), rise = -expm1(-x);
    *derivative = -decay + 2.0 * (rise - x * decay) / (x * x);
    return 1.0 + decay - 2.0 * rise / x;
}

/* Steps of a record, as the Plan of integrator.py has them. */
struct plan {
    long long steps, stairs;
    double h;
    const double *start, *end, *cut, *stair, *slide;
    const long long *substeps, *piece_substeps, *stair_substeps;
};

struct work {
    const double *arg[SZ_ARG];
    double *res[SZ_RES];
    long long iw[SZ_IW];
    double w[SZ_W];
};

/* c = a b, a: n x m, b: m x l */
static void multiply(int n, int m, int l, const double *a, const double *b, double *c)
{
    for (int j = 0; j < l; j++)
        for (int i = 0; i < n; i++) {
            double sum = 0.0;
            for (int k = 0; k < m; k++)
                sum += a[k * n + i] * b[j * m + k];
            c[j * n + i] = sum;
        }
}

/* A block on its way through an interval; phi: d(chi)/d(start) (n x n), psi: d(chi)/d(theta) (n x N_P). */
struct part {
    int b, n;
    double chi[LARGEST_BLOCK], phi[LARGEST_BLOCK * LARGEST_BLOCK], psi[LARGEST_BLOCK * N_P];
};

/* After a move with the derivatives J (n x n) in chi and T (n x N_P) in theta. */
static void compose(struct part *part, const double *J, const double *T)
{
    const int n = part->n;
    double product[LARGEST_BLOCK * (LARGEST_BLOCK > N_P ? LARGEST_BLOCK : N_P)];
    multiply(n, n, n, J, part->phi, product);
    memcpy(part->phi, product, sizeof(double) * (size_t)(n * n));
    multiply(n, n, N_P, J, part->psi, product);
    for (int i = 0; i < n * N_P; i++)
        part->psi[i] = product[i] + T[i];
}

/* `count` Runge-Kutta substeps with signals on the line from `start` to `end`. */
static void along(struct part *part, const double *start, const double *end, const double *theta, double h, long long count,
                  struct work *work)
{
    const double step = h / (double)count;
    double next[LARGEST_BLOCK], J[LARGEST_BLOCK * LARGEST_BLOCK], T[LARGEST_BLOCK * N_P];
    for (long long s = 0; s < count; s++) {
        double w0[N_W], w1[N_W];
        for (int i = 0; i < N_W; i++) {
            w0[i] = start[i] + (end[i] - start[i]) * ((double)s / (double)count);
            w1[i] = start[i] + (end[i] - start[i]) * ((double)(s + 1) / (double)count);
        }
        work->arg[0] = part->chi;
        work->arg[1] = w0;
        work->arg[2] = w1;
        work->arg[3] = theta;
        work->arg[4] = &step;
        work->res[0] = next;
        work->res[1] = J;
        work->res[2] = T;
        STEP[part->b](work->arg, work->res, work->iw, work->w, 0);
        memcpy(part->chi, next, sizeof(double) * (size_t)part->n);
        compose(part, J, T);
    }
}

/* After a move in closed form: the element's derivatives are `slope` in itself and `change` in (the other states, theta);
   those states set its level, and reach `end` with the Jacobian `dend` in (themselves, theta). */
static void take_closed_form(struct part *part, double slope, const double *change, const double *end, const double *dend)
{
    const int n = part->n, others = n - 1;
    double J[LARGEST_BLOCK * LARGEST_BLOCK], T[LARGEST_BLOCK * N_P];
    for (int j = 0; j < others + N_P; j++) {
        double *column = j < others ? J + (j + 1) * n : T + (j - others) * n;
        column[0] = change[j];
        for (int i = 0; i < others; i++)
            column[i + 1] = dend[j * others + i];
    }
    J[0] = slope;
    for (int i = 0; i < others; i++) {
        part->chi[i + 1] = end[i];
        J[i + 1] = 0.0;
    }
    compose(part, J, T);
}

/* One jump of the flow over h with constant signals. chi = sign level r: the level's sensitivity enters through r0 and again
   through chi1. The other states of the block set the level; their end and its Jacobians in (those states, theta) come in
   closed form. */
static void jump(struct part *part, const double *w, const double *theta, double h, const struct flow *flow,
                 struct work *work)
{
    const int n = part->n;
    double level, xi, dlevel[LARGEST_BLOCK + N_P], dxi[LARGEST_BLOCK + N_P], change[LARGEST_BLOCK + N_P], slope, g1;
    double end[LARGEST_BLOCK], dend[LARGEST_BLOCK * (LARGEST_BLOCK + N_P)];
    work->arg[0] = part->chi + 1;
    work->arg[1] = w;
    work->arg[2] = theta;
    work->arg[3] = &h;
    work->res[0] = &level;
    work->res[1] = &xi;
    work->res[2] = end;
    work->res[3] = dlevel;
    work->res[4] = dxi;
    work->res[5] = dend;
    FLOW[part->b](work->arg, work->res, work->iw, work->w, 0);
    const double sign = xi < 0.0 ? -1.0 : 1.0;
    const double r0 = sign * part->chi[0] / level;
    const double r1 = flow_advance(flow, r0, sign * xi, &slope, &g1);
    part->chi[0] = sign * level * r1;
    for (int j = 0; j < n - 1 + N_P; j++)
        change[j] = sign * (r1 - slope * r0) * dlevel[j] + level * g1 * dxi[j];
    take_closed_form(part, slope, change, end, dend);
}

/* An element that slides takes a step at once: slide = (displacement, mean level, delta). Returns 0, and leaves the element
   where it is, if it is not near enough to the fixed point. */
static int slid(struct part *part, const double *slide, const double *theta, const struct flow *flow, struct work *work)
{
    const double direction = slide[0] < 0.0 ? -1.0 : 1.0, level = slide[1], delta = slide[2];
    const double r0 = direction * part->chi[0] / level;
    if (!(fabs(r0 - flow->r_star) < NEAR))
        return 0;
    double rho, drho[N_P], T[N_P], slope, g1, dphi;
    work->arg[0] = theta;
    work->res[0] = &rho;
    work->res[1] = drho;
    RATE[part->b](work->arg, work->res, work->iw, work->w, 0);
    const double xi = rho * fabs(slide[0]) / level, x = flow->k * xi;
    const double r1 = flow_advance(flow, r0, xi, &slope, &g1);
    const double lag = flow->r_star * delta * relaxation(x, &dphi);
    part->chi[0] = direction * (level * r1 + lag);
    slope *= exp(-flow->curvature * lag / (level * flow->k));
    for (int j = 0; j < N_P; j++)
        T[j] = direction * (level * g1 * xi + flow->r_star * delta * x * dphi) / rho * drho[j];
    compose(part, &slope, T);
    return 1;
}

/* An element that switches over h: it moves with the displacement of the signals w, but no further in its direction than
   the level at the signals `last` and at the ends of the other states. */
static void clip(struct part *part, const double *w, const double *last, const double *theta, double h, struct work *work)
{
    const int n = part->n;
    double level, move, dlevel[LARGEST_BLOCK + N_P], dmove[LARGEST_BLOCK + N_P], change[LARGEST_BLOCK + N_P];
    double end[LARGEST_BLOCK], dend[LARGEST_BLOCK * (LARGEST_BLOCK + N_P)];
    work->arg[0] = part->chi + 1;
    work->arg[1] = w;
    work->arg[2] = last;
    work->arg[3] = theta;
    work->arg[4] = &h;
    work->res[0] = &level;
    work->res[1] = &move;
    work->res[2] = end;
    work->res[3] = dlevel;
    work->res[4] = dmove;
    work->res[5] = dend;
    CLIP[part->b](work->arg, work->res, work->iw, work->w, 0);
    const double direction = move < 0.0 ? -1.0 : 1.0, moved = part->chi[0] + move;
    const int slips = move != 0.0 && direction * moved > level;
    part->chi[0] = slips ? direction * level : moved;
    for (int j = 0; j < n - 1 + N_P; j++)
        change[j] = slips ? direction * dlevel[j] : dmove[j];
    take_closed_form(part, slips ? 0.0 : 1.0, change, end, dend);
}

/* The same along the line from `start` to `end`, from one fraction of h to another. The level is that at the end of the
   piece; where the velocity changes sign there, that just before. */
static void clip_line(struct part *part, const double *start, const double *end, double from, double to,
                      const double *theta, double h, struct work *work)
{
    const double edge = to < 1.0 ? BEFORE_TURN * to : 1.0;
    double middle[N_W], last[N_W];
    for (int i = 0; i < N_W; i++) {
        middle[i] = start[i] + (end[i] - start[i]) * 0.5 * (from + to);
        last[i] = edge < 1.0 ? start[i] + (end[i] - start[i]) * edge : end[i];
    }
    clip(part, middle, last, theta, h * (to - from), work);
}

/* An element that switches through one step: at once, in two pieces where the velocity turns, or stair by stair. */
static void clip_step(struct part *part, const struct plan *plan, long long k, const double *theta, struct work *work)
{
    const double *start = plan->start + k * N_W, *end = plan->end + k * N_W, share = plan->cut[k];
    const long long at = k * N_BLOCKS + part->b;
    if (plan->substeps[at] > 0) {
        clip_line(part, start, end, 0.0, 1.0, theta, plan->h, work);
    } else if (plan->piece_substeps[2 * at] > 0) {
        clip_line(part, start, end, 0.0, share, theta, plan->h, work);
        clip_line(part, start, end, share, 1.0, theta, plan->h, work);
    } else {
        for (long long i = k * plan->stairs; i < (k + 1) * plan->stairs; i++)
            clip(part, plan->stair + i * N_W, plan->stair + i * N_W, theta, plan->h / (double)plan->stairs, work);
    }
}

/* One block through one step. */
static void step_block(struct part *part, const struct plan *plan, long long k, const struct flow *flow, const double *theta,
                       struct work *work)
{
    if (CLIP[part->b]) {
        clip_step(part, plan, k, theta, work);
        return;
    }
    const double *slide = plan->slide + 3 * k;
    if (RATE[part->b] && slide[0] != 0.0 && slid(part, slide, theta, flow, work))
        return;
    const long long count = plan->substeps[k * N_BLOCKS + part->b];
    if (count > 0) {
        along(part, plan->start + k * N_W, plan->end + k * N_W, theta, plan->h, count, work);
        return;
    }
    const long long *pieces = plan->piece_substeps + 2 * (k * N_BLOCKS + part->b);
    if (pieces[0] > 0) {
        const double *start = plan->start + k * N_W, *end = plan->end + k * N_W, share = plan->cut[k];
        double turn[N_W];
        for (int i = 0; i < N_W; i++)
            turn[i] = start[i] + (end[i] - start[i]) * share;
        along(part, start, turn, theta, plan->h * share, pieces[0], work);
        along(part, turn, end, theta, plan->h * (1.0 - share), pieces[1], work);
        return;
    }
    const double h = plan->h / (double)plan->stairs;
    for (long long i = k * plan->stairs; i < (k + 1) * plan->stairs; i++) {
        const double *w = plan->stair + i * N_W;
        const long long own = plan->stair_substeps[i * N_BLOCKS + part->b];
        if (own > 0)
            along(part, w, w, theta, h, own, work);
        else
            jump(part, w, theta, h, flow, work);
    }
}

/* All states on their way through an interval; phi: d(chi)/d(chi at the start), psi: d(chi)/d(theta). */
struct whole {
    double chi[N_X], phi[N_X * N_X], psi[N_X * N_P];
};

static void put(struct whole *whole, const struct part *part, const long long *state)
{
    const int n = part->n;
    for (int i = 0; i < n; i++) {
        whole->chi[state[i]] = part->chi[i];
        for (int j = 0; j < n; j++)
            whole->phi[state[j] * N_X + state[i]] = part->phi[j * n + i];
        for (int j = 0; j < N_P; j++)
            whole->psi[j * N_X + state[i]] = part->psi[j * n + i];
    }
}

/* Node state and its sensitivities to node state and theta at the start: A = T_x phi F_x, B = T_x (phi F_t + psi) + T_t */
static void as_node(const struct whole *whole, const double *F_x, const double *F_t, const double *theta, double *x,
                    double *A, double *B, struct work *work)
{
    double T_x[N_X * N_X], T_t[N_X * N_P], product[N_X * (N_X > N_P ? N_X : N_P)];
    work->arg[0] = whole->chi;
    work->arg[1] = theta;
    work->res[0] = x;
    work->res[1] = T_x;
    work->res[2] = T_t;
    FINISH(work->arg, work->res, work->iw, work->w, 0);
    multiply(N_X, N_X, N_X, whole->phi, F_x, product);
    multiply(N_X, N_X, N_X, T_x, product, A);
    multiply(N_X, N_X, N_P, whole->phi, F_t, product);
    for (int i = 0; i < N_X * N_P; i++)
        product[i] += whole->psi[i];
    multiply(N_X, N_X, N_P, T_x, product, B);
    for (int i = 0; i < N_X * N_P; i++)
        B[i] += T_t[i];
}

/* Output where x has the sensitivities A, B to node state and theta at the start: y, C A and C B + D. */
static void read_inside(const double *x, const double *A, const double *B, const double *w, const double *theta, double *y,
                        double *by_x, double *by_theta, struct work *work)
{
    double C[N_X], D[N_P];
    work->arg[0] = x;
    work->arg[1] = w;
    work->arg[2] = theta;
    work->res[0] = y;
    work->res[1] = C;
    work->res[2] = D;
    MEASURE(work->arg, work->res, work->iw, work->w, 0);
    multiply(1, N_X, N_X, C, A, by_x);
    multiply(1, N_X, N_P, C, B, by_theta);
    for (int j = 0; j < N_P; j++)
        by_theta[j] += D[j];
}

/* Integrate `count` intervals. first_step: the first step of each; wa, wb: start and end; x: N_X each in, x1, A, B out.
   Inside each lie N_READINGS - 1 readings with signals `inner_w`: y, C (N_X) and D (N_P) of each, by the interval's start. */
void sgms_reference_intervals(long long count, const long long *first_step, long long steps, double h, const double *wa,
                              const double *wb, const long long *substeps, const double *cut,
                              const long long *piece_substeps, long long stairs, const double *stair,
                              const long long *stair_substeps, const double *slide, const double *packed, const double *x,
                              const double *theta, double *x1, double *A, double *B, const double *inner_w, double *inner_y,
                              double *inner_C, double *inner_D)
{
    const struct plan plan = {steps, stairs, h, wa, wb, cut, stair, slide, substeps, piece_substeps, stair_substeps};
    struct work work;
    const struct flow flow = flow_unpack(packed);
    const long long spacing = steps / N_READINGS;
    for (long long l = 0; l < count; l++) {
        const long long k0 = first_step[l];
        double begin[N_X], F_x[N_X * N_X], F_t[N_X * N_P];
        struct whole reached[N_READINGS]; /* at every reading; the last one is at the end */

        work.arg[0] = x + l * N_X;
        work.arg[1] = theta;
        work.res[0] = begin; /* blocks may share states: each starts from here */
        work.res[1] = F_x;
        work.res[2] = F_t;
        START(work.arg, work.res, work.iw, work.w, 0);

        memset(reached, 0, sizeof reached);
        const long long *state = BLOCK_STATES;
        for (int b = 0; b < N_BLOCKS; b++) {
            const int n = (int)BLOCK_SIZE[b];
            struct part part = {.b = b, .n = n};
            for (int i = 0; i < n; i++) {
                part.chi[i] = begin[state[i]];
                part.phi[i * n + i] = 1.0;
            }
            for (long long k = 0; k < plan.steps; k++) {
                step_block(&part, &plan, k0 + k, &flow, theta, &work);
                if ((k + 1) % spacing == 0)
                    put(&reached[(k + 1) / spacing - 1], &part, state);
            }
            state += n;
        }

        for (long long r = 0; r < N_READINGS - 1; r++) {
            const long long at = l * (N_READINGS - 1) + r;
            double x_r[N_X], A_r[N_X * N_X], B_r[N_X * N_P];
            as_node(&reached[r], F_x, F_t, theta, x_r, A_r, B_r, &work);
            read_inside(x_r, A_r, B_r, inner_w + at * N_W, theta, inner_y + at, inner_C + at * N_X, inner_D + at * N_P, &work);
        }
        as_node(&reached[N_READINGS - 1], F_x, F_t, theta, x1 + l * N_X, A + l * N_X * N_X, B + l * N_X * N_P, &work);
    }
}

/* Output at `count` nodes: y, C = dy/dx (N_X each), D = dy/dtheta (N_P each). */
void sgms_reference_outputs(long long count, const double *x, const double *w, const double *theta, double *y, double *C,
                            double *D)
{
    struct work work;
    for (long long l = 0; l < count; l++) {
        work.arg[0] = x + l * N_X;
        work.arg[1] = w + l * N_W;
        work.arg[2] = theta;
        work.res[0] = y + l;
        work.res[1] = C + l * N_X;
        work.res[2] = D + l * N_P;
        MEASURE(work.arg, work.res, work.iw, work.w, 0);
    }
}
