/* servo.c - the inner loop of a robot that takes positions or velocities.
 *
 *     tau = K_v (f dq_r - dq) + K_p (q_r - q) + K_i integral (q_r - q)
 *
 * Equations in fmus/models/servo.py.
 */
#include "servo.h"

#include <stddef.h>

#include "model.h"

enum { JOINTS = ENTRIES(q) };

static double sign(double a) { return (double)(a > 0.0) - (double)(a < 0.0); }

const char *model_initial(Model *x)
{
    for (int i = 0; i < JOINTS; i++) {
        x->q_r[i] = x->q_next[i] = x->q_last[i] = x->q[i];
        x->dq_r[i] = x->clamped[i] = x->e_sum[i] = x->left[i] = 0.0;
        x->tau[i] = limited(-x->K_v[i] * x->dq[i], x->tau_max[i]);
    }
    return all_finite(x->tau, JOINTS) && all_finite(x->q_r, JOINTS) ? NULL : SERVO_DIVERGED;
}

/* The velocity that the command asks of q_r. */
static double asked(Model *x, int i, double h)
{
    if (x->mode == VELOCITY) return x->dq_c[i];
    const double time = x->left[i] > 0.0 ? x->left[i] : x->T_c;
    return (x->q_c[i] - x->q_r[i]) / (time > h ? time : h);
}

static void step_joint(Model *x, int i, double h)
{
    const int by_velocity = x->mode == VELOCITY;
    x->q_r[i] = x->q_next[i];
    if (x->q_c[i] != x->q_last[i]) x->left[i] = x->T_c;
    const double rate = asked(x, i, h);
    x->dq_r[i] = limited_rate(rate, x->dq_r[i], x->v_max[i], x->a_max[i], h);
    const double f = by_velocity ? 1.0 : x->feed_forward, error = x->q_r[i] - x->q[i];
    const double wanted =
        x->K_v[i] * (f * x->dq_r[i] - x->dq[i]) + x->K_p[i] * error + x->K_i[i] * x->e_sum[i];
    x->tau[i] = limited(wanted, x->tau_max[i]);
    const int over = x->tau[i] != wanted;
    x->clamped[i] = over ? sign(wanted) : sign(rate - x->dq_r[i]);
    x->q_next[i] = x->q_r[i] + h * (by_velocity && over ? x->dq[i] : x->dq_r[i]);
    if (!over) x->e_sum[i] += h * error;
    x->q_last[i] = x->q_c[i];
    x->left[i] = x->dq_r[i] != rate ? x->T_c : x->left[i] > 1.5 * h ? x->left[i] - h : 0.0;
}

const char *model_step(Model *x, double t, double h)
{
    (void)t; /* the law does not depend on time */
    for (int i = 0; i < JOINTS; i++) step_joint(x, i, h);
    return all_finite(x->tau, JOINTS) && all_finite(x->q_next, JOINTS) ? NULL : SERVO_DIVERGED;
}
