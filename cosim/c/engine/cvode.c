/* cvode.c: CVODE (SUNDIALS 7) as the solver of an FMU for model exchange.
 *
 * Python loads the library and creates the solver (cosim/fmi/exchange.py); here it is
 * stepped. Its root finder is not used: it takes a zero reached from either side for an event.
 */
#include "engine_internal.h"

enum { ONE_STEP = 2, NO_PROGRESS = -4 }; /* -4: CV_CONV_FAILURE */

typedef int (*advance_t5)(void *, double, void *, double *, int);
typedef int (*restart_t3)(void *, double, void *);
typedef int (*stop_time_t)(void *, double);
typedef int (*dense_t)(void *, double, int, void *);
typedef int (*tolerances_t)(void *, double, void *);
typedef double *(*data_t)(void *);
typedef double *(*column_t)(void *, int64_t);
typedef int (*directional2_t)(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *,
                              double *);
typedef int (*directional3_t)(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *,
                              size_t, double *, size_t);

static double *data_of(const exchange_t *x, void *vector) { return ((data_t)x->data)(vector); }

/* What CVODE returned: RUN_STEP with the FMU's status if that failed, else RUN_SOLVER. */
static int solved(const exchanging_t *d, int flag)
{
    if (flag >= 0) return RUN_OK;
    *d->status = d->x->status ? d->x->status : flag;
    return d->x->status ? RUN_STEP : RUN_SOLVER;
}

/* CVODE's function of user data: 0, 1 to try a shorter step, -1 to give up. */
API int32_t exchange_rates(double t, void *y, void *rates, void *data)
{
    exchange_t *x = data;
    exchanging_t d = *(const exchanging_t *)x->current;
    int status = 0, result;

    d.status = &status;
    result = derive(&d, t, data_of(x, y), data_of(x, rates));
    x->status = status;
    return result == RUN_OK ? 0 : status == REFUSED
    ? 1 : -1;
}

/* The Jacobian of the derivatives by the states: each column is a directional derivative. */
API int32_t exchange_jacobian(double t, void *y, void *rates, void *matrix, void *data, void *a, void *b,
                              void *c)
{
    exchange_t *x = data;
    const size_t n = (size_t)x->n_states, r = (size_t)x->n_references;
    double *seed = states(x, STAGES);
    exchanging_t d = *(const exchanging_t *)x->current;
    int status = 0;

    (void)rates, (void)a, (void)b, (void)c;
    d.status = &status;
    put_states(&d, t, data_of(x, y));
    memset(seed, 0, n * sizeof *seed);
    for (size_t j = 0; j < n && !failed_call(status); j++) {
        double *column = ((column_t)x->column)(matrix, (int64_t)j);
        seed[j] = 1.0;
        if (x->fmi == 2)
            status = ((directional2_t)x->directional)(d.fmu, x->rates, r, x->states, r, seed, column);
        else status = ((directional3_t)x->directional)(d.fmu, x->rates, r, x->states, r, seed, n, column, n);
        seed[j] = 0.0;
    }
    x->status = failed_call(status) ? status : 0;
    return !failed_call(status) ? 0 : status == REFUSED
    ? 1 : -1;
}

/* Start anew from the states in START: what went before an event is of no use. */
SHARED int cvode_restart(const exchanging_t *d)
{
    exchange_t *x = d->x;
    x->current = (void *)d;
    memcpy(data_of(x, x->vector), states(x, START), (size_t)x->n_states * sizeof(double));
    return solved(d, ((restart_t3)x->restart)(x->cvode, x->now, x->vector));
}

SHARED int cvode_step(const exchanging_t *d, double bound, double *end)
{
    exchange_t *x = d->x;
    int flag = ((stop_time_t)x->stop_time)(x->cvode, bound);

    x->current = (void *)d, x->status = 0;
    if (flag >= 0) flag = ((advance_t5)x->advance)(x->cvode, bound, x->vector, end, ONE_STEP);
    if (flag >= 0) memcpy(states(x, END), data_of(x, x->vector), (size_t)x->n_states * sizeof(double));
    /* It goes on with steps that no longer change the time where the FMU refuses every later state. */
    if (flag >= 0 && *end - x->now <= time_resolution(x->now, *end)) flag = NO_PROGRESS;
    return solved(d, flag);
}

/* The states within its last step. */
SHARED int cvode_dense(const exchanging_t *d, double t, double *y)
{
    const exchange_t *x = d->x;
    const int result = solved(d, ((dense_t)x->dense)(x->cvode, t, 0, x->vector));

    memcpy(y, data_of(x, x->vector), (size_t)x->n_states * sizeof *y);
    return result;
}

/* Absolute tolerances of 0.01 relative ones of the nominal values (FMI 2.0.5, 2.1.3). */
SHARED int cvode_tolerances(const exchanging_t *d)
{
    const exchange_t *x = d->x;
    double *most = data_of(x, x->absolute);
    const int result = did(d, ((get_numbers_t)x->nominals)(d->fmu, most, (size_t)x->n_states), RUN_EVENT);

    if (result != RUN_OK) return result;
    for (int64_t k = 0; k < x->n_states; k++) most[k] = 0.01 * x->tolerance * fabs(most[k]);
    return solved(d, ((tolerances_t)x->tolerances)(x->cvode, x->tolerance, x->absolute));
}
