/* kinematic.c - the reference of the dynamic feedback as a command of velocity or position.
 *
 *     dz = -alpha dq + lambda_M (dq - z) + b tau_m - lambda sum_j w_j (xi - xi_in_j),   dq_c = z
 *
 * Equations in fmus/models/kinematic.py.
 */
#define NETWORKED 1
#include <stddef.h>

#include "limit.h"
#include "model.h"
#include "neighbours.h"

enum { JOINTS = ENTRIES(q) };

#include "commands.h"

const char *model_initial(Model *x)
{
    if (!(x->alpha > 0.0)) return "alpha must be more than 0 with neighbours: positions would not agree";
    for (int i = 0; i < JOINTS; i++) {
        begin_command(x, i);
        x->xi[i] = x->dq[i] + x->alpha * x->q[i];
        x->s[i] = x->dq[i] - x->z[i];
    }
    return all_finite(x->xi, JOINTS) && all_finite(x->s, JOINTS) ? NULL : LAW_DIVERGED;
}

const char *model_step(Model *x, double t, double h)
{
    (void)t; /* the law does not depend on time */
    for (int i = 0; i < JOINTS; i++) {
        const double z = x->z_next[i], xi = x->dq[i] + x->alpha * x->q[i], s = x->dq[i] - z;
        const double dz = -x->alpha * x->dq[i] + x->lambda_M * s + x->b[i] * x->tau_m[i] - coupling(x, i, xi);
        x->xi[i] = xi;
        x->s[i] = s;
        x->z[i] = z;
        give_command(x, i, z, dz, h);
    }
    return all_finite(x->z_next, JOINTS) && all_finite(x->q_c, JOINTS) ? NULL : LAW_DIVERGED;
}
