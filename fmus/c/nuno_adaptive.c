/* nuno_adaptive.c - adaptive synchronisation of positions; equations in
 * fmus/models/nuno_adaptive.py.
 *
 *     tau = Y(q, dq, -lambda e, -lambda de) theta_hat - K epsilon - B de
 *     dtheta_hat = -Gamma Y^T epsilon,   e = q - q_j,   epsilon = dq + lambda e
 */
#include "model.h"
#include "static_feedback.h"

static const char *law(const Model *x, const double theta_hat[3], Law *y) {
    for (int i = 0; i < 2; i++) {
        const double de = x->dq[i] - x->dq_j[i];
        y->z[i] = -x->lambda * (x->q[i] - x->q_j[i]);
        y->dz[i] = -x->lambda * de;
        y->feedback[i] = -x->K[i] * (x->dq[i] - y->z[i]) - x->B[i] * de;
    }
    return complete(x, theta_hat, y);
}

static void give(Model *x, const Law *y) {
    for (int i = 0; i < 2; i++) {
        x->tau[i] = y->tau[i];
        x->epsilon[i] = y->s[i];
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
