/* planar2r.c - planar arm with two revolute joints; equations in fmus/models/planar2r.py.
 *
 *     M(q) ddq + C(q, dq) dq + g(q) = tau + tau_ext + tau_h - tau_e
 *
 * Integrated with the Runge-Kutta method of order 4, `substeps` steps per communication step. The torques
 * of hand and wall are evaluated at every stage.
 */
#include <stddef.h>

#include "environment.h"
#include "model.h"
#include "trig.h"

static inline Truth is_level(const Model *x) { return (x->theta_g[0] == 0.0) & (x->theta_g[1] == 0.0); }

static inline int is_flat(const Model *x) { return ALL(is_level(x)); }

/* g(q) = (theta_g1 cos q1 + theta_g2 cos (q1 + q2), theta_g2 cos (q1 + q2)), N.m. */
static inline void gravity(const Real theta_g[2], const Real q[2], Real g[2])
{
    Real s1, c1, s12, c12;
    sine_cosine(q[0], &s1, &c1);
    sine_cosine(q[0] + q[1], &s12, &c12);
    g[1] = theta_g[1] * c12;
    g[0] = theta_g[0] * c1 + g[1];
}

/* ddq = M^-1 (tau + tau_ext + tau_h - tau_e - C dq - g), rad/s^2; `torque` = tau + tau_ext; `flat`: g = 0. */
static INLINED void acceleration(const Model *x, int flat, const Real torque[2], const Real q[2],
                                 const Real dq[2], Real ddq[2])
{
    const Real *theta = x->theta;
    Real s2, c2;
    sine_cosine(q[1], &s2, &c2);
    const Real M11 = theta[0] + 2.0 * theta[1] * c2;
    const Real M12 = theta[2] + theta[1] * c2;
    const Real M22 = theta[2];
    const Real h = theta[1] * s2;
    const Real Cdq1 = -h * dq[1] * (2.0 * dq[0] + dq[1]);
    const Real Cdq2 = h * dq[0] * dq[0];
    Real b1 = torque[0] + hand(x, 0, q[0], dq[0]) - wall(x, 0, q[0], dq[0]) - Cdq1;
    Real b2 = torque[1] + hand(x, 1, q[1], dq[1]) - wall(x, 1, q[1], dq[1]) - Cdq2;
    if (!flat) {
        const Truth level = is_level(x);
        Real g[2];
        gravity(x->theta_g, q, g);
        b1 = PICK(level, b1, b1 - g[0]);
        b2 = PICK(level, b2, b2 - g[1]);
    }
    const Real inverse = 1.0 / (M11 * M22 - M12 * M12);
    ddq[0] = (M22 * b1 - M12 * b2) * inverse;
    ddq[1] = (M11 * b2 - M12 * b1) * inverse;
}

/* One step h of the classical method, in place. */
static INLINED void runge_kutta(const Model *x, int flat, const Real torque[2], double h, Real q[2],
                                Real dq[2])
{
    Real k1[2], k2[2], k3[2], k4[2]; /* ddq of the stages; their dq is v1 = dq, v2, v3, v4 */
    Real p[2], v2[2], v3[2], v4[2];
    acceleration(x, flat, torque, q, dq, k1);
    for (int i = 0; i < 2; i++) {
        p[i] = q[i] + 0.5 * h * dq[i];
        v2[i] = dq[i] + 0.5 * h * k1[i];
    }
    acceleration(x, flat, torque, p, v2, k2);
    for (int i = 0; i < 2; i++) {
        p[i] = q[i] + 0.5 * h * v2[i];
        v3[i] = dq[i] + 0.5 * h * k2[i];
    }
    acceleration(x, flat, torque, p, v3, k3);
    for (int i = 0; i < 2; i++) {
        p[i] = q[i] + h * v3[i];
        v4[i] = dq[i] + h * k3[i];
    }
    acceleration(x, flat, torque, p, v4, k4);
    for (int i = 0; i < 2; i++) {
        q[i] += h / 6.0 * (dq[i] + 2.0 * (v2[i] + v3[i]) + v4[i]);
        dq[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    }
}

#if TOGETHER == 1
const char *model_initial(Model *x)
{
    const double *theta = x->theta;
    if (!(theta[2] > 0.0 && theta[0] * theta[2] - theta[2] * theta[2] - theta[1] * theta[1] > 0.0))
        return "theta gives no positive definite inertia: theta[2] > 0 and theta[0] theta[2]"
               " - theta[2]^2 - theta[1]^2 > 0 are needed";
    if (environment_problem(x)) return environment_problem(x);
    return arrive(x, x->q, x->dq);
}

#ifdef EXCHANGE
const char *model_rates(Model *x)
{
    const double torque[2] = {x->tau[0] + x->tau_ext[0], x->tau[1] + x->tau_ext[1]};
    acceleration(x, is_flat(x), torque, x->q, x->dq, x->ddq);
    return all_finite(x->ddq, 2) ? arrive(x, x->q, x->dq) : DIVERGED;
}
#endif
#endif

const char *model_step(Model *x, double t, double h)
{
    const int substeps = (int)COMMON(x->substeps);
    const int flat = is_flat(x);
    const Real torque[2] = {x->tau[0] + x->tau_ext[0], x->tau[1] + x->tau_ext[1]};
    Real q[2] = {x->q[0], x->q[1]}, dq[2] = {x->dq[0], x->dq[1]};
    (void)t; /* the arm does not depend on time */
    for (int i = 0; i < substeps; i++) runge_kutta(x, flat, torque, h / substeps, q, dq);
    return arrive(x, q, dq);
}
