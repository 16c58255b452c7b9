/* Self-test of a package with one output of its calls spoilt. Reads lines of output, way to call the axis (-1: any) and
 * fault; prints for each the self-test's answer (-1: it crashed or did not end), and how often the output was another
 * one. Included, behind the number of OUTPUTS, by the calls that stand between self-test and package. */
#ifndef SPOIL_H
#define SPOIL_H
#define _DEFAULT_SOURCE

#include <stdio.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include "package.h"

enum { TICK, SAMPLE, INSERT, WAYS };
enum { SIGN, ZERO, HALF, LATE, FAULTS };
enum { SECONDS = 20 };

enum { ANY = -1 };
static int way, chosen_way, chosen_output, chosen_fault;
static int changed; /* outputs that were others */

static int is_chosen(int output)
{
    return output == chosen_output && (way == chosen_way || chosen_way == ANY);
}

/* The number handed out in place of one. */
static double spoil(int output, double value, int is_whole)
{
    static double before[OUTPUTS];
    const double half = is_whole ? (double)((long)value / 2) : 0.5 * value;
    const double faults[FAULTS] = {-value, 0.0, half, before[output]};
    const double other = faults[chosen_fault];
    before[output] = value;
    if (!is_chosen(output)) {
        return value;
    }
    changed += other < value || other > value;
    return other;
}

static const char *spoil_text(int output, const char *text)
{
    static const char *before[OUTPUTS];
    const char *const earlier = before[output];
    before[output] = text;
    if (!is_chosen(output)) {
        return text;
    }
    changed += chosen_fault == ZERO || earlier != text;
    return chosen_fault == ZERO ? NULL : earlier;
}

/* The checksum (CRC-32) that data with a fault have, but for one of the checksum itself. */
static void seal(machine_saved *saved, int checksum)
{
    const unsigned char *const bytes = (const unsigned char *)saved;
    uint32_t sum = UINT32_C(0xffffffff);
    if (is_chosen(checksum) || !changed) {
        return;
    }
    for (size_t i = offsetof(machine_saved, format); i < sizeof *saved; i++) {
        sum ^= bytes[i];
        for (int bit = 0; bit < 8; bit++) {
            sum = (sum >> 1) ^ ((sum & 1u) != 0u ? UINT32_C(0xedb88320) : 0u);
        }
    }
    saved->checksum = ~sum;
}

int main(void)
{
    int *const answers = mmap(NULL, 2 * sizeof(int), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (answers == MAP_FAILED) {
        return 1;
    }
    while (scanf("%d %d %d", &chosen_output, &chosen_way, &chosen_fault) == 3) {
        int status = 0;
        const pid_t child = fork();
        if (child == 0) {
            (void)alarm(SECONDS);
            answers[0] = CALL(selftest)();
            answers[1] = changed;
            _exit(0);
        }
        if (child < 0 || waitpid(child, &status, 0) != child) {
            return 1;
        }
        if (!WIFEXITED(status)) {
            answers[0] = -1;
        }
        printf("%d %d\n", answers[0], answers[1]);
        (void)fflush(stdout);
    }
    return 0;
}

#endif
