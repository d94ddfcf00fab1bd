/* wave_admittance.c - the end of a wave line that takes torque and gives motion, which a spring and
 * a damper make the arm follow.
 *
 *     tau = F = K_p (q_d - q) + K_d (dq_d - dq),   b dq_d = u - F,   v = b dq_d - F
 *
 * The law is sampled: the outputs are those of t_k. The q_d for t_k + h is kept in q_d_next.
 */
#include <stddef.h>

#include "limit.h"
#include "model.h"

enum { JOINTS = ENTRIES(q) };

typedef struct {
    double F[JOINTS], v[JOINTS], dq_d[JOINTS];
} Port;

/* Torque, returning wave and velocity at t_k, with the state q_d. NULL, or a message. */
static const char *port(const Model *x, const double q_d[JOINTS], Port *y)
{
    for (int i = 0; i < JOINTS; i++) {
        const double b = x->b[i], K_p = x->K_p[i], K_d = x->K_d[i];
        const double spring = K_p * (q_d[i] - x->q[i]);
        const double free = (x->u[i] - spring + K_d * x->dq[i]) / (b + K_d); /* no limit */
        y->F[i] = limited(spring + K_d * (free - x->dq[i]), x->tau_max[i]);
        y->dq_d[i] = (x->u[i] - y->F[i]) / b;
        y->v[i] = x->u[i] - 2.0 * y->F[i];
    }
    if (!all_finite(y->F, JOINTS) || !all_finite(y->v, JOINTS) || !all_finite(y->dq_d, JOINTS))
        return "the wave left the range of numbers";
    return NULL;
}

static void give(Model *x, const Port *y)
{
    for (int i = 0; i < JOINTS; i++) {
        x->tau[i] = y->F[i];
        x->v[i] = y->v[i];
    }
}

const char *model_initial(Model *x)
{
    Port y;
    const char *why = port(x, x->q, &y);
    if (why != NULL) return why;
    give(x, &y);
    for (int i = 0; i < JOINTS; i++) x->q_d[i] = x->q_d_next[i] = x->q[i];
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    Port y;
    (void)t; /* the law does not depend on time */
    const char *why = port(x, x->q_d_next, &y);
    if (why != NULL) return why;
    give(x, &y);
    for (int i = 0; i < JOINTS; i++) {
        x->q_d[i] = x->q_d_next[i];
        x->q_d_next[i] += h * y.dq_d[i];
    }
    return NULL;
}
