/* operator.c - a hand that holds the robot with a spring and a damper.
 *
 *     tau_h = -k_d dq - k_p (q - q_h)
 */
#include <stddef.h>

#include "model.h"

const char *model_initial(Model *x) {
    double tau_h[2];
    for (int i = 0; i < 2; i++)
        tau_h[i] = -x->k_d[i] * x->dq[i] - x->k_p[i] * (x->q[i] - x->q_h[i]);
    if (!all_finite(tau_h, 2)) return "the torque left the range of numbers";
    for (int i = 0; i < 2; i++) x->tau_h[i] = tau_h[i];
    return NULL;
}

const char *model_step(Model *x, double t, double h) {
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
