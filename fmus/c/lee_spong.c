/* lee_spong.c - a spring and a damper to the delayed position of the other arm, and dissipation for the delay.
 *
 *     tau = -K_v (dq - dq_j) - (K_d + P_eps) dq - K_p (q - q_j)
 */
#include "limit.h"
#include "model.h"

enum { JOINTS = ENTRIES(q) };

const char *model_initial(Model *x)
{
    double tau[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        const double coupling = -x->K_v[i] * (x->dq[i] - x->dq_j[i]) - x->K_p[i] * (x->q[i] - x->q_j[i]);
        const double dissipation = -(x->K_d[i] + x->P_eps[i]) * x->dq[i];
        tau[i] = limited(coupling + dissipation, x->tau_max[i]);
    }
    return give_torques(tau, x->tau, COUNT(x, JOINTS));
}

const char *model_step(Model *x, double t, double h)
{
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
