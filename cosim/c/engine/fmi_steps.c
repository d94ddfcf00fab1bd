/* fmi_steps.c: one step of a unit of any kind. */
#include "engine_internal.h"

/* The inputs of a unit of `kind`, UNIT_FMI2 or UNIT_FMI3; returns the FMU's status. The values of our own
 * FMUs are open between steps; not those of a unit that is `plain`. */
HOT int set_inputs(const unit_t *u, int32_t kind, int plain, const double *s)
{
    s += u->input;
    if (!plain && u->values) {
        if (u->in_rows) copy(u->values + u->inputs[0], s, u->n_inputs);
        else
            for (int64_t i = 0; i < u->n_inputs; i++) u->values[u->inputs[i]] = s[i];
        return 0;
    }
    if (!u->n_inputs) return 0;
    if (kind == UNIT_FMI2) return ((set2_t)u->set)(u->instance, u->inputs, (size_t)u->n_inputs, s);
    return ((set3_t)u->set)(u->instance, u->inputs, (size_t)u->n_inputs, s, (size_t)u->input_count);
}

/* The same of the outputs. */
INLINE int get_outputs(const unit_t *u, int32_t kind, int plain, double *s)
{
    s += u->output;
    if (!plain && u->values) {
        if (u->in_rows) copy(s, u->values + u->outputs[0], u->n_outputs);
        else
            for (int64_t i = 0; i < u->n_outputs; i++) s[i] = u->values[u->outputs[i]];
        return 0;
    }
    if (!u->n_outputs) return 0;
    if (kind == UNIT_FMI2) return ((get2_t)u->get)(u->instance, u->outputs, (size_t)u->n_outputs, s);
    return ((get3_t)u->get)(u->instance, u->outputs, (size_t)u->n_outputs, s, (size_t)u->output_count);
}

INLINE int step_fmi2(const unit_t *u, int plain, double *s, double t, int *status)
{
    *status = set_inputs(u, UNIT_FMI2, plain, s);
    if (failed_call(*status)) return RUN_SET;
    *status = ((step2_t)u->step)(u->instance, t, u->h, plain || !u->repeats);
    if (failed_call(*status)) return RUN_STEP;
    *status = get_outputs(u, UNIT_FMI2, plain, s);
    return failed_call(*status) ? RUN_GET : RUN_OK;
}

INLINE int step_fmi3(unit_t *u, int plain, double *s, double t, int *status)
{
    _Bool event = 0, terminate = 0, early = 0;
    const int no_way_back = plain || !u->repeats;
    double reached = t;
    *status = set_inputs(u, UNIT_FMI3, plain, s);
    if (failed_call(*status)) return RUN_SET;
    *status = ((step3_t)u->step)(u->instance, t, u->h, no_way_back, &event, &terminate, &early, &reached);
    if (failed_call(*status)) return RUN_STEP;
    if (early && !terminate) return RUN_EARLY_RETURN;
    *status = get_outputs(u, UNIT_FMI3, plain, s);
    if (failed_call(*status)) return RUN_GET;
    if (!terminate) return RUN_OK;
    u->reached = reached;
    return RUN_TERMINATED;
}

/* A step of an FMU that is direct: as step_fmi3, as long as no event is near, and none happens. */
INLINE int step_direct(unit_t *u, double *s, double t, int *status, int32_t *signal)
{
    const typed_t *x = u->typed;
    log_t *const log = x->log;
    outcome_t a = {0, 0, 0, t};
    int result = RUN_OK;
    doing_t d;

    if (x->next_event <= t + (u->h + u->h)) return step_typed(u, s, t, 0, status, signal);
    *status = set_inputs(u, UNIT_FMI3, 1, s);
    if (failed_call(*status)) return RUN_SET;
    d.unit = u;
    d.result = RUN_OK;
    log->step = &d;
    *status = ((step3_t)u->step)(u->instance, t, u->h, 1, &a.event, &a.terminate, &a.early, &a.reached);
    log->step = NULL;
    if (failed_call(*status)) return RUN_STEP;
    if (a.event | a.terminate | a.early) {
        d = (doing_t){u, s, status, signal, t, RUN_OK, 0};
        result = finish_step(&d, t, &a);
        if (result != RUN_OK && result != RUN_TERMINATED) return result;
    }
    *status = get_outputs(u, UNIT_FMI3, 1, s);
    return failed_call(*status) ? RUN_GET : result;
}

/* A step of a unit that is UNIT_TYPED and plain. */
HOT int step_plain_typed(unit_t *u, double *s, int64_t tick, double t, int *status, int32_t *signal)
{
    const int result = step_typed(u, s, t, u->period == 1 ? tick : tick / u->period, status, signal);

    if (result != RUN_OK && result != RUN_TERMINATED) return result;
    return not_finite(s + u->output, u->output_count) ? RUN_NOT_FINITE : result;
}

/* Steps of units that follow each other, plain and of one kind but UNIT_TYPED: from *at on, which becomes the first
 * whose step was not RUN_OK, or `last`. */
HOT int step_each(int32_t kind, unit_t **at, const unit_t *last, double *s, double t, int *status,
                  int32_t *signal)
{
    for (unit_t *u = *at;; u++) {
        int result = kind == UNIT_FMI2   ? step_fmi2(u, 1, s, t, status)
                     : kind == UNIT_FMI3 ? step_fmi3(u, 1, s, t, status)
                                         : step_direct(u, s, t, status, signal);
        if ((result == RUN_OK || result == RUN_TERMINATED) && not_finite(s + u->output, u->output_count))
            result = RUN_NOT_FINITE;
        if (result == RUN_OK && u != last) continue;
        *at = u;
        return result;
    }
}

/* A step of a unit from t (s); `tick`: the one in which it ends. */
HOT int step_from(const engine_t *e, int64_t tick, double t, int32_t index, failure_t *failure)
{
    unit_t *u = e->units + index;
    double *s = e->signals;
    int status = 0, result = RUN_OK;

    if (u->kind == UNIT_FMI2) {
        result = step_fmi2(u, 0, s, t, &status);
    } else if (u->kind == UNIT_FMI3) {
        result = step_fmi3(u, 0, s, t, &status);
    } else if (u->kind == UNIT_TYPED) {
        result = step_typed(u, s, t, (tick - u->lag) / u->period, &status, &failure->signal);
    } else if (u->kind == UNIT_EXCHANGE) {
        result = step_exchange(u, s, t, &status, &failure->signal);
    } else if (u->kind == UNIT_REMOTE) {
        mailbox_ask(u, s, t, (tick - u->lag) / u->period);
        result = mailbox_answer(u, s, &u->reached, &status, &failure->signal);
    } else if (u->kind == UNIT_NATIVE) {
        if (((native_t)u->step)(u->instance, t, u->h, s + u->input, s + u->output)) result = RUN_STEP;
    } else {
        result = ((call_t)u->step)(index, t, u->h);
    }
    if ((result == RUN_OK || result == RUN_TERMINATED) && not_finite(s + u->output, u->output_count))
        result = RUN_NOT_FINITE;
    if (result != RUN_OK) {
        failure->index = index;
        failure->status = status;
    }
    return result;
}

HOT int step_unit(const engine_t *e, int64_t tick, int32_t index, failure_t *failure)
{
    return step_from(e, tick, time_of(e, tick - e->units[index].lag), index, failure);
}

/* The outputs of a unit whose step, by its steps_t, had this status: they are open, and finite. */
HOT int take_outputs(const engine_t *e, int32_t index, int status, failure_t *failure)
{
    const unit_t *u = e->units + index;

    if (!failed_call(status)) {
        get_outputs(u, u->kind, 0, e->signals);
        return RUN_OK;
    }
    failure->index = index;
    failure->status = status;
    return RUN_STEP;
}

/* One step of an FMU outside of a plan: for a process that has but one. */
API int32_t engine_unit(unit_t *u, double *s, double t, int64_t hit, int32_t *status, int32_t *failed)
{
    switch (u->kind) {
    case UNIT_FMI2: return step_fmi2(u, 0, s, t, status);
    case UNIT_FMI3: return step_fmi3(u, 0, s, t, status);
    case UNIT_EXCHANGE: return step_exchange(u, s, t, status, failed);
    default: return step_typed(u, s, t, hit, status, failed);
    }
}

/* In a process with an FMU: steps when asked, until a call is asked for (1) or the other side has ended (0). */
API int32_t engine_serve(mail_end_t *x)
{
    mailbox_t *box = x->box;
    int32_t asked;

    while ((asked = mailbox_asked(x)) == ASK_STEP) {
        box->result = engine_unit(x->unit, x->signals, box->t, box->hit, &box->status, &box->failed);
        box->reached = x->unit->reached;
        engine_answer(x);
    }
    return asked == ASK_CALL;
}
