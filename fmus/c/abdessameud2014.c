/* abdessameud2014.c - adaptive consensus with a filter of second order as reference; equations in
 * fmus/models/abdessameud2014.py.
 *
 *     tau = -K s + Y(q, dq, z, dz) theta_hat,   dtheta_hat = -Gamma Y^T s,   s = dq - z
 *     dz = -k_d z - k_p e,   e = mean over the neighbours of q - q_j
 */
#define DYNAMIC_REFERENCE 1
#include "static_feedback.h"

static void refer(const Model *x, Law *y)
{
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        y->z[i] = x->z_next[i];
        y->dz[i] = -x->k_d * y->z[i] - x->k_p * MEAN_DISAGREEMENT(x->q[i], q_j, i);
        y->feedback[i] = -x->K[i] * (x->dq[i] - y->z[i]);
    }
}

static Real *sliding(Model *x) { return x->s; }
