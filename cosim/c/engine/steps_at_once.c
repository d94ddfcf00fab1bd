/* steps_at_once.c: steps of several units that follow each other in a tick, and need nothing of each other. */
#include "engine_internal.h"

/* FMUs in processes of their own whose steps follow each other: all are asked before one is waited for. */
static int step_remote(const engine_t *e, int64_t tick, const operation_t *op, failure_t *failure)
{
    int first = RUN_OK;

    for (int64_t k = 0; k <= op->count; k++) {
        const unit_t *u = e->units + op[k].index;
        mailbox_ask(u, e->signals, time_of(e, tick - u->lag), (tick - u->lag) / u->period);
    }
    for (int64_t k = 0; k <= op->count; k++) {
        unit_t *u = e->units + op[k].index;
        int32_t signal = 0;
        int status, result = mailbox_answer(u, e->signals, &u->reached, &status, &signal);
        if (result == RUN_OK && not_finite(e->signals + u->output, u->output_count)) result = RUN_NOT_FINITE;
        if (result == RUN_OK || (first != RUN_OK && first != RUN_TERMINATED)) continue;
        first = result; /* of those that end the simulation, the last; an error before all */
        failure->index = op[k].index;
        failure->status = status;
        failure->signal = signal;
    }
    return first;
}

/* `*ticks` steps of units of one FMU whose steps follow each other, while no input of theirs changes. Outputs are got
 * in their order, up to the first step that fails; *ticks becomes the number of steps before that: what comes behind
 * it matters only if it fails sooner. Their values are open (layout.py), so no input is refused. */
SHARED int step_often(const engine_t *e, int64_t tick, int64_t *ticks, const operation_t *op,
                      failure_t *failure)
{
    const int64_t n = op->count + 1, done = *ticks;
    const unit_t *const first = e->units + op->index;
    double times[STEPS_AT_ONCE];
    void *instances[AT_ONCE];
    int status[AT_ONCE], result = RUN_OK;
    size_t made[AT_ONCE];
    int64_t failed = -1;

    for (int64_t i = 0; i < n; i++) {
        const unit_t *u = e->units + op[i].index;
        instances[i] = u->instance;
        set_inputs(u, u->kind, 0, e->signals);
    }
    for (int64_t k = 0; k < done; k++) times[k] = time_of(e, tick + k - first->lag);
    ((steps_t)first->steps)(instances, (size_t)n, times, (size_t)done, first->h, status, made);
    for (int64_t i = 0; i < n; i++)
        if (failed_call(status[i]) && (failed < 0 || made[i] < made[failed])) failed = i;
    for (int64_t i = 0; i < n && result == RUN_OK; i++) {
        result = take_outputs(e, op[i].index, i == failed ? status[i] : 0, failure);
        if (result != RUN_OK) *ticks = i == failed ? (int64_t)made[i] : done - 1;
    }
    failure->tick = tick + *ticks;
    return result;
}

/* One step of units whose steps follow each other. */
SHARED int step_units(const engine_t *e, int64_t tick, const operation_t *op, failure_t *failure)
{
    int64_t one = 1;

    if (e->units[op->index].kind == UNIT_REMOTE) return step_remote(e, tick, op, failure);
    return step_often(e, tick, &one, op, failure);
}
