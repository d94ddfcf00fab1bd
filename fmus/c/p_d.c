/* p_d.c - a spring to the delayed position of the other arm, and a damper to the ground.
 *
 *     tau = -K (q - q_j) - B dq
 */
#include "limit.h"
#include "model.h"

enum { JOINTS = ENTRIES(q) };

const char *model_initial(Model *x)
{
    double tau[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++)
        tau[i] = limited(-x->K[i] * (x->q[i] - x->q_j[i]) - x->B[i] * x->dq[i], x->tau_max[i]);
    return give_torques(tau, x->tau, COUNT(x, JOINTS));
}

const char *model_step(Model *x, double t, double h)
{
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
