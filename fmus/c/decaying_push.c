/* decaying_push.c - a torque, and a force, with finite norm and infinite integral.
 *
 *     tau_h = tau_0 / (t / T + 1),   f = f_0 / (t / T + 1)
 */
#include <stddef.h>

#include "model.h"

enum { JOINTS = ENTRIES(tau_h) };

static const char *give(Model *x, double t)
{
    const double slow = t / x->T + 1.0;
    if (!(slow > 0.0)) return "the time is at or before -T, where the push is infinite";
    for (int i = 0; i < COUNT(x, JOINTS); i++) x->tau_h[i] = x->tau_0[i] / slow;
    x->f = x->f_0 / slow;
    return NULL;
}

const char *model_initial(Model *x) { return give(x, 0.0); }

const char *model_step(Model *x, double t, double h)
{
    (void)h; /* no state */
    return give(x, t);
}
