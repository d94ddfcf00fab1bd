/* kernel.c - steps a model from its start values with inputs that change, and prints a digest of all values
 * at all steps. A model that can step several instances at once does so as well, and must have the same.
 */
#include <stdio.h>

#include "declaration.h"
#include "digest.h"

enum { STEPS = 4000, SIZE = 4096, EACH = 7 };

static double values[1 + LANES][SIZE];

/* Inputs are `by` * number() more than they were. */
static void change_inputs(double by)
{
    for (unsigned i = 0; i < declared.n_input_ranges; i++)
        for (unsigned k = 0; k < input_ranges[i].size; k++)
            values[0][input_ranges[i].first + k] += by * number();
}

/* Whether LANES instances at once do what one does. */
static int lanes_agree(double t, size_t bytes, const double *before)
{
    Model *some[LANES];
    const char *why[LANES];

    for (int k = 0; k < LANES; k++) {
        memcpy(values[1 + k], before, bytes);
        some[k] = (Model *)values[1 + k];
    }
    declared.steps(some, t, 1e-3, why);
    for (int k = 0; k < LANES; k++)
        if (memcmp(values[1 + k], values[0], bytes)) return 0;
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
        if (declared.steps != 0 && !lanes_agree(t, bytes, before)) return puts("lanes differ"), 1;
        if (why != 0) memcpy(values[0], start, bytes); /* with these inputs it cannot go on */
    }
    printf("%016llx\n", (unsigned long long)digest);
    return 0;
}
