/* chopra.c - adaptive synchronisation of r = dq + lambda q; equations in fmus/models/chopra.py.
 *
 *     tau = Y(q, dq, -lambda q, -lambda dq) theta_hat + K (r_j - r)
 *     dtheta_hat = -Gamma Y^T r
 */
#include "model.h"
#include "static_feedback.h"

static const char *law(const Model *x, const double theta_hat[3], Law *y) {
    for (int i = 0; i < 2; i++) {
        y->z[i] = -x->lambda * x->q[i];
        y->dz[i] = -x->lambda * x->dq[i];
        y->feedback[i] = x->K[i] * (x->r_j[i] - (x->dq[i] - y->z[i]));
    }
    return complete(x, theta_hat, y);
}

static void give(Model *x, const Law *y) {
    for (int i = 0; i < 2; i++) {
        x->tau[i] = y->tau[i];
        x->r[i] = y->s[i];
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
