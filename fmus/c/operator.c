/* operator.c - a hand that holds the robot with a spring and a damper.
 *
 *     tau_h = -k_d dq - k_p (q - q_h)
 */
#include "model.h"

enum { JOINTS = ENTRIES(q) };

const char *model_initial(Model *x)
{
    double tau_h[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++)
        tau_h[i] = -x->k_d[i] * x->dq[i] - x->k_p[i] * (x->q[i] - x->q_h[i]);
    return give_torques(tau_h, x->tau_h, JOINTS);
}

const char *model_step(Model *x, double t, double h)
{
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
