/* elastic_joint.c - a joint under a drive in MIT mode, with an elastic gear and an elastic stand.
 *
 *     J ddq = tau - damping dq - friction tanh(dq / v_f) - tau_g
 *     M (ddq_l + ddphi) = tau_g + tau_ext         tau_g = -k_g e - d_g de,   q_l = q + e
 *     M_s ddphi = -k_s phi - d_s dphi - tau_g
 *
 * Equations in fmus/models/elastic_joint.py. Joints do not depend on each other.
 */
#include <stddef.h>

#include "hyperbolic.h"
#include "limit.h"
#include "model.h"
#include "stiff.h"

enum { JOINTS = ENTRIES(q), Q = 0, DQ, E, DE, PHI, DPHI, STATE };

static double dry(double torque, double dq, double v)
{
    return torque > 0.0 ? torque * hyperbolic_tangent(dq / v) : 0.0;
}

/* tau of joint i at the position q and velocity dq. */
static double motor(const Model *x, int i, double q, double dq)
{
    const double friction = dry(x->F_c[i], x->dq_c[i], x->v_c[i]) + x->F_v[i] * x->dq_c[i];
    const double spring = x->K_p[i] * (x->q_d[i] - q) + x->K_d[i] * (x->dq_d[i] - dq);
    return limited(spring + friction, x->tau_max[i]);
}

/* The derivative of the state y of joint i. */
static void rate(const Model *x, int i, const double y[STATE], double dy[STATE])
{
    const double J = x->J[i], M = x->M[i], M_s = x->M_s[i], tau_ext = x->tau_ext[i];
    const int stand = x->k_s[i] > 0.0;
    const double driven =
        motor(x, i, y[Q], y[DQ]) - x->damping[i] * y[DQ] - dry(x->friction[i], y[DQ], x->v_f[i]);
    const double yields = -x->k_s[i] * y[PHI] - x->d_s[i] * y[DPHI];
    dy[Q] = y[DQ];
    dy[PHI] = stand ? y[DPHI] : 0.0;
    if (x->k_g[i] > 0.0) {
        const double tau_g = -x->k_g[i] * y[E] - x->d_g[i] * y[DE];
        dy[DQ] = (driven - tau_g) / J;
        dy[DPHI] = stand ? (yields - tau_g) / M_s : 0.0;
        dy[E] = y[DE];
        dy[DE] = (tau_g + tau_ext) / M - dy[DPHI] - dy[DQ];
        return;
    }
    dy[E] = dy[DE] = 0.0;
    const double own = driven + tau_ext, base = yields + tau_ext;
    const double common = (J + M) * (M_s + M) - M * M;
    dy[DQ] = stand ? ((M_s + M) * own - M * base) / common : own / (J + M);
    dy[DPHI] = stand ? ((J + M) * base - M * own) / common : 0.0;
}

/* The state y of joint i a time h later, by one step of the classical Runge-Kutta method. */
static void runge_kutta(const Model *x, int i, double h, double y[STATE])
{
    static const double node[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    double k[STATE] = {0.0}, sum[STATE] = {0.0};
    for (int stage = 0; stage < 4; stage++) {
        double at[STATE];
        for (int j = 0; j < STATE; j++) at[j] = y[j] + node[stage] * h * k[j];
        rate(x, i, at, k);
        for (int j = 0; j < STATE; j++) sum[j] += weight[stage] * k[j];
    }
    for (int j = 0; j < STATE; j++) y[j] += h / 6.0 * sum[j];
}

/* Set the outputs to the states y of the joints; or return a message and change nothing. */
static const char *arrive(Model *x, double y[JOINTS][STATE])
{
    double tau[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        tau[i] = motor(x, i, y[i][Q], y[i][DQ]);
        if (!all_finite(y[i], STATE) || !all_finite(&tau[i], 1))
            return "the motion left the range of numbers: diverged, or the step is too long";
    }
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        x->q[i] = y[i][Q], x->dq[i] = y[i][DQ];
        x->e[i] = y[i][E], x->de[i] = y[i][DE];
        x->phi[i] = y[i][PHI], x->dphi[i] = y[i][DPHI];
        x->tau[i] = tau[i];
    }
    return NULL;
}

/* The state of joint i; what is rigid does not move. */
static void state(const Model *x, int i, double y[STATE])
{
    const int gear = x->k_g[i] > 0.0, stand = x->k_s[i] > 0.0;
    y[Q] = x->q[i], y[DQ] = x->dq[i];
    y[E] = gear ? x->e[i] : 0.0, y[DE] = gear ? x->de[i] : 0.0;
    y[PHI] = stand ? x->phi[i] : 0.0, y[DPHI] = stand ? x->dphi[i] : 0.0;
}

const char *model_initial(Model *x)
{
    double y[JOINTS][STATE];
    if (!(x->substeps >= 1.0)) return "substeps must be at least 1";
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        if (!(x->M[i] > 0.0)) return "M must be more than 0";
        if (x->k_g[i] > 0.0 && !(x->J[i] > 0.0)) return "J must be more than 0 with an elastic gear";
        if (x->k_s[i] > 0.0 && !(x->M_s[i] > 0.0)) return "M_s must be more than 0 with an elastic stand";
        state(x, i, y[i]);
    }
    return arrive(x, y);
}

/* The inertia that the friction of joint i moves. */
static double rubbed(const Model *x, int i)
{
    if (x->k_g[i] > 0.0) return x->J[i];
    return x->J[i] + x->M[i] - (x->k_s[i] > 0.0 ? x->M[i] * x->M[i] / (x->M_s[i] + x->M[i]) : 0.0);
}

const char *model_step(Model *x, double t, double h)
{
    double y[JOINTS][STATE];
    (void)t; /* the joint does not depend on time */
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        const double rate = (x->damping[i] + x->friction[i] / x->v_f[i]) / rubbed(x, i);
        const double steps = whole(rate * h / BEARABLE, x->substeps);
        if (steps < 0.0)
            return "damping or friction / v_f of a joint is too great for its inertia: more than 1000 steps"
                   " of the integrator in a step; a greater v_f or inertia, or a shorter step is needed";
        state(x, i, y[i]);
        for (int n = 0; n < (int)steps; n++) runge_kutta(x, i, h / steps, y[i]);
    }
    return arrive(x, y);
}
