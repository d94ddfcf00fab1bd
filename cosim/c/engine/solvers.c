/* solvers.c: the methods that integrate an FMU for model exchange. */
#include "engine_internal.h"

enum { HALVINGS = 30 };

/* The methods whose stages depend on the one before only; nodes and weights. */
static const struct {
    int stages;
    double node[4], weight[4];
} methods[] = {
    {1, {0.0}, {1.0}},
    {2, {0.0, 1.0}, {0.5, 0.5}},
    {4, {0.0, 0.5, 0.5, 1.0}, {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0}},
};

/* The states at x->now + h in y; the first stage has been computed. */
static int runge_kutta(const exchanging_t *d, int method, double h, double *y)
{
    const exchange_t *x = d->x;
    const int64_t n = x->n_states;
    const double *start = states(x, START);

    for (int i = 1; i < methods[method].stages; i++) {
        const double node = methods[method].node[i], *last = states(x, STAGES + i - 1);
        int result;
        for (int64_t k = 0; k < n; k++) y[k] = start[k] + h * node * last[k];
        result = derive(d, x->now + node * h, y, states(x, STAGES + i));
        if (result != RUN_OK) return result;
    }
    for (int64_t k = 0; k < n; k++) {
        double sum = 0.0;
        for (int i = 0; i < methods[method].stages; i++)
            sum += methods[method].weight[i] * states(x, STAGES + i)[k];
        y[k] = start[k] + h * sum;
    }
    return RUN_OK;
}

/* From a continuous state that is new: states, their derivatives and the indicators from the FMU. */
SHARED int solver_restart(const exchanging_t *d)
{
    exchange_t *x = d->x;
    double *y = states(x, START);
    int result = RUN_OK;

    if (x->n_states)
        result = did(d, ((get_numbers_t)x->get_states)(d->fmu, y, (size_t)x->n_states), RUN_STEP);
    if (result == RUN_OK) result = indicate(d, indicators(x, BEFORE));
    if (result == RUN_OK && x->solver == SOLVER_CVODE) result = cvode_restart(d);
    x->fresh = 0;
    return result;
}

/* One step of the solver, to *end or less far: END has the states there. A trial state that the FMU refuses
 * halves the step of a method of fixed steps; CVODE does so itself. */
SHARED int solver_step(const exchanging_t *d, double bound, double *end)
{
    exchange_t *x = d->x;
    const double left = bound - x->now;
    const int cvode = x->solver == SOLVER_CVODE;
    const int64_t parts = 1 + (int64_t)((1.0 - SLACK) * left / x->longest);
    double h = left / (double)parts;
    int result;

    x->steps++;
    if (cvode && left > 4.0 * time_resolution(x->now, bound)) return cvode_step(d, bound, end);
    if (cvode) x->fresh = 1; /* too short for it: see below */
    for (int i = 0;; i++) {
        result = derive(d, x->now, states(x, START), states(x, STAGES));
        if (result == RUN_OK) result = runge_kutta(d, cvode ? SOLVER_EULER : x->solver, h, states(x, END));
        if (result == RUN_OK || *d->status != REFUSED || i == HALVINGS) break;
        h *= 0.5;
    }
    *end = h == left ? bound : x->now + h;
    return result;
}

/* The states at t within the step to `end`, in y. */
SHARED int interpolate(const exchanging_t *d, double t, double end, double *y)
{
    const exchange_t *x = d->x;
    if (t == end) {
        memcpy(y, states(x, END), (size_t)x->n_states * sizeof *y);
        return RUN_OK;
    }
    if (x->solver == SOLVER_CVODE && !x->fresh) return cvode_dense(d, t, y);
    return runge_kutta(d, x->solver == SOLVER_CVODE ? SOLVER_EULER : x->solver, t - x->now, y);
}
