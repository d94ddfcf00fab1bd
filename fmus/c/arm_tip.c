/* arm_tip.c - a hand and a wall at the tip of a serial arm; equations in fmus/models/arm_tip.py.
 *
 *     f_h = grip (K_h (x_h - x) + B_h (dx_h - dx)),   f_e = n max(0, k_w d + b_w dd) for d > 0
 *     tau_ext = J^T (f_h - f_e),   dx = J dq,   d = n . (x - x_w)
 */
#include "chain_check.h"
#include "chain_tip.h"
#include "contact.h"
#include "model.h"

enum { JOINTS = ENTRIES(q) };

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static const char *give(Model *x)
{
    const Chain chain = CHAIN_OF(x);
    Pose pose[CHAIN_MOST];
    Tip at;
    double inside[3], f_h[3], f_e[3], tau[JOINTS];
    chain_pose(&chain, x->q, pose);
    chain_tip(&chain, pose, x->tip, x->dq, &at);
    for (int k = 0; k < 3; k++) inside[k] = at.p[k] - x->x_w[k];
    const double depth = dot(x->normal, inside), rate = dot(x->normal, at.dp);
    const double push = contact(SPRING_DAMPER, depth, rate, x->k_w, x->b_w);
    for (int k = 0; k < 3; k++) {
        f_h[k] = x->grip * (x->K_h[k] * (x->x_h[k] - at.p[k]) + x->B_h[k] * (x->dx_h[k] - at.dp[k]));
        f_e[k] = push * x->normal[k];
    }
    for (int i = 0; i < JOINTS; i++) {
        tau[i] = 0.0;
        for (int k = 0; k < 3; k++) tau[i] += at.J[k][i] * (f_h[k] - f_e[k]);
    }
    if (!all_finite(tau, JOINTS) || !all_finite(at.p, 3) || !all_finite(f_h, 3) || !all_finite(f_e, 3))
        return "the torque left the range of numbers (|q| <= 1e6 rad)";
    for (int i = 0; i < JOINTS; i++) x->tau_ext[i] = tau[i];
    for (int k = 0; k < 3; k++) {
        x->x[k] = at.p[k];
        x->f_h[k] = f_h[k];
        x->f_e[k] = f_e[k];
    }
    return NULL;
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
