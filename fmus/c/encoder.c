/* encoder.c - quantised positions, and velocities by differences and a filter of first order.
 *
 *     q_m  = resolution round(q / resolution)
 *     dq_m = dq_m' + h / (h + T) ((q_m - q_m') / h - dq_m')
 */
#include <stddef.h>

#include "model.h"

enum { JOINTS = ENTRIES(q) };

/* The nearest whole number, to even from the middle; adding and subtracting 1.5 2^52 rounds. Larger
 * numbers than 2^51 have no fractions that matter. */
static double nearest(double x)
{
    if (!(x > -0x1p51 && x < 0x1p51)) return x;
    const volatile double shifted = x + 0x1.8p52;
    return shifted - 0x1.8p52;
}

/* q_m of joint i. */
static double quantised(const Model *x, int i)
{
    const double step = x->resolution[i];
    return step > 0.0 ? step * nearest(x->q[i] / step) : x->q[i];
}

const char *model_initial(Model *x)
{
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        x->q_m[i] = x->q_last[i] = quantised(x, i);
        x->dq_m[i] = 0.0;
    }
    return all_finite(x->q_m, COUNT(x, JOINTS)) ? NULL : "the position left the range of numbers";
}

const char *model_step(Model *x, double t, double h)
{
    double q_m[JOINTS], dq_m[JOINTS];
    (void)t; /* the law does not depend on time */
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        q_m[i] = quantised(x, i);
        dq_m[i] = x->dq_m[i] + h / (h + x->T) * ((q_m[i] - x->q_last[i]) / h - x->dq_m[i]);
    }
    if (!all_finite(q_m, COUNT(x, JOINTS)) || !all_finite(dq_m, COUNT(x, JOINTS)))
        return "the measurement left the range of numbers";
    for (int i = 0; i < COUNT(x, JOINTS); i++) {
        x->q_m[i] = x->q_last[i] = q_m[i];
        x->dq_m[i] = dq_m[i];
    }
    return NULL;
}
