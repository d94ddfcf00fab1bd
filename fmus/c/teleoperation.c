/* teleoperation.c - adaptive controller with dynamic feedback; equations (76)-(81) of the paper,
 * in fmus/models/teleoperation.py.
 *
 *     tau = -K s + Y(q, dq, z, dz) theta_hat,   dtheta_hat = -Gamma Y^T s,   s = dq - z
 *     dz  = -alpha dq + lambda_M (dq - z) - lambda sum_j w_j (xi - xi_in_j)
 *
 * Sampled: outputs as of t_k; the state of t_k + h waits in z_next, theta_hat_next.
 */
#include <stddef.h>

#include "model.h"
#include "trig.h"

enum { NEIGHBOURS = sizeof((Model *)0)->w / sizeof(double) };

typedef struct {
    double xi[2], dz[2], s[2], tau[2];
    double Ys[3]; /* Y^T s */
    int saturated;
} Law;

static inline double limited(double tau, double limit) {
    return tau > limit ? limit : tau < -limit ? -limit : tau;
}

/* The law as of t_k, with the state z, theta_hat. */
static inline void law(const Model *x, const double z[2], const double theta_hat[3], Law *y) {
    const double *q = x->q, *dq = x->dq;
    for (int i = 0; i < 2; i++) {
        y->xi[i] = dq[i] + x->alpha * q[i];
        double consensus = 0.0;
        for (int j = 0; j < NEIGHBOURS; j++) consensus += x->w[j] * (y->xi[i] - x->xi_in[j][i]);
        y->dz[i] = -x->alpha * dq[i] + x->lambda_M * (dq[i] - z[i]) - x->lambda * consensus;
        y->s[i] = dq[i] - z[i];
    }
    double s2, c2;
    sine_cosine(q[1], &s2, &c2);
    const double *dz = y->dz, *s = y->s;
    const double Y12 =
        c2 * (2.0 * dz[0] + dz[1]) - s2 * (dq[1] * z[0] + (dq[0] + dq[1]) * z[1]);
    const double Y22 = c2 * dz[0] + s2 * dq[0] * z[0];
    const double Y23 = dz[0] + dz[1];
    const double tau[2] = {
        -x->K[0] * s[0] + dz[0] * theta_hat[0] + Y12 * theta_hat[1] + dz[1] * theta_hat[2],
        -x->K[1] * s[1] + Y22 * theta_hat[1] + Y23 * theta_hat[2]};
    y->Ys[0] = dz[0] * s[0];
    y->Ys[1] = Y12 * s[0] + Y22 * s[1];
    y->Ys[2] = dz[1] * s[0] + Y23 * s[1];
    for (int i = 0; i < 2; i++) y->tau[i] = limited(tau[i], x->tau_max[i]);
    y->saturated = y->tau[0] != tau[0] || y->tau[1] != tau[1];
}

static inline int finite_law(const Law *y) {
    return all_finite(y->tau, 2) && all_finite(y->xi, 2) && all_finite(y->s, 2) &&
           all_finite(y->dz, 2) && all_finite(y->Ys, 3);
}

static inline void give(Model *x, const Law *y) {
    for (int i = 0; i < 2; i++) {
        x->tau[i] = y->tau[i];
        x->xi[i] = y->xi[i];
        x->s[i] = y->s[i];
    }
}

static const char DIVERGED[] =
    "the law left the range of numbers (|q| <= 1e6 rad): the motion or the estimate diverged";

const char *model_initial(Model *x) {
    Law y;
    law(x, x->z, x->theta_hat, &y);
    if (!finite_law(&y)) return DIVERGED;
    give(x, &y);
    for (int i = 0; i < 2; i++) x->z_next[i] = x->z[i];
    for (int i = 0; i < 3; i++) x->theta_hat_next[i] = x->theta_hat[i];
    return NULL;
}

const char *model_step(Model *x, double t, double h) {
    Law y;
    (void)t; /* the law does not depend on time */
    law(x, x->z_next, x->theta_hat_next, &y);
    if (!finite_law(&y)) return DIVERGED;
    give(x, &y);
    const double advance = y.saturated ? 0.0 : h; /* anti-windup */
    for (int i = 0; i < 2; i++) {
        x->z[i] = x->z_next[i];
        x->z_next[i] += advance * y.dz[i];
    }
    for (int i = 0; i < 3; i++) {
        x->theta_hat[i] = x->theta_hat_next[i];
        x->theta_hat_next[i] -= advance * x->Gamma[i] * y.Ys[i];
    }
    return NULL;
}
