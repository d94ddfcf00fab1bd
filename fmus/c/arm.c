/* arm.c - serial arm of 1 to 16 joints; equations in fmus/models/arm.py.
 *
 *     (M(q) + diag J) ddq + C(q, dq) dq + g(q) = tau + tau_ext + tau_h - tau_e - tau_f + tau_s
 *
 * Integrated with the Runge-Kutta method of order 4, `substeps` steps per communication step, or more where
 * friction and stops need them. All torques are evaluated at every stage.
 */
#include <stddef.h>

#include "chain_check.h"
#include "chain_forward.h"
#include "environment.h"
#include "hyperbolic.h"
#include "model.h"
#include "stiff.h"

static const char NO_INERTIA[] = "a joint moves no inertia; mass or armature is needed";
static const char TOO_STIFF[] =
    "damping, friction / v_f, k_s or b_s of a joint are too great for its inertia: more than 1000 steps of the"
    " integrator in a step; a greater v_f or armature, or a shorter step is needed";

/* tau_f - tau_s, friction and stops. */
static inline Real losses(const Model *x, int i, Real q, Real dq)
{
    Real torque = x->damping[i] * dq;
    const Truth rubs = x->friction[i] > 0.0;
    if (ANY(rubs)) {
        const Real friction = x->friction[i] * hyperbolic_tangent(dq / x->v_f[i]);
        torque = PICK(rubs, torque + friction, torque);
    }
    const Real b_s = PICK(x->k_s[i] > 0.0, x->b_s[i], 0.0);
    torque += contact(SPRING_DAMPER, q - x->q_max[i], dq, x->k_s[i], b_s);
    return torque - contact(SPRING_DAMPER, x->q_min[i] - q, -dq, x->k_s[i], b_s);
}

/* ddq, rad/s^2, where `torque` = tau + tau_ext. Returns whether every joint moves an inertia. */
static inline Truth acceleration(const Model *x, const Real *torque, const Real *q, const Real *dq, Real *ddq)
{
    const Chain chain = CHAIN_OF(x);
    Real sum[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++)
        sum[i] = torque[i] + hand(x, i, q[i], dq[i]) - wall(x, i, q[i], dq[i]) - losses(x, i, q[i], dq[i]);
    return chain_forward(&chain, q, dq, sum, ddq);
}

static inline Real root(Real x)
{
#if TOGETHER == 1
    return x > 0.0 ? square_root(x) : 0.0;
#else
    return root_of_depth(x);
#endif
}

/* Steps of the method in h that damping d and stiffness k over inertia need, 1/s and 1/s^2: no rate is
 * faster than (d + sqrt(d^2 + 4 k)) / 2. */
static inline Real steps_for(const Model *x, Real d, Real k, double h)
{
    const Real steps = 0.5 * (d + root(d * d + 4.0 * k)) * h / BEARABLE;
#if TOGETHER == 1
    return whole(steps, x->substeps);
#else
    Real found = {0.0};
    for (int lane = 0; lane < TOGETHER; lane++) found[lane] = whole(steps[lane], x->substeps[lane]);
    return found;
#endif
}

/* Steps of the method in h in which friction and stops are stable: at least `substeps`. With the inertia M
 * at q, no rate is greater than the trace of M^-1 diag(gain); the rotors alone bound it, too. */
static inline Real steps_in(const Model *x, const Real *q, double h)
{
    static const Real none[JOINTS];
    Chain still = CHAIN_OF(x);
    Real gain[JOINTS], slow = {0.0}, stiff = {0.0}, d = {0.0}, k = {0.0};
    Truth free = ALWAYS, rotors = ALWAYS, moves = ALWAYS;
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        const Truth stops = x->k_s[i] > 0.0;
        gain[i] = x->damping[i] + x->friction[i] / x->v_f[i] + PICK(stops, x->b_s[i], 0.0);
        free &= (gain[i] <= 0.0) & (x->k_s[i] <= 0.0);
        rotors &= x->armature[i] > 0.0;
        slow += gain[i] / x->armature[i];
        stiff += x->k_s[i] / x->armature[i];
    }
    const Real few = REAL(x->substeps);
    const Truth easy = free | (rotors & (steps_for(x, slow, stiff, h) == few));
    if (ALL(easy)) return few;
    still.g = none;
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        Real push[JOINTS] = {0}, ddq[JOINTS];
        push[i] = REAL(1.0);
        moves &= chain_forward(&still, q, none, push, ddq);
        d += gain[i] * ddq[i];
        k += x->k_s[i] * ddq[i];
    }
    return PICK(easy | (moves == NEVER), few, steps_for(x, d, k, h));
}

/* One step h of the classical method, in place. Returns whether every joint moves an inertia. */
static inline Truth runge_kutta(const Model *x, const Real *torque, Real h, Real *q, Real *dq)
{
    static const double node[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    Real v[JOINTS], a[JOINTS], p[JOINTS]; /* of this stage; v is the rate of p */
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
const char *model_initial(Model *x)
{
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
const char *model_rates(Model *x)
{
    double torque[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++) torque[i] = x->tau[i] + x->tau_ext[i];
    const int positive = acceleration(x, torque, x->q, x->dq, x->ddq);
    if (!all_finite(x->ddq, COUNT(x, JOINTS))) return DIVERGED;
    return positive ? arrive(x, x->q, x->dq) : NO_INERTIA;
}
#endif
#endif

/* Steps of the method over h, in place; those instances of several that need fewer wait for the others.
 * Returns whether every joint moves an inertia. */
static inline Truth integrate(const Model *x, const Real *torque, Real steps, double h, Real *q, Real *dq)
{
    Truth positive = ALWAYS;
    for (int n = 0; ANY(steps > (double)n); n++) {
        const Truth goes = steps > (double)n;
        Real p[JOINTS], v[JOINTS];
        for (int i = 0; i < COUNT(x, JOINTS); i++) p[i] = q[i], v[i] = dq[i];
        positive &= runge_kutta(x, torque, h / steps, p, v) | (goes == NEVER);
        for (int i = 0; i < COUNT(x, JOINTS); i++) {
            q[i] = PICK(goes, p[i], q[i]);
            dq[i] = PICK(goes, v[i], dq[i]);
        }
    }
    return positive;
}

const char *model_step(Model *x, double t, double h)
{
    Real torque[JOINTS], q[JOINTS], dq[JOINTS];
    (void)t; /* the arm does not depend on time */
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        torque[i] = x->tau[i] + x->tau_ext[i];
        q[i] = x->q[i];
        dq[i] = x->dq[i];
    }
    const Real steps = steps_in(x, q, h);
    if (ANY(steps < 0.0)) return TOO_STIFF;
    const Truth positive = integrate(x, torque, steps, h, q, dq);
    if (!ALL(positive) && all_finite(q, COUNT(x, JOINTS)) && all_finite(dq, COUNT(x, JOINTS)))
        return NO_INERTIA;
    return arrive(x, q, dq);
}
