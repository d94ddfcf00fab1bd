/* kernel.c - steps a model from its start values with inputs that change, and prints a digest of all values
 * at all steps. A model that can step several instances at once does so as well, and must have the same;
 * a step that one can do must be done at once.
 */
#include <stdio.h>

#include "declaration.h"
#include "digest.h"

/* Of steps.c, lanes_4.c and lanes_8.c; not there without a step for several. */
#pragma weak model_lanes
#pragma weak wide_steps_4
#pragma weak wide_steps_8
size_t wide_steps_4(double *const x[], const double t[], size_t m, double h);
size_t wide_steps_8(double *const x[], const double t[], size_t m, double h);

enum { STEPS = 10000, SIZE = 4096, EACH = 7 };

static double values[1 + WIDEST][SIZE];

/* Inputs are `by` * number() more than they were. */
static void change_inputs(double by)
{
    for (unsigned i = 0; i < declared.n_input_ranges; i++)
        for (unsigned k = 0; k < input_ranges[i].size; k++)
            values[0][input_ranges[i].first + k] += by * number();
}

/* Whether a step of equal instances is not left to be done one by one. */
static int done_at_once(const double *before, size_t bytes, double t)
{
    double *some[WIDEST];
    const size_t lanes = model_lanes();

    for (int k = 0; k < WIDEST; k++) memcpy(some[k] = values[1 + k], before, bytes);
    return lanes == 1 || (lanes == 8 ? wide_steps_8 : wide_steps_4)(some, &t, 1, 1e-3);
}

/* Whether n instances at once do what one does, which returned `expected`. */
static int lanes_agree(size_t n, double t, size_t bytes, const double *before, const char *expected)
{
    Model *some[WIDEST];
    const char *why[WIDEST];
    size_t made[WIDEST];

    for (size_t k = 0; k < n; k++) {
        memcpy(values[1 + k], before, bytes);
        some[k] = (Model *)values[1 + k];
    }
    declared.steps(some, n, &t, 1, 1e-3, made, why);
    for (size_t k = 0; k < n; k++)
        if (why[k] != expected || memcmp(values[1 + k], values[0], bytes)) return 0;
    return 1;
}

int main(void)
{
    static double before[SIZE], start[SIZE];
    const size_t bytes = declared.n_scalars * sizeof(double);
    const char *why;

    if (declared.n_scalars > SIZE) return 2;
    memcpy(values[0], start_values, bytes);
    why = model_initial((Model *)values[0]);
    if (why != 0) return puts(why), 1;
    memcpy(start, values[0], bytes);
    for (int i = 0; i < STEPS; i++) {
        const double t = i * 1e-3;
        if (i % EACH == 0) change_inputs(0.25);
        memcpy(before, values[0], bytes);
        why = model_step((Model *)values[0], t, 1e-3);
        take(values[0], declared.n_scalars);
        if (declared.steps != 0 && why == 0 && !done_at_once(before, bytes, t))
            return puts("steps at once are left to be done one by one"), 1;
        for (size_t n = 3; declared.steps != 0 && n <= WIDEST; n += WIDEST - 3)
            if (!lanes_agree(n, t, bytes, before, why)) return puts("lanes differ"), 1;
        if (why != 0) memcpy(values[0], start, bytes); /* with these inputs it cannot go on */
    }
    printf("%016llx\n", (unsigned long long)digest);
    return 0;
}
