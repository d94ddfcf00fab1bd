/* damping.c - damping and the torque of gravity, equation (24) of the paper.
 *
 *     tau = -d dq + g(q)
 */
#include <stddef.h>

#include "model.h"
#include "trig.h"

const char *model_initial(Model *x)
{
    double tau[2], s1, c1, s12, c12;
    sine_cosine(x->q[0], &s1, &c1);
    sine_cosine(x->q[0] + x->q[1], &s12, &c12);
    tau[1] = -x->d[1] * x->dq[1] + x->theta_g[1] * c12;
    tau[0] = -x->d[0] * x->dq[0] + (x->theta_g[0] * c1 + x->theta_g[1] * c12);
    if (!all_finite(tau, 2)) return "the torque left the range of numbers (|q| <= 1e6 rad)";
    for (int i = 0; i < 2; i++) x->tau[i] = tau[i];
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
