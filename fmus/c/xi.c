/* xi.c - the signal the controllers exchange, equation (47) of the paper.
 *
 *     xi = dq + alpha q
 */
#include <stddef.h>

#include "model.h"

enum { JOINTS = ENTRIES(q) };

const char *model_initial(Model *x)
{
    double xi[JOINTS];
    for (int i = 0; i < COUNT(x, JOINTS); i++) xi[i] = x->dq[i] + x->alpha * x->q[i];
    if (!all_finite(xi, COUNT(x, JOINTS))) return "xi left the range of numbers";
    for (int i = 0; i < COUNT(x, JOINTS); i++) x->xi[i] = xi[i];
    return NULL;
}

const char *model_step(Model *x, double t, double h)
{
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
