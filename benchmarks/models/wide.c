/* wide.c - fourteen signals through, with a gain; equations in benchmarks/models/wide.py. */
#include <stddef.h>

#include "model.h"

enum { N = 14 };

const char *model_initial(Model *x)
{
    (void)x; /* y is a start value */
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    double y[N];
    (void)t, (void)h;
    for (int i = 0; i < N; i++) y[i] = x->gain * x->u[i];
    if (!all_finite(y, N)) return "an output left the range of numbers";
    for (int i = 0; i < N; i++) x->y[i] = y[i];
    return NULL;
}
