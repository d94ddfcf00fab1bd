/* friction.c - viscous and smooth dry friction of each joint.
 *
 *     tau = -damping dq - friction tanh(dq / v_f)
 */
#include <stddef.h>

#include "hyperbolic.h"
#include "model.h"

enum { JOINTS = ENTRIES(dq) };

const char *model_initial(Model *x)
{
    double tau[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++)
        tau[i] = -x->damping[i] * x->dq[i] - x->friction[i] * hyperbolic_tangent(x->dq[i] / x->v_f[i]);
    if (!all_finite(tau, COUNT(x, JOINTS))) return "the torque left the range of numbers";
    for (int i = 0; i < COUNT(x, JOINTS); i++) x->tau[i] = tau[i];
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
