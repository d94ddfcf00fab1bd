/* wave_impedance.c - the end of a wave line that takes motion and gives torque.
 *
 *     tau = -F,   F = b dq - v,   u = b dq + F
 */
#include <stddef.h>

#include "limit.h"
#include "model.h"

enum { JOINTS = ENTRIES(dq) };

const char *model_initial(Model *x)
{
    double F[JOINTS], u[JOINTS];
    for (int i = 0; i < JOINTS; i++) {
        F[i] = limited(x->b[i] * x->dq[i] - x->v[i], x->tau_max[i]);
        u[i] = x->v[i] + 2.0 * F[i]; /* = b dq + F with the F of no limit */
    }
    if (!all_finite(F, JOINTS) || !all_finite(u, JOINTS)) return "the wave left the range of numbers";
    for (int i = 0; i < JOINTS; i++) {
        x->tau[i] = -F[i];
        x->u[i] = u[i];
    }
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
