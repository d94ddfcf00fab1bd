/* static_feedback.h - what adaptive laws with static feedback share: those whose reference velocity
 * z follows from the inputs alone.
 *
 *     tau = Y(q, dq, z, dz) theta_hat + feedback,   dtheta_hat = -Gamma Y^T s,   s = dq - z
 *
 * The estimate of t_k + h waits in theta_hat_next; while a torque is at its limit it stands still.
 * A model includes this once, and says `refer` and `sliding`; its step is here. With
 * DYNAMIC_REFERENCE the reference z is a state: `refer` takes it from z_next, and the step advances
 * it by dz, or leaves it as well while a torque is at its limit.
 */
#ifndef STATIC_FEEDBACK_H
#define STATIC_FEEDBACK_H

#include <stddef.h>

#include "limit.h"
#include "regressor.h"

typedef struct {
    double z[2], dz[2], feedback[2]; /* by the model */
    double s[2], tau[2], Ys[3];      /* by complete() */
    int saturated;
} Law;

/* The sum over the neighbours of own - received for joint i; `received` has a row for each of them. */
static inline double disagreement(double own, const double *received, int neighbours, int i) {
    double sum = own - received[i];
    for (int j = 1; j < neighbours; j++) sum += own - received[2 * j + i];
    return sum;
}

/* Neighbours whose signal arrives at the input `port`: (2,), or (neighbours, 2) for several. */
#define NEIGHBOURS(port) (ENTRIES(port) / 2)
/* The same, and its mean, of the variable `own` and the input `port` of a model `x`. */
#define DISAGREEMENT(own, port, i) \
    disagreement((own), (const double *)x->port, NEIGHBOURS(port), (i))
#define MEAN_DISAGREEMENT(own, port, i) (DISAGREEMENT(own, port, i) / NEIGHBOURS(port))

/* By the model: z, dz and feedback, from inputs and parameters. */
static void refer(const Model *x, Law *y);
/* By the model: the output (2,) that is s, whatever it is called there. */
static double *sliding(Model *x);

/* Everything that follows from z, dz and feedback; NULL, or a sentence why it is no number. */
static const char *complete(const Model *x, const double theta_hat[3], Law *y) {
    refer(x, y);
    const Regressor Y = regressor(x->q, x->dq, y->z, y->dz);
    double feedforward[2];
    torque_of(&Y, theta_hat, feedforward);
    y->saturated = 0;
    for (int i = 0; i < 2; i++) {
        const double tau = feedforward[i] + y->feedback[i];
        y->s[i] = x->dq[i] - y->z[i];
        y->tau[i] = limited(tau, x->tau_max[i]);
        y->saturated |= y->tau[i] != tau;
    }
    transposed_times(&Y, y->s, y->Ys);
    if (!all_finite(y->tau, 2) || !all_finite(y->s, 2) || !all_finite(y->Ys, 3))
        return "the law left the range of numbers (|q| <= 1e6 rad): the motion or the estimate"
               " diverged";
    return NULL;
}

static void give(Model *x, const Law *y) {
    for (int i = 0; i < 2; i++) {
        x->tau[i] = y->tau[i];
        sliding(x)[i] = y->s[i];
    }
}

const char *model_initial(Model *x) {
    Law y;
#ifdef DYNAMIC_REFERENCE
    for (int i = 0; i < 2; i++) x->z_next[i] = x->z[i];
#endif
    const char *why = complete(x, x->theta_hat, &y);
    if (why != NULL) return why;
    give(x, &y);
    for (int i = 0; i < 3; i++) x->theta_hat_next[i] = x->theta_hat[i];
    return NULL;
}

/* The estimate of t_k becomes the output, that of t_k + h waits. */
const char *model_step(Model *x, double t, double h) {
    Law y;
    (void)t; /* the law does not depend on time */
    const char *why = complete(x, x->theta_hat_next, &y);
    if (why != NULL) return why;
    give(x, &y);
    const double advance = y.saturated ? 0.0 : h; /* anti-windup */
    for (int i = 0; i < 3; i++) {
        x->theta_hat[i] = x->theta_hat_next[i];
        x->theta_hat_next[i] -= advance * x->Gamma[i] * y.Ys[i];
    }
#ifdef DYNAMIC_REFERENCE
    for (int i = 0; i < 2; i++) {
        x->z[i] = y.z[i];
        x->z_next[i] += advance * y.dz[i];
    }
#endif
    return NULL;
}

#endif
