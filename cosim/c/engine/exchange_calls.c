/* exchange_calls.c: what is asked of an FMU for model exchange at a time, and for some states. */
#include "engine_internal.h"

typedef int (*set_time_t)(void *, double);
typedef int (*set_states_t)(void *, const double *, size_t);

SHARED double *states(const exchange_t *x, int which) { return x->memory + which * x->n_states; }
SHARED double *indicators(const exchange_t *x, int which)
{
    return x->memory + 7 * x->n_states + which * x->n_indicators;
}

SHARED int did(const exchanging_t *d, int status, int result)
{
    if (!failed_call(status)) return RUN_OK;
    *d->status = status;
    return result;
}

/* Put the FMU at a time, with these states. */
SHARED int put_states(const exchanging_t *d, double t, const double *y)
{
    const exchange_t *x = d->x;
    const size_t n = (size_t)x->n_states;
    int result = did(d, ((set_time_t)x->set_time)(d->fmu, t), RUN_STEP);

    if (result == RUN_OK && n) result = did(d, ((set_states_t)x->set_states)(d->fmu, y, n), RUN_STEP);
    return result;
}

SHARED int derive(const exchanging_t *d, double t, const double *y, double *rates)
{
    exchange_t *x = d->x;
    const int result = put_states(d, t, y);

    if (result != RUN_OK || !x->n_states) return result;
    x->evaluations++;
    return did(d, ((get_numbers_t)x->derivatives)(d->fmu, rates, (size_t)x->n_states), RUN_STEP);
}

SHARED int indicate(const exchanging_t *d, double *z)
{
    const exchange_t *x = d->x;
    if (!x->n_indicators) return RUN_OK;
    return did(d, ((get_numbers_t)x->indicators)(d->fmu, z, (size_t)x->n_indicators), RUN_STEP);
}

/* Two times closer than this are one. */
SHARED double time_resolution(double a, double b)
{
    const double most = fabs(a) > fabs(b) ? fabs(a) : fabs(b);
    return 4.0 * DBL_EPSILON * most;
}
