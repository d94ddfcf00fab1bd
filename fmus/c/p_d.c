/* p_d.c - a spring to the other arm as it was, a damper to the ground.
 *
 *     tau = -K (q - q_j) - B dq
 */
#include <stddef.h>

#include "limit.h"
#include "model.h"

enum { JOINTS = ENTRIES(q) };

const char *model_initial(Model *x) {
    double tau[JOINTS];
    for (int i = 0; i < JOINTS; i++)
        tau[i] = limited(-x->K[i] * (x->q[i] - x->q_j[i]) - x->B[i] * x->dq[i], x->tau_max[i]);
    if (!all_finite(tau, JOINTS)) return "the torque left the range of numbers";
    for (int i = 0; i < JOINTS; i++) x->tau[i] = tau[i];
    return NULL;
}

const char *model_step(Model *x, double t, double h) {
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
