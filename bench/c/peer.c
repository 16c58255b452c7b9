/* Residual and Jacobian of estimation problems by functions that CasADi exported: the peer of the benchmark.
 *
 *     peer PROBLEMS RESULTS     doubles of every problem, one after the other; the results likewise
 *
 * Prints the microseconds of every problem. Compiled behind the exported functions and these constants: PEER_SIGNALS,
 * PEER_X, PEER_P (states, parameters), PEER_INTERVALS, PEER_STEPS (of an interval), PEER_A, PEER_B, PEER_C, PEER_D
 * (nonzeros of the sensitivities of an interval and of an output), PEER_ARG, PEER_RES, PEER_IW, PEER_W (largest work
 * vectors) and PEER_WHOLE: 1 where one function gives it all, PEER_JACOBIAN its nonzeros.
 *
 * A problem: nodes (PEER_INTERVALS + 1) x PEER_X, theta, PEER_SIGNALS signals of every step, of every node, outputs
 * measured. A result: defects, output residuals, then nonzeros: the Jacobian's, or A and B of every interval, C and D
 * of every node. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum {
    SIGNALS = PEER_SIGNALS,
    NODES = PEER_INTERVALS + 1,
    VARIABLES = NODES * PEER_X + PEER_P,
    PROBLEM = VARIABLES + SIGNALS * PEER_INTERVALS * PEER_STEPS + SIGNALS * NODES + NODES,
    RESIDUAL = PEER_INTERVALS * PEER_X + NODES,
#if PEER_WHOLE
    RESULT = RESIDUAL + PEER_JACOBIAN
#else
    RESULT = RESIDUAL + PEER_INTERVALS * (PEER_A + PEER_B) + NODES * (PEER_C + PEER_D)
#endif
};

/* All of one problem, kept a call of its own: profilers toggle on this name. */
void peer_update(const double *problem, double *result);

static double work[PEER_W + 1];
static casadi_int integers[PEER_IW + 1];

#if PEER_WHOLE

void peer_update(const double *problem, double *result)
{
    const double *arg[PEER_ARG] = {
        problem, problem + VARIABLES, problem + VARIABLES + SIGNALS * PEER_INTERVALS * PEER_STEPS,
        problem + PROBLEM - NODES};
    double *res[PEER_RES] = {result, result + RESIDUAL};
    whole(arg, res, integers, work, 0);
}

#else

/* Deflections with their sensitivities within an interval. */
typedef struct {
    double chi[PEER_X], a[PEER_A + 1], b[PEER_B + 1];
} moving;

void peer_update(const double *problem, double *result)
{
    const double *theta = problem + NODES * PEER_X;
    const double *step_signals = problem + VARIABLES;
    const double *node_signals = step_signals + SIGNALS * PEER_INTERVALS * PEER_STEPS;
    const double *measured = node_signals + SIGNALS * NODES;
    double *a = result + RESIDUAL;
    double *b = a + PEER_INTERVALS * PEER_A;
    double *c = b + PEER_INTERVALS * PEER_B;
    double *d = c + NODES * PEER_C;
    for (int k = 0; k < PEER_INTERVALS; k++) {
        const double *node = problem + k * PEER_X;
        const double *arg[PEER_ARG] = {node, theta};
        moving state[2];
        double *res[PEER_RES] = {state[0].chi, state[0].a, state[0].b};
        const moving *from = state;
        begin(arg, res, integers, work, 0);
        for (int s = 0; s < PEER_STEPS; s++, step_signals += SIGNALS) {
            moving *to = &state[(s + 1) % 2];
            const double *step_arg[PEER_ARG] = {from->chi, from->a, from->b, step_signals, theta};
            double *step_res[PEER_RES] = {to->chi, to->a, to->b};
            step(step_arg, step_res, integers, work, 0);
            from = to;
        }
        {
            const double *end_arg[PEER_ARG] = {from->chi, from->a, from->b, theta, node + PEER_X};
            double *end_res[PEER_RES] = {result + k * PEER_X, a + k * PEER_A, b + k * PEER_B};
            finish(end_arg, end_res, integers, work, 0);
        }
    }
    for (int k = 0; k < NODES; k++) {
        const double *arg[PEER_ARG] = {problem + k * PEER_X, node_signals + k * SIGNALS, theta, measured + k};
        double *res[PEER_RES] = {result + PEER_INTERVALS * PEER_X + k, c + k * PEER_C, d + k * PEER_D};
        measure(arg, res, integers, work, 0);
    }
}

#endif

static double now_us(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

int main(int argc, char **argv)
{
    static double problem[PROBLEM], result[RESULT];
    /* Through a pointer that the compiler may not see through, so that the call stays a call. */
    void (*volatile update)(const double *, double *) = peer_update;
    FILE *problems = argc == 3 ? fopen(argv[1], "rb") : NULL;
    FILE *results = problems ? fopen(argv[2], "wb") : NULL;
    if (!results) {
        fprintf(stderr, "peer: a readable file of problems and a file for the results are needed\n");
        return 2;
    }
    while (fread(problem, sizeof problem, 1, problems) == 1) {
        const double start = now_us();
        update(problem, result);
        printf("%.3f\n", now_us() - start);
        if (fwrite(result, sizeof result, 1, results) != 1) {
            fprintf(stderr, "peer: %s: cannot be written\n", argv[2]);
            return 2;
        }
    }
    fclose(problems);
    return fclose(results) == 0 ? 0 : 2;
}
