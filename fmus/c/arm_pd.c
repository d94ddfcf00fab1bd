/* arm_pd.c - a spring and a damper to the other arm, with gravity and friction compensated.
 *
 *     tau = K_p (q_j - q) + K_d (dq_j - dq) + g(q) + F_c tanh(dq / v_c) + F_v dq + F_o
 */
#include "chain_check.h"
#include "hyperbolic.h"
#include "limit.h"
#include "model.h"

enum { JOINTS = ENTRIES(q) };

static const char *give(Model *x)
{
    const Chain chain = CHAIN_OF(x);
    Pose pose[CHAIN_MOST];
    double g[CHAIN_MOST], tau[JOINTS];
    chain_pose(&chain, x->q, pose);
    chain_gravity(&chain, pose, g);
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        double friction = x->F_v[i] * x->dq[i] + x->F_o[i];
        if (x->F_c[i] > 0.0) friction += x->F_c[i] * hyperbolic_tangent(x->dq[i] / x->v_c[i]);
        const double spring = x->K_p[i] * (x->q_j[i] - x->q[i]) + x->K_d[i] * (x->dq_j[i] - x->dq[i]);
        tau[i] = limited(spring + g[i] + friction, x->tau_max[i]);
    }
    return give_torques(tau, x->tau, COUNT(x, JOINTS));
}

const char *model_initial(Model *x)
{
    const Chain chain = CHAIN_OF(x);
    const char *problem = chain_problem(&chain);
    return problem ? problem : give(x);
}

const char *model_step(Model *x, double t, double h)
{
    (void)t, (void)h; /* no state */
    return give(x);
}
