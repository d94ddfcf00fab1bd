/* kernel.c - the model without FMI: the same machine code, for callers that step the struct directly.
 *
 * `x` points to kernel_size() doubles in the order of the declaration. The functions return NULL
 * or a message; they have no state of their own and allocate no memory.
 */
#include <stddef.h>
#include <string.h>

#include "export.h"
#include "declaration.h"

EXPORT size_t kernel_size(void) { return declared.n_scalars; }

/* How many instances it can step at once. */
EXPORT size_t kernel_lanes(void) { return declared.lanes == NULL ? 1 : declared.lanes(); }

/* All start values. */
EXPORT void kernel_reset(double *x) { memcpy(x, start_values, declared.n_scalars * sizeof *x); }

/* Outputs at the start, from parameters, start values and inputs; may be called repeatedly. */
EXPORT const char *kernel_initial(double *x) { return model_initial((Model *)x); }

/* One step h > 0 from t, both in s; if a message is returned, nothing has changed. */
EXPORT const char *kernel_step(double *x, double t, double h)
{
    if (!(h > 0.0 && h - h == 0.0)) return "the step is not a positive finite number";
    for (unsigned i = 0; i < declared.n_input_ranges; i++)
        if (!all_finite(x + input_ranges[i].first, input_ranges[i].size))
            return "an input is not a finite number";
    return model_step((Model *)x, t, h);
}
