/* model.h - what a model is to the layers above it, and what it has to provide.
 *
 * A model's variables lie in one struct of doubles, `Model`, generated with `variables.h` from the
 * model's declaration; `variables.c`, generated too, describes them. A model knows no FMI.
 */
#ifndef MODEL_H
#define MODEL_H

#include <math.h>

#include "variables.h"

/* Clang contracts a*b + c to one rounding where the processor can; every build must round twice. */
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

/* Calculate what follows from start values, parameters and inputs; may be called repeatedly.
 * NULL, or a sentence why the values cannot be. */
const char *model_initial(Model *x);

/* Go from time t by one step h (s), h > 0. NULL, or a sentence why not; then nothing changed. */
const char *model_step(Model *x, double t, double h);

/* The FMI type of a variable and what may be done with it; bits of `Variable.access`. */
enum {
    IS_REAL = 1,
    IS_INTEGER = 2,
    IS_BOOLEAN = 4,
    SET_AT_START = 8,   /* before and in Initialization Mode: parameters, inputs, start values */
    SET_IN_STEPS = 16,  /* between steps: inputs */
    IS_CALCULATED = 32, /* by model_initial */
    IS_PARAMETER = 64
};

typedef struct {
    const char *name;
    unsigned char access;
    unsigned offset, size; /* scalars, in Model */
    double minimum, maximum;
} Variable;

typedef struct {
    unsigned first, size; /* scalars, in Model */
} Range;

/* The entry after the last variable is the time. */
extern const Variable variables[N_VARIABLES + 1];
extern const unsigned char scalar_access[N_SCALARS + 1];
extern const double start_values[N_SCALARS];
extern const char *const scalar_names[N_SCALARS + 1];
extern const Range input_ranges[N_INPUT_RANGES + 1];

/* Whether n values are numbers and finite. */
static inline int all_finite(const double *values, unsigned n) {
    int finite = 1;
    for (unsigned i = 0; i < n; i++) finite &= values[i] - values[i] == 0.0;
    return finite;
}

#endif
