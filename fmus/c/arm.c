/* arm.c - serial arm of 1 to 16 joints; equations in fmus/models/arm.py.
 *
 *     (M(q) + diag J) ddq + C(q, dq) dq + g(q) = tau + tau_ext + tau_h - tau_e - tau_f + tau_s
 *
 * Integrated with the Runge-Kutta method of order 4, `substeps` steps per communication step. All torques
 * are evaluated at every stage.
 */
#include <stddef.h>

#include "chain_check.h"
#include "chain_forward.h"
#include "environment.h"
#include "hyperbolic.h"
#include "model.h"

static const char NO_INERTIA[] = "a joint moves no inertia; mass or armature is needed";

/* tau_f - tau_s, friction and stops. */
static inline Real losses(const Model *x, int i, Real q, Real dq) {
    Real torque = x->damping[i] * dq;
    const Truth rubs = x->friction[i] > 0.0;
    if (ANY(rubs)) {
        const Real friction = x->friction[i] * hyperbolic_tangent(dq / x->v_f[i]);
        torque = PICK(rubs, torque + friction, torque);
    }
    torque += contact(SPRING_DAMPER, q - x->q_max[i], dq, x->k_s[i], x->b_s[i]);
    return torque - contact(SPRING_DAMPER, x->q_min[i] - q, -dq, x->k_s[i], x->b_s[i]);
}

/* ddq, rad/s^2, where `torque` = tau + tau_ext. Returns whether every joint moves an inertia. */
static inline Truth acceleration(const Model *x, const Real *torque, const Real *q,
                               const Real *dq, Real *ddq) {
    const Chain chain = CHAIN_OF(x);
    Real sum[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++)
        sum[i] = torque[i] + hand(x, i, q[i], dq[i]) - wall(x, i, q[i], dq[i]) -
                 losses(x, i, q[i], dq[i]);
    return chain_forward(&chain, q, dq, sum, ddq);
}

/* One step h of the classical method, in place. Returns whether every joint moves an inertia. */
static inline Truth runge_kutta(const Model *x, const Real *torque, double h, Real *q, Real *dq) {
    static const double node[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    Real v[JOINTS], a[JOINTS], p[JOINTS];           /* of this stage; v is the rate of p */
    Real sum_v[JOINTS] = {0}, sum_a[JOINTS] = {0};
    Truth positive = ALWAYS;
    for (int stage = 0; stage < 4; stage++) {
        for (int i = 0; i < COUNT(x, JOINTS); i++) {
            p[i] = stage ? q[i] + node[stage] * h * v[i] : q[i];
            v[i] = stage ? dq[i] + node[stage] * h * a[i] : dq[i];
        }
        positive &= acceleration(x, torque, p, v, a);
        for (int i = 0; i < COUNT(x, JOINTS); i++) {
            sum_v[i] += weight[stage] * v[i];
            sum_a[i] += weight[stage] * a[i];
        }
    }
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        q[i] += h / 6.0 * sum_v[i];
        dq[i] += h / 6.0 * sum_a[i];
    }
    return positive;
}

#if TOGETHER == 1
const char *model_initial(Model *x) {
    static const double still[JOINTS] = {0.0};
    const Chain chain = CHAIN_OF(x);
    const char *problem = chain_problem(&chain);
    double ddq[JOINTS];
    if (problem) return problem;
    if (environment_problem(x)) return environment_problem(x);
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        if (!(x->q_min[i] < x->q_max[i])) return "q_min must be below q_max";
        if (x->k_s[i] > 0.0 && !(x->q[i] >= x->q_min[i] && x->q[i] <= x->q_max[i]))
            return "q is outside the stops q_min and q_max";
    }
    if (!chain_forward(&chain, x->q, still, still, ddq)) return NO_INERTIA;
    return arrive(x, x->q, x->dq);
}

#ifdef EXCHANGE
const char *model_rates(Model *x) {
    double torque[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++) torque[i] = x->tau[i] + x->tau_ext[i];
    const int positive = acceleration(x, torque, x->q, x->dq, x->ddq);
    if (!all_finite(x->ddq, COUNT(x, JOINTS))) return DIVERGED;
    return positive ? arrive(x, x->q, x->dq) : NO_INERTIA;
}
#endif
#endif

const char *model_step(Model *x, double t, double h) {
    const int substeps = (int)COMMON(x->substeps);
    Real torque[JOINTS], q[JOINTS], dq[JOINTS];
    Truth positive = ALWAYS;
    (void)t; /* the arm does not depend on time */
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        torque[i] = x->tau[i] + x->tau_ext[i];
        q[i] = x->q[i];
        dq[i] = x->dq[i];
    }
    for (int i = 0; i < substeps; i++) positive &= runge_kutta(x, torque, h / substeps, q, dq);
    if (!ALL(positive) && all_finite(q, COUNT(x, JOINTS)) && all_finite(dq, COUNT(x, JOINTS))) return NO_INERTIA;
    return arrive(x, q, dq);
}
