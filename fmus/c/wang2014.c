/* wang2014.c - adaptive consensus with static feedback; equations in fmus/models/wang2014.py.
 *
 *     tau = -K s + Y(q, dq, z, dz) theta_hat,   dtheta_hat = -Gamma Y^T s,   s = dq - z
 *     z = -lambda sum over the neighbours of q - q_j
 */
#include "static_feedback.h"

static void refer(const Model *x, Law *y)
{
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        y->z[i] = -x->lambda * DISAGREEMENT(x->q[i], q_j, i);
        y->dz[i] = -x->lambda * DISAGREEMENT(x->dq[i], dq_j, i);
        y->feedback[i] = -x->K[i] * (x->dq[i] - y->z[i]);
    }
}

static Real *sliding(Model *x) { return x->s; }
