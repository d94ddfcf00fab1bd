/* vdp.c - driven Van der Pol oscillator; equations in benchmarks/models/vdp.py. */
#include <stddef.h>

#include "model.h"

const char *model_initial(Model *x)
{
    (void)x; /* x and v are start values */
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    (void)t;
    const double a = x->mu * (1.0 - x->x * x->x) * x->v - x->omega2 * x->x + x->gain * x->u;
    const double next[2] = {x->x + h * x->v, x->v + h * a};
    if (!all_finite(next, 2)) return "the oscillator diverged";
    x->x = next[0];
    x->v = next[1];
    return NULL;
}
