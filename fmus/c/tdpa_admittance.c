/* tdpa_admittance.c - the end of a line that takes torque and gives motion, kept passive in the time
 * domain; equations in fmus/models/tdpa_admittance.py.
 *
 *     w = v_j + k_c (q_j - q_d)                         velocity that the line demands
 *     tau = f = K_p (q_d - q) + K_d (dq_d - dq)         torque on the arm for the passed dq_d:
 *     dq_d = w, or as much of it that h f dq_d <= W
 *
 * The law is sampled: the outputs are those of t_k. The q_d and the energies for t_k + h are local
 * variables of the model until the next step.
 */
#include <stddef.h>

#include "limit.h"
#include "model.h"

enum { JOINTS = ENTRIES(q) };

typedef struct {
    double f[JOINTS], E_seen[JOINTS], W[JOINTS], dq_d[JOINTS];
    double out[JOINTS];   /* out of the line in this step, h f w, J */
    double taken[JOINTS]; /* of it by the passivity controller, h f (w - dq_d), J */
} Port;

static inline double positive(double x) { return x > 0.0 ? x : 0.0; }

/* The torque from 0 to `most` (>= 0) with f (f - a) <= room, or that with the least f (f - a). */
static inline double affordable(double most, double a, double room)
{
    if (most * (most - a) <= room) return most;
    const double f = 0.5 * a + sqrt(positive(0.25 * a * a + room));
    return f > most ? most : positive(f);
}

/* The port at t_k, with the state at t_k; the next step takes h > 0. */
static void port(const Model *x, double h, Port *y)
{
    for (int i = 0; i < JOINTS; i++) {
        const double K_d = x->K_d[i], q_d = x->q_d_next[i];
        const double w = x->v_j[i] + x->k_c * (x->q_j[i] - q_d);
        const double a = x->K_p[i] * (q_d - x->q[i]) - K_d * x->dq[i]; /* f = a + K_d dq_d */
        const double wanted = a + K_d * w, sign = wanted < 0.0 ? -1.0 : 1.0;
        const double most = limited(sign * wanted, x->tau_max[i]);
        y->E_seen[i] = x->E_j[i] > x->E_seen[i] ? x->E_j[i] : x->E_seen[i];
        y->W[i] = x->E_0[i] + y->E_seen[i] - x->E_out[i] + x->E_pc[i];
        y->f[i] = sign * affordable(most, sign * a, K_d * y->W[i] / h);
        y->dq_d[i] = (y->f[i] - a) / K_d;
        y->out[i] = h * y->f[i] * w;
        y->taken[i] = h * y->f[i] * (w - y->dq_d[i]);
    }
}

static inline int finite_port(const Port *y)
{
    return all_finite(y->f, JOINTS) && all_finite(y->W, JOINTS) && all_finite(y->dq_d, JOINTS) &&
           all_finite(y->out, JOINTS) && all_finite(y->taken, JOINTS);
}

const char *model_initial(Model *x)
{
    for (int i = 0; i < JOINTS; i++) {
        x->tau[i] = x->f[i] = 0.0;
        x->E_seen[i] = x->E_j[i];
        x->W[i] = x->E_0[i] + x->E_j[i];
        x->q_d[i] = x->q_d_next[i] = x->q[i];
        x->E[i] = x->E_next[i] = x->E_out[i] = x->E_pc[i] = 0.0;
    }
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    Port y;
    (void)t; /* the law does not depend on time */
    port(x, h, &y);
    if (!finite_port(&y)) return "the energy left the range of numbers: the motion diverged";
    for (int i = 0; i < JOINTS; i++) {
        x->tau[i] = x->f[i] = y.f[i];
        x->E_seen[i] = y.E_seen[i];
        x->W[i] = y.W[i];
        x->q_d[i] = x->q_d_next[i];
        x->q_d_next[i] += h * y.dq_d[i];
        x->E[i] = x->E_next[i];
        x->E_next[i] += positive(-y.out[i]);
        x->E_out[i] += positive(y.out[i]);
        x->E_pc[i] += y.taken[i];
    }
    return NULL;
}
