/* push.c - a constant torque, and a constant force, from t_0 until t_1. */
#include <stddef.h>

#include "model.h"
#include "schedule.h"

enum { JOINTS = ENTRIES(tau_h) };

static void give(Model *x, double t, double h)
{
    const double on = reached(t, h, x->t_0) && !reached(t, h, x->t_1) ? 1.0 : 0.0;
    for (int i = 0; i < COUNT(x, JOINTS); i++) x->tau_h[i] = on * x->tau_p[i];
    x->f = on * x->f_p;
}

GIVEN_AT_EACH_STEP
