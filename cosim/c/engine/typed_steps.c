/* typed_steps.c: one step of an FMU with other types than float64, with event mode, clocks or early return. */
#include "engine_internal.h"

/* FMI 2.0: slopes of inputs that are lines over the step, at its start (2.0.5, 4.2.1). */
static int set_slopes(const typed_t *x, void *instance, const double *s, int *status)
{
    const access_t *a = x->slopes;

    for (int64_t i = 0; i < a->count; i++) ((double *)a->buffer)[i] = s[a->places[i]];
    *status = ((slopes2_t)a->call)(instance, a->references, (size_t)a->n_references, x->orders, a->buffer);
    return failed_call(*status) ? RUN_SET : RUN_OK;
}

static int step_typed2(const unit_t *u, const double *s, double t, int *status)
{
    const int result = u->typed->slopes ? set_slopes(u->typed, u->instance, s, status) : RUN_OK;

    if (result != RUN_OK) return result;
    *status = ((step2_t)u->step)(u->instance, t, u->h, !u->repeats);
    return failed_call(*status) ? RUN_STEP : RUN_OK;
}

SHARED int step_typed(unit_t *u, double *s, double t, int64_t hit, int *status, int32_t *failed)
{
    const typed_t *x = u->typed;
    doing_t c = {u, s, status, failed, t, RUN_OK, 0};
    int end, result;

    if (x->activate) return step_scheduled(&c, t);
    result = set_typed(x->inputs, x->n_inputs, u->instance, s, status, failed);

    if (result == RUN_OK && x->update) result = input_event(&c, hit, t);
    if (result != RUN_OK) return result;
    end = x->fmi == 2 ? step_typed2(u, s, t, status) : do_step(&c, t);
    if (end != RUN_OK && end != RUN_TERMINATED) return end;
    result = get_typed(x->outputs, x->n_outputs, u->instance, s, status, failed);
    return result != RUN_OK ? result : end;
}
