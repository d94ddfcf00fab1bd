/* wave_integral_impedance.c - the end of a line of wave integrals that takes motion and gives
 * torque.
 *
 *     tau = -F,   F = b dq - w,   u = b dq + F
 */
#include <stddef.h>

#include "limit.h"
#include "model.h"
#include "wave_integrals.h"

enum { JOINTS = ENTRIES(dq) };

/* A step of h s; at the start h is 0, and no wave has come yet. */
static const char *advance(Model *x, double h)
{
    WaveGiven given[JOINTS];
    double tau[JOINTS], U[JOINTS], E[JOINTS];
    for (int i = 0; i < JOINTS; i++) {
        const double b = x->b[i];
        given[i] = (WaveGiven){x->U_given[i], x->E_given[i]};
        const double w = wave_given(x->U_j[i], x->E_j[i], b, h, &given[i]);
        const double F = limited(b * x->dq[i] - w, x->tau_max[i]), u = w + 2.0 * F;
        tau[i] = -F;
        U[i] = x->U[i] + h * u;
        E[i] = x->E[i] + h * u * u / (4.0 * b);
    }
    if (!all_finite(tau, JOINTS) || !all_finite(U, JOINTS) || !all_finite(E, JOINTS))
        return "the wave left the range of numbers";
    for (int i = 0; i < JOINTS; i++) {
        x->tau[i] = tau[i];
        x->U[i] = U[i];
        x->E[i] = E[i];
        x->U_given[i] = given[i].U;
        x->E_given[i] = given[i].E;
    }
    return NULL;
}

const char *model_initial(Model *x)
{
    for (int i = 0; i < JOINTS; i++) x->U[i] = x->E[i] = x->U_given[i] = x->E_given[i] = 0.0;
    return advance(x, 0.0);
}

const char *model_step(Model *x, double t, double h)
{
    (void)t; /* the law does not depend on time */
    return advance(x, h);
}
