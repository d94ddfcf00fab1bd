/* stepping.c - communication steps of one instance, or of several at once. */
#include <float.h>
#include <math.h>

#include "instance.h"

/* How exactly a step of h from t has to begin, s: importers may have rounded. */
#define CLOSE(t, h) (1e-6 * (h) + 1e-12 * fabs(t))

/* Whether the importer may ask for this step now. */
static inline Status check_step(const Instance *x, double t, double h, const char *function)
{
    const double *values = x->values;
    const double close = CLOSE(t, h);
    if (!(h > 0.0 && h <= DBL_MAX))
        return refuse(x, function, "the communication step is %g s, expected more than 0", h);
    if (!(fabs(t - values[TIME]) <= close))
        return refuse(x, function, "the communication point is %.17g s, expected %.17g s", t, values[TIME]);
    if (t + h > x->stop_time + close)
        return refuse(x, function, "the step ends at %.17g s, after the stop time %.17g s", t + h,
                      x->stop_time);
    return find_not_finite(values) < TIME ? check_inputs(x, t, function) : STATUS_OK;
}

/* The end of a step that the model has made, or `why` not. */
static inline Status end_step(Instance *x, double t, double h, const char *why, const char *function)
{
    if (why != NULL) return discard(x, function, "at t = %g s %s", t, why);
    x->values[TIME] = t + h;
    return STATUS_OK;
}

Status do_step(Instance *x, double t, double h, const char *function)
{
    const Status status = check_step(x, t, h, function);
    if (status != STATUS_OK) return status;
    if (!declared.is_clocked) return end_step(x, t, h, model_step((Model *)x->values, t, h), function);
    const Status clocked = step_clocked(x, t, h, function);
    return clocked == STATUS_OK ? end_step(x, t, h, NULL, function) : clocked;
}

/* Steps one by one, up to the first that fails; `made` of them are made already. */
static int step_on(Instance *x, const double t[], size_t m, double h, const char *function, size_t *made)
{
    Status status = legal(x, STEPPING, function) ? STATUS_OK : STATUS_ERROR;
    while (status == STATUS_OK && *made < m)
        if ((status = do_step(x, t[*made], h, function)) == STATUS_OK) ++*made;
    return (int)status;
}

/* How many of these steps begin where the one before ends. */
static size_t follow(const double t[], size_t m, double h)
{
    for (size_t i = 1; i < m; i++)
        if (!(fabs(t[i] - (t[i - 1] + h)) <= CLOSE(t[i], h))) return i;
    return m;
}

/* How many of these steps, which follow each other, end by the stop time, if the first does. */
static size_t in_time(const Instance *x, const double t[], size_t m, double h)
{
    while (m > 1 && t[m - 1] + h > x->stop_time + CLOSE(t[m - 1], h)) m--;
    return m;
}

/* The first n <= WIDEST, in lanes. */
static void step_some(Instance *const x[], size_t n, const double t[], size_t m, double h,
                      const char *function, int status[], size_t made[])
{
    const char *why[WIDEST];
    Model *models[WIDEST];
    size_t some = 0, place[WIDEST], done[WIDEST], sure = follow(t, m, h);
    for (size_t k = 0; k < n; k++) {
        status[k] = legal(x[k], STEPPING, function) ? (int)check_step(x[k], t[0], h, function) : STATUS_ERROR;
        made[k] = 0;
        if (status[k] != STATUS_OK) continue;
        place[some] = k;
        sure = in_time(x[k], t, sure, h);
        models[some++] = (Model *)x[k]->values;
    }
    declared.steps(models, some, t, sure, h, done, why);
    for (size_t i = 0; i < some; i++) {
        const size_t k = place[i];
        made[k] = done[i];
        if (done[i]) x[k]->values[TIME] = t[done[i] - 1] + h;
        status[k] = why[i] != NULL ? (int)end_step(x[k], t[done[i]], h, why[i], function)
                                   : step_on(x[k], t, m, h, function, made + k);
    }
}

void do_steps(Instance *const x[], size_t n, const double t[], size_t m, double h, const char *function,
              int status[], size_t made[])
{
    for (size_t i = 0; declared.steps != NULL && i < n; i += WIDEST)
        step_some(x + i, n - i < WIDEST ? n - i : WIDEST, t, m, h, function, status + i, made + i);
    for (size_t i = 0; declared.steps == NULL && i < n; i++) {
        made[i] = 0;
        status[i] = step_on(x[i], t, m, h, function, made + i);
    }
}
