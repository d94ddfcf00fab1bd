/* pd.c - a spring and a damper to the delayed motion of the other arm.
 *
 *     tau = -K_p (q - q_j) - K_d (dq - dq_j)
 */
#include "limit.h"
#include "model.h"

enum { JOINTS = ENTRIES(q) };

const char *model_initial(Model *x)
{
    double tau[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++)
        tau[i] =
            limited(-x->K_p[i] * (x->q[i] - x->q_j[i]) - x->K_d[i] * (x->dq[i] - x->dq_j[i]), x->tau_max[i]);
    return give_torques(tau, x->tau, COUNT(x, JOINTS));
}

const char *model_step(Model *x, double t, double h)
{
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
