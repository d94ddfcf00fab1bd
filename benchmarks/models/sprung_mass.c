/* sprung_mass.c - a mass with springs and dampers; equations in benchmarks/models/sprung_mass.py. */
#include <stddef.h>

#include "model.h"

static double acceleration(const Model *x, double s, double v)
{
    return (x->force - x->k * s - x->d * v + x->k_c * (x->s_in - s) + x->d_c * (x->v_in - v)) / x->m;
}

static void give(Model *x) { x->reaction = x->k_c * (x->s - x->s_in) + x->d_c * (x->v - x->v_in); }

const char *model_initial(Model *x)
{
    give(x);
    return x->m > 0.0 ? NULL : "m must be more than 0";
}

/* Four steps of the Runge-Kutta method of order 4. */
const char *model_step(Model *x, double t, double h)
{
    double s = x->s, v = x->v;
    (void)t;
    h *= 0.25;
    for (int i = 0; i < 4; i++) {
        const double a1 = acceleration(x, s, v), v1 = v;
        const double v2 = v + 0.5 * h * a1, a2 = acceleration(x, s + 0.5 * h * v1, v2);
        const double v3 = v + 0.5 * h * a2, a3 = acceleration(x, s + 0.5 * h * v2, v3);
        const double v4 = v + h * a3, a4 = acceleration(x, s + h * v3, v4);
        s += h / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4);
        v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4);
    }
    if (!(s - s == 0.0 && v - v == 0.0)) return "the mass left the range of numbers";
    x->s = s, x->v = v;
    give(x);
    return NULL;
}
