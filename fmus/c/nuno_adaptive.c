/* nuno_adaptive.c - adaptive synchronisation of positions; equations in
 * fmus/models/nuno_adaptive.py.
 *
 *     tau = Y(q, dq, -lambda e, -lambda de) theta_hat - K epsilon - B de
 *     dtheta_hat = -Gamma Y^T epsilon,   epsilon = dq + lambda e
 *     e = mean over the neighbours of q - q_j
 */
#include "static_feedback.h"

static void refer(const Model *x, Law *y)
{
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        const Real de = MEAN_DISAGREEMENT(x->dq[i], dq_j, i);
        y->z[i] = -x->lambda * MEAN_DISAGREEMENT(x->q[i], q_j, i);
        y->dz[i] = -x->lambda * de;
        y->feedback[i] = -x->K[i] * (x->dq[i] - y->z[i]) - x->B[i] * de;
    }
}

static Real *sliding(Model *x) { return x->epsilon; }
