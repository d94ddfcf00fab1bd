/* xi.c - the signal the controllers exchange, equation (47) of the paper.
 *
 *     xi = dq + alpha q
 */
#include <stddef.h>

#include "model.h"

const char *model_initial(Model *x) {
    double xi[2];
    for (int i = 0; i < 2; i++) xi[i] = x->dq[i] + x->alpha * x->q[i];
    if (!all_finite(xi, 2)) return "xi left the range of numbers";
    for (int i = 0; i < 2; i++) x->xi[i] = xi[i];
    return NULL;
}

const char *model_step(Model *x, double t, double h) {
    (void)t, (void)h; /* no state */
    return model_initial(x);
}
