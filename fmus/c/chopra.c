/* chopra.c - adaptive synchronisation of r = dq + lambda q; equations in fmus/models/chopra.py.
 *
 *     tau = Y(q, dq, -lambda q, -lambda dq) theta_hat - K sum over the neighbours of r - r_j
 *     dtheta_hat = -Gamma Y^T r
 */
#include "static_feedback.h"

static void refer(const Model *x, Law *y)
{
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        y->z[i] = -x->lambda * x->q[i];
        y->dz[i] = -x->lambda * x->dq[i];
        y->feedback[i] = -x->K[i] * DISAGREEMENT(x->dq[i] - y->z[i], r_j, i);
    }
}

static Real *sliding(Model *x) { return x->r; }
