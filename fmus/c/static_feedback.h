/* static_feedback.h - shared by the adaptive laws with static feedback, whose reference velocity z is a
 * function of the inputs alone.
 *
 *     tau = Y(q, dq, z, dz) theta_hat + feedback,   dtheta_hat = -Gamma Y^T s,   s = dq - z
 *
 * The estimate for t_k + h is kept in theta_hat_next; it is not adapted while a torque is at its limit.
 * A model includes this file once and defines `refer` and `sliding`; the step is defined here. The arm is planar,
 * or with SERIAL_ARM one with a table (chain.h), whose known gravity and rotors belong to tau. With
 * DYNAMIC_REFERENCE the reference z is a state: `refer` takes it from z_next, and the step advances
 * it by dz, or leaves it as well while a torque is at its limit.
 */
#ifndef STATIC_FEEDBACK_H
#define STATIC_FEEDBACK_H

#include <stddef.h>

#include "limit.h"
#include "model.h"
#ifdef SERIAL_ARM
#include "chain_check.h"
#include "chain_law.h"
#else
#include "regressor.h"
#endif

enum { JOINTS = ENTRIES(q), PARAMETERS = ENTRIES(theta_hat) };
#define PARAMETERS_OF(x) (PARAMETERS * COUNT(x, JOINTS) / JOINTS)

typedef struct {
    Real z[JOINTS], dz[JOINTS], feedback[JOINTS]; /* by the model */
    Real s[JOINTS], tau[JOINTS], Ys[PARAMETERS];  /* by complete() */
    Truth saturated;
} Law;

#ifdef SERIAL_ARM
static inline void feedforward(const Model *x, const Real *theta_hat, Law *y, Real *tau)
{
    const Chain chain = CHAIN_OF(x);
    Pose pose[CHAIN_MOST];
    chain_pose(&chain, x->q, pose);
    chain_feedforward(&chain, pose, (int)COMMON(x->gravity), theta_hat, x->dq, y->z, y->dz, y->s, tau, y->Ys);
}
#else
/* tau = Y theta_hat, Ys = Y^T s. */
static inline void feedforward(const Model *x, const Real *theta_hat, Law *y, Real *tau)
{
    const Regressor Y = regressor(x->q, x->dq, y->z, y->dz);
    torque_of(&Y, theta_hat, tau);
    transposed_times(&Y, y->s, y->Ys);
}
#endif

/* The sum over the neighbours of own - received for joint i; `received` has a row for each of them. */
static inline Real disagreement(Real own, const Real *received, int neighbours, int i)
{
    Real sum = own - received[i];
    for (int j = 1; j < neighbours; j++) sum += own - received[JOINTS * j + i];
    return sum;
}

/* Neighbours whose signal arrives at the input `port`: (n,), or (neighbours, n) for several. */
#define NEIGHBOURS(port) (ENTRIES(port) / JOINTS)
/* The same, and its mean, of the variable `own` and the input `port` of a model `x`. */
#define DISAGREEMENT(own, port, i) disagreement((own), (const Real *)x->port, NEIGHBOURS(port), (i))
#define MEAN_DISAGREEMENT(own, port, i) (DISAGREEMENT(own, port, i) / (double)NEIGHBOURS(port))

/* Defined by the model: z, dz and feedback, from inputs and parameters. */
static void refer(const Model *x, Law *y);
/* Defined by the model: its output (n,) that contains s. */
static Real *sliding(Model *x);

/* Compute all outputs from z, dz and feedback. NULL, or a message if a value is not finite. */
static const char *complete(const Model *x, const Real *theta_hat, Law *y)
{
    Real tau[JOINTS];
    refer(x, y);
    for (int i = 0; i < COUNT(x, JOINTS); i++) y->s[i] = x->dq[i] - y->z[i];
    feedforward(x, theta_hat, y, tau);
    y->saturated = NEVER;
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        tau[i] += y->feedback[i];
        y->tau[i] = limited(tau[i], x->tau_max[i]);
        y->saturated |= y->tau[i] != tau[i];
    }
    if (!all_finite(y->tau, COUNT(x, JOINTS)) || !all_finite(y->s, COUNT(x, JOINTS)) ||
        !all_finite(y->Ys, PARAMETERS_OF(x)))
        return "the law left the range of numbers (|q| <= 1e6 rad): the motion or the estimate"
               " diverged";
    return NULL;
}

static void give(Model *x, const Law *y)
{
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        x->tau[i] = y->tau[i];
        sliding(x)[i] = y->s[i];
    }
}

#if TOGETHER == 1
/* NULL, or a message that says why the arm is physically impossible. */
static const char *problem(const Model *x)
{
#ifdef SERIAL_ARM
    const Chain chain = CHAIN_OF(x);
    return chain_problem(&chain);
#else
    return (void)x, NULL;
#endif
}

const char *model_initial(Model *x)
{
    Law y;
    const double *theta_hat = (const double *)x->theta_hat;
    double *next = (double *)x->theta_hat_next;
    const char *why = problem(x);
    if (why != NULL) return why;
#ifdef DYNAMIC_REFERENCE
    for (int i = 0; i < COUNT(x, JOINTS); i++) x->z_next[i] = x->z[i];
#endif
    why = complete(x, theta_hat, &y);
    if (why != NULL) return why;
    give(x, &y);
    for (int i = 0; i < PARAMETERS_OF(x); i++) next[i] = theta_hat[i];
    return NULL;
}
#endif

/* Output the estimate for t_k, and keep the one for t_k + h. */
const char *model_step(Model *x, double t, double h)
{
    Law y;
    const Real *Gamma = (const Real *)x->Gamma;
    Real *theta_hat = (Real *)x->theta_hat, *next = (Real *)x->theta_hat_next;
    (void)t; /* the law does not depend on time */
    const char *why = complete(x, next, &y);
    if (why != NULL) return why;
    give(x, &y);
    const Real advance = PICK(y.saturated, 0.0, h); /* anti-windup */
    for (int i = 0; i < PARAMETERS_OF(x); i++) {
        theta_hat[i] = next[i];
        next[i] -= advance * Gamma[i] * y.Ys[i];
    }
#ifdef DYNAMIC_REFERENCE
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        x->z[i] = y.z[i];
        x->z_next[i] += advance * y.dz[i];
    }
#endif
    return NULL;
}

#endif
