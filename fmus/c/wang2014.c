/* wang2014.c - adaptive consensus with static feedback; equations in fmus/models/wang2014.py.
 *
 *     tau = -K s + Y(q, dq, z, dz) theta_hat,   dtheta_hat = -Gamma Y^T s,   s = dq - z
 *     z = -lambda (q - q_j)
 */
#include "model.h"
#include "static_feedback.h"

static const char *law(const Model *x, const double theta_hat[3], Law *y) {
    for (int i = 0; i < 2; i++) {
        y->z[i] = -x->lambda * (x->q[i] - x->q_j[i]);
        y->dz[i] = -x->lambda * (x->dq[i] - x->dq_j[i]);
        y->feedback[i] = -x->K[i] * (x->dq[i] - y->z[i]);
    }
    return complete(x, theta_hat, y);
}

static void give(Model *x, const Law *y) {
    for (int i = 0; i < 2; i++) {
        x->tau[i] = y->tau[i];
        x->s[i] = y->s[i];
    }
}

const char *model_initial(Model *x) {
    Law y;
    const char *why = law(x, x->theta_hat, &y);
    if (why != NULL) return why;
    give(x, &y);
    start_estimate(x);
    return NULL;
}

const char *model_step(Model *x, double t, double h) {
    Law y;
    (void)t; /* the law does not depend on time */
    const char *why = law(x, x->theta_hat_next, &y);
    if (why != NULL) return why;
    give(x, &y);
    advance_estimate(x, &y, h);
    return NULL;
}
