/* reaction.c - the intent of a person who reacts late: where the hand wants to be.
 *
 *     dp/dt = omega_c (q_g - q(t - reaction)), limited to +-v_max
 *     q_h   = p + tremor sin(2 pi f t)
 */
#include <stddef.h>

#include "model.h"
#include "trig.h"

enum { JOINTS = ENTRIES(q) };

enum { KEPT = 64 };
static const double TWO_PI = 6.283185307179586;

const char *model_initial(Model *x)
{
    if (!all_finite(x->q, JOINTS)) return "the input left the range of numbers";
    for (int i = 0; i < JOINTS; i++) x->q_h[i] = x->p[i] = x->q[i];
    for (int i = 0; i < JOINTS * KEPT; i++) x->past[i] = x->q[i % JOINTS];
    x->k = 0.0;
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    const double steps = x->reaction / h + 0.5;
    if (!(steps < KEPT)) return "the reaction time is more than 63 steps";
    const long k = (long)x->k, late = (long)steps, seen = (k > late ? k - late : 0) % KEPT;
    double sine, cosine, q_h[JOINTS], p[JOINTS];
    sine_cosine(TWO_PI * x->f * t, &sine, &cosine);
    for (int i = 0; i < JOINTS; i++) x->past[JOINTS * (k % KEPT) + i] = x->q[i];
    for (int i = 0; i < JOINTS; i++) {
        double v = x->omega_c * (x->q_g[i] - x->past[JOINTS * seen + i]);
        v = v > x->v_max ? x->v_max : v < -x->v_max ? -x->v_max : v;
        q_h[i] = x->p[i] + x->tremor * sine;
        p[i] = x->p[i] + h * v;
    }
    if (!all_finite(q_h, JOINTS) || !all_finite(p, JOINTS)) return "the position left the range of numbers";
    for (int i = 0; i < JOINTS; i++) x->q_h[i] = q_h[i], x->p[i] = p[i];
    x->k = (double)(k + 1);
    return NULL;
}
