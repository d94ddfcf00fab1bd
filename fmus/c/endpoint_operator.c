/* endpoint_operator.c - a hand that holds the arm's endpoint with a spring and a damper.
 *
 *     f = K_h (x_h - x) + B_h (dx_h - dx),   tau_h = J^T f,   dx = J dq
 *     x = (l1 c1 + l2 c12, l1 s1 + l2 s12),  J = dx/dq
 */
#include <stddef.h>

#include "model.h"
#include "trig.h"

const char *model_initial(Model *x)
{
    double s1, c1, s12, c12, f[2], tau_h[2];
    sine_cosine(x->q[0], &s1, &c1);
    sine_cosine(x->q[0] + x->q[1], &s12, &c12);
    const double near[2] = {x->l[0] * c1, x->l[0] * s1}, far[2] = {x->l[1] * c12, x->l[1] * s12};
    const double place[2] = {near[0] + far[0], near[1] + far[1]};
    const double J[2][2] = {{-place[1], -far[1]}, {place[0], far[0]}};
    for (int i = 0; i < 2; i++) {
        const double dx = J[i][0] * x->dq[0] + J[i][1] * x->dq[1];
        f[i] = x->K_h[i] * (x->x_h[i] - place[i]) + x->B_h[i] * (x->dx_h[i] - dx);
    }
    for (int i = 0; i < 2; i++) tau_h[i] = J[0][i] * f[0] + J[1][i] * f[1];
    if (!all_finite(place, 2) || !all_finite(f, 2) || !all_finite(tau_h, 2))
        return "the torque left the range of numbers (|q| <= 1e6 rad)";
    for (int i = 0; i < 2; i++) {
        x->tau_h[i] = tau_h[i];
        x->x[i] = place[i];
        x->f[i] = f[i];
    }
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
