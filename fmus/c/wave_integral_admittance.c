/* wave_integral_admittance.c - the end of a line of wave integrals that takes torque and gives
 * motion, which a spring and a damper make the arm follow.
 *
 *     tau = F = K_p (q_d - q) + K_d (dq_d - dq),   b dq_d = w - F,   v = b dq_d - F
 *
 * The law is sampled: the outputs are those of t_k. The q_d for t_k + h is kept in q_d_next.
 */
#include <stddef.h>

#include "limit.h"
#include "model.h"
#include "wave_integrals.h"

enum { JOINTS = ENTRIES(q) };

/* A step of h s from q_d; at the start h is 0, and no wave has come yet. */
static const char *advance(Model *x, double h, const double q_d[JOINTS])
{
    WaveGiven given[JOINTS];
    double tau[JOINTS], U[JOINTS], E[JOINTS], dq_d[JOINTS];
    for (int i = 0; i < JOINTS; i++) {
        const double b = x->b[i], K_d = x->K_d[i], spring = x->K_p[i] * (q_d[i] - x->q[i]);
        given[i] = (WaveGiven){x->U_given[i], x->E_given[i]};
        const double w = wave_given(x->U_j[i], x->E_j[i], b, h, &given[i]);
        const double free = (w - spring + K_d * x->dq[i]) / (b + K_d); /* no limit */
        tau[i] = limited(spring + K_d * (free - x->dq[i]), x->tau_max[i]);
        const double v = w - 2.0 * tau[i];
        dq_d[i] = (w - tau[i]) / b;
        U[i] = x->U[i] + h * v;
        E[i] = x->E[i] + h * v * v / (4.0 * b);
    }
    if (!all_finite(tau, JOINTS) || !all_finite(U, JOINTS) || !all_finite(E, JOINTS) ||
        !all_finite(dq_d, JOINTS))
        return "the wave left the range of numbers";
    for (int i = 0; i < JOINTS; i++) {
        x->tau[i] = tau[i];
        x->U[i] = U[i];
        x->E[i] = E[i];
        x->U_given[i] = given[i].U;
        x->E_given[i] = given[i].E;
        x->q_d[i] = q_d[i];
        x->q_d_next[i] = q_d[i] + h * dq_d[i];
    }
    return NULL;
}

const char *model_initial(Model *x)
{
    for (int i = 0; i < JOINTS; i++) x->U[i] = x->E[i] = x->U_given[i] = x->E_given[i] = 0.0;
    return advance(x, 0.0, x->q);
}

const char *model_step(Model *x, double t, double h)
{
    double q_d[JOINTS];
    (void)t; /* the law does not depend on time */
    for (int i = 0; i < JOINTS; i++) q_d[i] = x->q_d_next[i];
    return advance(x, h, q_d);
}
