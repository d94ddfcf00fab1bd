/* environment.h - parts that all plants of arms share: the operator's grip, the wall, and the state at the
 * end of a step. Equations in fmus/arms/environment.py.
 */
#ifndef ENVIRONMENT_H
#define ENVIRONMENT_H

#include <stddef.h>

#include "contact.h"
#include "model.h"

enum { JOINTS = ENTRIES(q) };

static const char DIVERGED[] =
    "the motion left the range of numbers (|q| <= 1e6 rad): diverged, or the step is too long";

/* tau_h = grip (-k_d dq - k_p (q - q_h)), operator's torque on the robot. */
static inline Real hand(const Model *x, int i, Real q, Real dq)
{
    return x->grip * (-x->k_d[i] * dq - x->k_p[i] * (q - x->q_h[i]));
}

/* tau_e, robot's torque on its environment. */
static inline Real wall(const Model *x, int i, Real q, Real dq)
{
    return contact((int)COMMON(x->contact), q - x->q_w[i], dq, x->k_w[i], x->b_w[i]);
}

#if TOGETHER == 1
/* NULL, or a message that says why the values of substeps or contact are not possible. */
static inline const char *environment_problem(const Model *x)
{
    if (!(x->substeps >= 1.0)) return "substeps must be at least 1";
    if (!(x->contact >= 0.0 && x->contact <= 2.0)) return "contact must be 0, 1 or 2";
    return NULL;
}
#endif

/* Set q, dq and the values that follow from them; or return a message and change nothing. */
static inline const char *arrive(Model *x, const Real *q, const Real *dq)
{
    Real tau_h[JOINTS], tau_e[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        tau_h[i] = hand(x, i, q[i], dq[i]);
        tau_e[i] = wall(x, i, q[i], dq[i]);
    }
    if (!all_finite(q, COUNT(x, JOINTS)) || !all_finite(dq, COUNT(x, JOINTS)) ||
        !all_finite(tau_h, COUNT(x, JOINTS)) || !all_finite(tau_e, COUNT(x, JOINTS)))
        return DIVERGED;
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        x->q[i] = q[i];
        x->dq[i] = dq[i];
        x->tau_h[i] = tau_h[i];
        x->tau_e[i] = tau_e[i];
    }
    return NULL;
}

#endif
