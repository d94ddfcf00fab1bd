/* arm_teleoperation.c - the adaptive law of the paper for a serial arm; equations in
 * fmus/models/arm_teleoperation.py, in the coordinates of the tip in fmus/models/arm_task.py.
 *
 *     tau = -K s + Y(q, dq, v, a) theta_hat + J a,  dtheta_hat = -Gamma Y^T s,  s = dq - v
 *
 * with the reference velocity v and a = dv/dt. In joint space
 *
 *     v = z,  dz = -alpha dq + lambda_M (dq - z) - lambda sum_j w_j (xi - xi_in_j)
 *
 * The law is sampled: the outputs are those of t_k. The state for t_k + h is kept in z_next and
 * theta_hat_next until the next step.
 *
 * The declaration of the model defines NETWORKED (neighbours.h) and TASK: 1, z has the coordinates of
 * the tip, 0: those of the joints.
 */
#include <stddef.h>

#include "chain_check.h"
#include "chain_law.h"
#include "limit.h"
#include "model.h"
#include "natural.h"
#include "neighbours.h"

enum { JOINTS = ENTRIES(q), STATES = ENTRIES(z) };

#if TASK
#define STATES_OF(x) STATES
#else
#define STATES_OF(x) COUNT(x, STATES)
#endif

typedef struct {
    Real xi[STATES], dz[STATES], v[JOINTS], a[JOINTS], s[JOINTS], feedback[JOINTS];
    Real tau[JOINTS], Ys[10 * JOINTS];
    Real x[STATES], sigma; /* of a task */
    Truth saturated, stale;
} Law;

/* refer() computes xi, dz, v, a, s and the feedback of s, of the state z. */
#if TASK
#include "arm_task.h"
#else
static inline void refer(const Model *x, const Chain *chain, const Pose *pose, const Real *z, Law *y)
{
    (void)chain, (void)pose;
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        y->xi[i] = x->dq[i] + x->alpha * x->q[i];
        y->v[i] = z[i];
        y->s[i] = x->dq[i] - z[i];
        y->dz[i] = -x->alpha * x->dq[i] + x->lambda_M * y->s[i] - coupling(x, i, y->xi[i]);
        y->a[i] = y->dz[i];
        y->feedback[i] = x->K[i] * y->s[i];
    }
}
static inline void give_task(Model *x, const Law *y) { (void)x, (void)y; }
static inline const char *task_problem(const Model *x) { return (void)x, NULL; }
static inline void begin_task(Model *x) { (void)x; }
#endif

/* The law as of t_k, with the state z, theta_hat. */
static inline void law(const Model *x, const Real *z, const Real *theta_hat, Law *y)
{
    const Chain chain = CHAIN_OF(x);
    const Truth inertial = x->lambda_c > 0.0; /* Remark 3: K = lambda_c M_hat, inside Y */
    Pose pose[CHAIN_MOST];
    Real a[JOINTS], tau[JOINTS];
    chain_pose(&chain, x->q, pose);
    refer(x, &chain, pose, z, y);
    for (int i = 0; i < COUNT(x, JOINTS); i++)
        a[i] = PICK(inertial, y->a[i] - x->lambda_c * y->s[i], y->a[i]);
    chain_feedforward(&chain, pose, (int)COMMON(x->gravity), theta_hat, x->dq, y->v, a, y->s, tau, y->Ys);
    y->saturated = NEVER;
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        tau[i] = PICK(inertial, tau[i], tau[i] - y->feedback[i]);
        y->tau[i] = limited(tau[i], x->tau_max[i]);
        y->saturated |= y->tau[i] != tau[i];
    }
    y->stale = any_stale(x);
}

static inline int finite_law(const Model *x, const Law *y)
{
    return all_finite(y->tau, COUNT(x, JOINTS)) && all_finite(y->xi, STATES_OF(x)) &&
           all_finite(y->s, COUNT(x, JOINTS)) && all_finite(y->dz, STATES_OF(x)) &&
           all_finite(y->Ys, 10 * COUNT(x, JOINTS));
}

static inline void give(Model *x, const Law *y)
{
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        x->tau[i] = y->tau[i];
        x->s[i] = y->s[i];
    }
    for (int i = 0; i < STATES_OF(x); i++) x->xi[i] = y->xi[i];
    give_task(x, y);
}

#if TOGETHER == 1
/* Checks of values that depend on several variables, which a minimum or maximum cannot express. */
static inline const char *check(const Model *x)
{
    const Chain chain = CHAIN_OF(x);
    const char *problem = chain_problem(&chain);
    if (problem) return problem;
    if (task_problem(x)) return task_problem(x);
    for (int i = 0; i < COUNT(x, JOINTS); i++)
        for (int k = 0; k < 10; k++)
            if (!(x->theta_min[i][k] <= x->theta_hat[i][k] && x->theta_hat[i][k] <= x->theta_max[i][k]))
                return "theta_hat starts outside of theta_min ... theta_max";
#if NETWORKED
    if (!(x->alpha > 0.0)) return "alpha must be more than 0 with neighbours: positions would not agree";
#endif
    for (int i = 0; i < COUNT(x, JOINTS); i++)
        if (x->natural > 0.0 && !(x->theta_hat[i][0] > 0.0 && is_body(x->theta_hat[i])))
            return "theta_hat starts with a link that is no body; natural adaptation needs bodies";
    if (!(x->gravity >= NO_GRAVITY && x->gravity <= ADAPTED)) return "gravity must be 0, 1 or 2";
    return NULL;
}

const char *model_initial(Model *x)
{
    Law y;
    const char *why = check(x);
    if (why != NULL) return why;
    begin_task(x);
    law(x, x->z, x->theta_hat[0], &y);
    if (!finite_law(x, &y)) return LAW_DIVERGED;
    give(x, &y);
    for (int i = 0; i < STATES_OF(x); i++) x->z_next[i] = x->z[i];
    for (int i = 0; i < COUNT(x, JOINTS); i++)
        for (int k = 0; k < 10; k++) x->theta_hat_next[i][k] = x->theta_hat[i][k];
    return NULL;
}
#endif

/* Take over theta_hat of link i for t_k, and compute the one for t_k + h. */
static inline void adapt_link(Model *x, int i, const Real *Ys, Real h)
{
    Real *next = x->theta_hat_next[i], moved[10];
    const Truth natural = x->natural > 0.0;
    for (int k = 0; k < 10; k++) {
        x->theta_hat[i][k] = next[k];
        moved[k] = next[k];
        next[k] -= h * x->Gamma[i][k] * Ys[k];
    }
    if (ANY(natural)) natural_step(moved, Ys, h * x->natural);
    for (int k = 0; k < 10; k++)
        next[k] = clipped(PICK(natural, moved[k], next[k]), x->theta_min[i][k], x->theta_max[i][k]);
}

const char *model_step(Model *x, double t, double h)
{
    Law y;
    (void)t; /* the law does not depend on time */
    law(x, x->z_next, x->theta_hat_next[0], &y);
    if (!finite_law(x, &y)) return LAW_DIVERGED;
    give(x, &y);
    const Real advance = PICK(y.saturated, 0.0, h); /* anti-windup */
    const Real adapt = PICK(y.stale, 0.0, advance);
    for (int i = 0; i < STATES_OF(x); i++) {
        x->z[i] = x->z_next[i];
        x->z_next[i] += advance * y.dz[i];
    }
    for (int i = 0; i < COUNT(x, JOINTS); i++) adapt_link(x, i, y.Ys + 10 * i, adapt);
    return NULL;
}
