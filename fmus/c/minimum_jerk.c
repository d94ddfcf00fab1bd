/* minimum_jerk.c - a target that goes from one place to another with the least jerk.
 *
 *     q_h = q_0 + (q_f - q_0) (10 p^3 - 15 p^4 + 6 p^5),   p = (t - t_0) / T from 0 to 1
 */
#include <stddef.h>

#include "model.h"

enum { JOINTS = ENTRIES(q_h) };

static void give(Model *x, double t)
{
    const double past = (t - x->t_0) / x->T;
    const double p = past < 0.0 ? 0.0 : past > 1.0 ? 1.0 : past, rest = 1.0 - p;
    const double part = p * p * p * (10.0 + p * (6.0 * p - 15.0));
    const double speed = 30.0 * (p * p) * (rest * rest) / x->T; /* 1/s */
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        x->q_h[i] = x->q_0[i] + (x->q_f[i] - x->q_0[i]) * part;
        x->dq_h[i] = (x->q_f[i] - x->q_0[i]) * speed;
    }
    for (int i = 0; i < ENTRIES(x_h); i++) {
        x->x_h[i] = x->x_0[i] + (x->x_f[i] - x->x_0[i]) * part;
        x->dx_h[i] = (x->x_f[i] - x->x_0[i]) * speed;
    }
}

const char *model_initial(Model *x)
{
    give(x, 0.0);
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    (void)h; /* no state */
    give(x, t);
    return NULL;
}
