/* pointmass.c - a point mass with viscous friction; equations in fmus/models/pointmass.py.
 *
 *     m ddx + (b + b_add) dx = f,   exact for f and b_add held over the step
 */
#include <stddef.h>

#include "model.h"

/* E = exp z, phi1 = (E - 1) / z and phi2 = (phi1 - 1) / z for z <= 0, without cancellation: a
 * series where |z| <= 1/2, and from there by doubling. */
static inline void exponential(double z, double *E, double *phi1, double *phi2) {
    int doublings = 0;
    while (z < -0.5) {
        z *= 0.5;
        doublings++;
    }
    double p = 1.0;
    for (int k = 16; k > 2; k--) p = 1.0 + z * p / k;
    *phi2 = 0.5 * p;
    *phi1 = 1.0 + z * *phi2;
    *E = 1.0 + z * *phi1;
    for (; doublings > 0; doublings--) {
        *phi2 = 0.25 * (*phi1 * *phi1) + 0.5 * *phi2;
        *phi1 *= 0.5 * (1.0 + *E);
        *E *= *E;
    }
}

const char *model_initial(Model *x) {
    if (!(x->m > 0.0)) return "m must be more than 0";
    return NULL;
}

#ifdef EXCHANGE
const char *model_rates(Model *x) {
    const double b = x->b + x->b_add;
    if (b < 0.0) return "b + b_add is negative: friction must take energy";
    const double ddx = (x->f - b * x->dx) / x->m;
    if (!all_finite(&ddx, 1)) return "the motion left the range of numbers";
    x->ddx = ddx;
    return NULL;
}
#endif

const char *model_step(Model *x, double t, double h) {
    const double b = x->b + x->b_add, z = -b / x->m * h;
    double E, phi1, phi2;
    (void)t; /* the mass does not depend on time */
    if (b < 0.0) return "b + b_add is negative: friction must take energy";
    if (!all_finite(&z, 1)) return "b h / m exceeds the range of float64";
    exponential(z, &E, &phi1, &phi2);
    const double ddx = x->f / x->m;
    const double y[2] = {x->x + h * (phi1 * x->dx + h * phi2 * ddx), E * x->dx + h * phi1 * ddx};
    if (!all_finite(y, 2)) return "the motion left the range of numbers";
    x->x = y[0];
    x->dx = y[1];
    return NULL;
}
