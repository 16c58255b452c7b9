/* Runs pairs of doubles (position [m], force [N]) of a file through two estimators, one task and two, and prints the
 * last friction. To be built with sanitizers, together with estimator_probe.c. */
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

size_t probe_size(void);
int probe_numbers(void);
void probe_init(void *self);
void probe_reset(void *self);
double probe_tick(void *self, double position, double force);
double probe_sample(void *self, double position, double force);
int probe_due(const void *self);
int probe_feedback(void *self);
void probe_prepare(void *self);
int probe_estimate(const void *self, double *numbers);

int main(int argc, char **argv)
{
    void *const ticked = malloc(probe_size());
    void *const tasks = malloc(probe_size());
    double *const numbers = malloc((size_t)probe_numbers() * sizeof(double));
    FILE *const file = argc == 2 ? fopen(argv[1], "rb") : NULL;
    double sample[2];
    long k = 0;
    if (!file || !ticked || !tasks || !numbers) {
        return 2;
    }
    probe_init(ticked);
    probe_init(tasks);
    while (fread(sample, sizeof sample, 1, file) == 1) {
        (void)probe_tick(ticked, sample[0], sample[1]);
        (void)probe_sample(tasks, sample[0], sample[1]);
        if (probe_due(tasks)) {
            (void)probe_feedback(tasks);
            probe_prepare(tasks);
            (void)probe_estimate(tasks, numbers);
        }
        if (++k == 9000) {
            probe_reset(ticked);
            probe_reset(tasks);
        }
    }
    (void)probe_estimate(ticked, numbers);
    printf("%ld %.17g\n", k, numbers[0]);
    fclose(file);
    free(ticked);
    free(tasks);
    free(numbers);
    return 0;
}
