/* events.c: Event Mode of an FMU of FMI 3.0 (3.0.2, 2.3.5 and 4.2.1), and steps with events in them. */
#include "engine_internal.h"

/* fmi3UpdateDiscreteStates until nothing changes and no clock ticks, then Step Mode. */
static int leave_event_mode(const doing_t *d, double now)
{
    typed_t *x = d->unit->typed;
    void *instance = d->unit->instance;
    _Bool again = 1, terminate = 0, nominals, values, defined = 0;
    double next = 0.0;

    for (int i = 0; again && !terminate; i++) {
        int result = tick_clocks(d, now);
        if (result == RUN_OK) result = exchange_clocked(d);
        if (result != RUN_OK) return result;
        if (i == CALLS_AT_MOST) return RUN_STUCK;
        again = 0;
        *d->status = ((update_t)x->update)(instance, &again, &terminate, &nominals, &values, &defined, &next);
        if (failed_call(*d->status)) return RUN_EVENT;
        if (x->asks && !terminate) result = ask_intervals(d, now, &again);
        if (result != RUN_OK) return result;
    }
    x->next_event = defined ? next : DBL_MAX;
    if (terminate) {
        d->unit->reached = now;
        return RUN_TERMINATED;
    }
    *d->status = ((mode_t3)x->enter_step)(instance);
    return failed_call(*d->status) ? RUN_EVENT : RUN_OK;
}

SHARED void note_event(const typed_t *x, double now)
{
    event_times_t *e = x->happened;
    if (e && e->count++ < e->room) e->times[e->count - 1] = now;
}

static int enter_event_mode(const doing_t *d, double now)
{
    note_event(d->unit->typed, now);
    *d->status = ((mode_t3)d->unit->typed->enter_event)(d->unit->instance);
    return failed_call(*d->status) ? RUN_EVENT : RUN_OK;
}

SHARED int changed(const access_t *a, int64_t n, const double *s)
{
    int different = 0;
    for (; n > 0; n--, a++)
        for (int64_t i = 0; i < a->count; i++)
            if (s[a->places[i]] != a->held[i]) {
                a->held[i] = s[a->places[i]];
                different = 1;
            }
    return different;
}

/* One event at the start of step `hit`: discrete inputs that changed, and all clocks due. */
SHARED int input_event(const doing_t *d, int64_t hit, double t)
{
    const typed_t *x = d->unit->typed;
    int result, needed;

    if (!x->n_discrete && !x->n_clocks) return RUN_OK;
    needed = changed(x->discrete, x->n_discrete, d->signals);
    if (!(wake(d, hit, t) | needed)) return RUN_OK;
    result = enter_event_mode(d, t);
    if (result == RUN_OK && needed)
        result = set_typed(x->discrete, x->n_discrete, d->unit->instance, d->signals, d->status, d->failed);
    if (result == RUN_OK) result = leave_event_mode(d, t);
    return result == RUN_TERMINATED ? RUN_ENDED : result;
}

/* One event within a step, or at its end: clocks that are due at the end tick with the next step. */
static int step_event(const doing_t *d, double now, int inside, int happened)
{
    const typed_t *x = d->unit->typed;
    const int ticks = inside && x->asks && wake(d, -1, now);
    int result;

    if (!ticks && !happened && x->next_event > now + SLACK * d->unit->h) return RUN_OK;
    result = enter_event_mode(d, now);
    return result == RUN_OK ? leave_event_mode(d, now) : result;
}

/* Within doStep (3.0.2, 4.2.2): inputs that are lines over the step have another value at `time`; an FMU
 * that can return early does so if the run is to stop. */
API void engine_intermediate(void *environment, double time, _Bool set, _Bool get, _Bool finished,
                             _Bool can_return, _Bool *early, double *early_time)
{
    log_t *log = own_log(environment);
    doing_t *d = log ? log->step : NULL;
    const typed_t *x = d ? d->unit->typed : NULL;

    (void)get, (void)finished;
    if (early) *early = 0;
    if (!x || d->result != RUN_OK) return;
    if (set && x->slopes) {
        const access_t *a = x->slopes;
        for (int64_t i = 0; i < a->count; i++)
            ((double *)a->buffer)[i] = d->signals[x->starts[i]] + d->signals[a->places[i]] * (time - d->now);
        *d->status = call_access(a, d->unit->instance);
        if (failed_call(*d->status)) d->result = RUN_SET;
        d->refused = *d->status;
    }
    if (!can_return || !early || !x->stop || !*(const volatile int32_t *)x->stop) return;
    *early = 1;
    if (early_time) *early_time = time;
}

/* What went wrong in a call-back: the call that it was in may have said that all is well. */
SHARED int refused_inside(const doing_t *d)
{
    *d->status = d->refused;
    return d->result;
}

static int is_stopped(const typed_t *x) { return x->stop && *(const volatile int32_t *)x->stop; }

/* After a call of doStep whose end was `at`, s: *now becomes how far it has come, and events there are handled. */
static int arrive_at(doing_t *d, const outcome_t *a, double at, double *now, double end)
{
    typed_t *x = d->unit->typed;

    if (a->terminate) {
        d->unit->reached = a->reached;
        return RUN_TERMINATED;
    }
    if (a->early && is_stopped(x)) return RUN_STOPPED;
    *now = a->early ? a->reached : at;
    return x->update ? step_event(d, *now, *now < end - SLACK * d->unit->h, a->event) : RUN_OK;
}

/* doStep from `now`, after `calls` of it, until t + h: the FMU may return early, and is stopped where an event or a tick
 * is known. */
static int advance(doing_t *d, double t, double now, int calls)
{
    unit_t *u = d->unit;
    typed_t *x = u->typed;
    const double end = t + u->h, slack = SLACK * u->h;

    for (; calls < CALLS_AT_MOST; calls++) {
        double length = calls ? end - now : u->h;
        outcome_t a = {0, 0, 0, now + length};
        const double next = x->variable ? next_time(x) : DBL_MAX;
        const int cut = next < end - slack && next > now + slack;
        int result;
        if (cut) length = next - now;
        if (x->log) ((log_t *)x->log)->step = d;
        *d->status = ((step3_t)u->step)(u->instance, now, length, !u->repeats, &a.event, &a.terminate,
                                        &a.early, &a.reached);
        if (x->log) ((log_t *)x->log)->step = NULL;
        if (d->result != RUN_OK) return refused_inside(d);
        if (failed_call(*d->status)) return RUN_STEP;
        result = arrive_at(d, &a, cut ? next : end, &now, end);
        if (result != RUN_OK || now >= end - slack) return result;
    }
    return RUN_STUCK;
}

SHARED int do_step(doing_t *d, double t) { return advance(d, t, t, 0); }

/* The rest of a step after its first call of doStep, which has not been cut. */
SHARED int finish_step(doing_t *d, double t, const outcome_t *a)
{
    const double h = d->unit->h, end = t + h;
    double now = t;
    const int result = arrive_at(d, a, end, &now, end);

    return result != RUN_OK || now >= end - SLACK * h ? result : advance(d, t, now, 1);
}
