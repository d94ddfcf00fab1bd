/* pointmass.c - a point mass with viscous friction; equations in fmus/models/pointmass.py.
 *
 *     m ddx + (b + b_add) dx = f,   exact for f and b_add held over the step
 */
#include <stddef.h>

#include "model.h"

/* E = exp z, phi1 = (E - 1) / z and phi2 = (phi1 - 1) / z for z <= 0, without cancellation: a
 * series where |z| <= 1/2, and from there by doubling. */
static inline void exponential(Real z, Real *E, Real *phi1, Real *phi2)
{
    const Real given = z;
    while (ANY(z < -0.5)) z = PICK(z < -0.5, z * 0.5, z);
    Real p = REAL(1.0);
    for (int k = 16; k > 2; k--) p = 1.0 + z * p / (double)k;
    *phi2 = 0.5 * p;
    *phi1 = 1.0 + z * *phi2;
    *E = 1.0 + z * *phi1;
    for (; ANY(z != given); z = PICK(z != given, z * 2.0, z)) {
        const Truth doubles = z != given;
        *phi2 = PICK(doubles, 0.25 * (*phi1 * *phi1) + 0.5 * *phi2, *phi2);
        *phi1 = PICK(doubles, *phi1 * (0.5 * (1.0 + *E)), *phi1);
        *E = PICK(doubles, *E * *E, *E);
    }
}

#if TOGETHER == 1
const char *model_initial(Model *x)
{
    if (!(x->m > 0.0)) return "m must be more than 0";
    return NULL;
}

#ifdef EXCHANGE
const char *model_rates(Model *x)
{
    const double b = x->b + x->b_add;
    if (b < 0.0) return "b + b_add is negative: friction must take energy";
    const double ddx = (x->f - b * x->dx) / x->m;
    if (!all_finite(&ddx, 1)) return "the motion left the range of numbers";
    x->ddx = ddx;
    return NULL;
}
#endif
#endif

const char *model_step(Model *x, double t, double h)
{
    const Real b = x->b + x->b_add, z = -b / x->m * h;
    Real E, phi1, phi2;
    (void)t; /* the mass does not depend on time */
    if (ANY(b < 0.0)) return "b + b_add is negative: friction must take energy";
    if (!all_finite(&z, 1)) return "b h / m exceeds the range of float64";
    exponential(z, &E, &phi1, &phi2);
    const Real ddx = x->f / x->m;
    const Real y[2] = {x->x + h * (phi1 * x->dx + h * phi2 * ddx), E * x->dx + h * phi1 * ddx};
    if (!all_finite(y, 2)) return "the motion left the range of numbers";
    x->x = y[0];
    x->dx = y[1];
    return NULL;
}
