/* tdpa_impedance.c - the end of a line that takes motion and gives torque, kept passive in the time
 * domain; equations in fmus/models/tdpa_impedance.py.
 *
 *     W = max E_j - E_out + E_pc,   f = f_j + a dq with a = -W / (h dq^2) while W < 0,   tau = -f
 *
 * The energies are those up to t_k. They are computed from held torques and differences of angles, not from
 * velocities.
 */
#include <stddef.h>

#include "limit.h"
#include "model.h"

enum { JOINTS = ENTRIES(q) };

typedef struct {
    double E[JOINTS], E_seen[JOINTS], E_out[JOINTS], E_pc[JOINTS], W[JOINTS], tau[JOINTS];
} Port;

/* Add the energy of the last step; tau and f_last still have the values of its start. */
static void observe(const Model *x, Port *y)
{
    for (int i = 0; i < JOINTS; i++) {
        const double passed = x->q[i] - x->q_last[i];
        const double work = x->f_last[i] * passed; /* into the line */
        y->E[i] = x->E[i] + (work > 0.0 ? work : 0.0);
        y->E_out[i] = x->E_out[i] - (work < 0.0 ? work : 0.0);
        y->E_pc[i] = x->E_pc[i] - (x->tau[i] + x->f_last[i]) * passed;
        y->E_seen[i] = x->E_j[i] > x->E_seen[i] ? x->E_j[i] : x->E_seen[i];
        y->W[i] = y->E_seen[i] - y->E_out[i] + y->E_pc[i];
    }
}

/* Dissipate excess energy by damping, within one step if a_max allows it. */
static void control(const Model *x, double h, Port *y)
{
    for (int i = 0; i < JOINTS; i++) {
        const double dq = x->dq[i], owed = -y->W[i], room = h * dq * dq;
        double a = 0.0;
        if (owed > 0.0) a = owed < x->a_max[i] * room ? owed / room : x->a_max[i];
        y->tau[i] = limited(-(x->f_j[i] + a * dq), x->tau_max[i]);
    }
}

/* Update the port; or return a message and change nothing. */
static const char *take(Model *x, const Port *y)
{
    if (!all_finite(y->E, JOINTS) || !all_finite(y->W, JOINTS) || !all_finite(y->tau, JOINTS))
        return "the energy left the range of numbers";
    for (int i = 0; i < JOINTS; i++) {
        x->tau[i] = y->tau[i];
        x->v[i] = x->dq[i];
        x->E[i] = y->E[i];
        x->W[i] = y->W[i];
        x->E_seen[i] = y->E_seen[i];
        x->E_out[i] = y->E_out[i];
        x->E_pc[i] = y->E_pc[i];
        x->q_last[i] = x->q[i];
        x->f_last[i] = x->f_j[i];
    }
    return NULL;
}

const char *model_initial(Model *x)
{
    Port y;
    for (int i = 0; i < JOINTS; i++) {
        y.E[i] = y.E_out[i] = y.E_pc[i] = 0.0;
        y.W[i] = y.E_seen[i] = x->E_j[i];
        y.tau[i] = limited(-x->f_j[i], x->tau_max[i]);
    }
    return take(x, &y);
}

const char *model_step(Model *x, double t, double h)
{
    Port y;
    (void)t; /* the law does not depend on time */
    observe(x, &y);
    control(x, h, &y);
    return take(x, &y);
}
