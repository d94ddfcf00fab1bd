/* servo_command.c - the reference with which a servo gives a wanted torque.
 *
 *     tau = K_v (f dq_c - dq) + K_p (e + T (dq_c - dq)) + K_i integral e,   e = q_r - q
 *
 * Equations in fmus/models/servo_command.py.
 */
#include <stddef.h>

#include "model.h"
#include "servo.h"

enum { JOINTS = ENTRIES(q) };

/* The part of the reference's velocity that the servo takes. */
static double fed(const Model *x) { return x->mode == VELOCITY ? 1.0 : x->feed_forward; }

const char *model_initial(Model *x)
{
    for (int i = 0; i < JOINTS; i++) {
        if (!(fed(x) * x->K_v[i] + x->K_p[i] > 0.0))
            return "K_p and the K_v that is fed forward are both 0: no command moves the servo";
        x->q_c[i] = x->q_r[i] = x->q[i];
        x->dq_c[i] = x->e_sum[i] = 0.0;
    }
    return all_finite(x->q_c, JOINTS) ? NULL : SERVO_DIVERGED;
}

static void step_joint(Model *x, int i, double h)
{
    const double q_r = x->q_r[i], error = q_r - x->q[i];
    const double damped = (x->K_v[i] + x->K_p[i] * h) * x->dq[i];
    const double pull = x->tau[i] + damped - x->K_p[i] * error - x->K_i[i] * x->e_sum[i];
    const double asked = pull / (fed(x) * x->K_v[i] + x->K_p[i] * h);
    const int held = x->clamped[i] != 0.0;
    x->dq_c[i] = limited_rate(asked, x->dq_c[i], x->v_max[i], x->a_max[i], h);
    x->q_c[i] = q_r + h * x->dq_c[i];
    x->q_r[i] = q_r + h * (held && x->mode == VELOCITY ? x->dq[i] : x->dq_c[i]);
    if (!held) x->e_sum[i] += h * error;
}

const char *model_step(Model *x, double t, double h)
{
    (void)t; /* the law does not depend on time */
    for (int i = 0; i < JOINTS; i++) step_joint(x, i, h);
    return all_finite(x->q_c, JOINTS) && all_finite(x->dq_c, JOINTS) ? NULL : SERVO_DIVERGED;
}
