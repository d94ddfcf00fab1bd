/* scheduled.c: scheduled execution of an FMU of FMI 3.0 (3.0.2, 5.2): its input clocks activate its
 * partitions, in the order of time, at the same time in that of their priorities, which is that of the
 * clocks here.
 *
 * The variables of a clock are set before its activation and got after it; those without a clock, before
 * the first activation of a step and after the last one. Nothing is preempted. Within an activation the
 * FMU may call back: then its output clocks are asked whether they tick, and those that count down for
 * their intervals.
 */
#include "engine_internal.h"

API void engine_lock(void) {} /* both call-backs about preemption */

API void engine_clock_update(void *environment)
{
    log_t *log = own_log(environment);
    doing_t *d = log ? log->step : NULL;
    typed_t *x;

    if (!d || d->result != RUN_OK) return;
    x = d->unit->typed;
    d->result = ask_clocks(d);
    for (int64_t i = 0; i < x->n_clocks && d->result == RUN_OK; i++) {
        ticker_t *c = x->clocks + i;
        if (c->kind == CLOCK_COUNTDOWN) d->result = ask_interval(d, c, d->now);
    }
    d->refused = *d->status;
}

/* The clock whose partition is next before `end`, or NULL. */
static ticker_t *next_partition(const typed_t *x, double end, double slack)
{
    ticker_t *first = NULL;

    for (int64_t i = 0; i < x->n_clocks; i++) {
        ticker_t *c = x->clocks + i;
        if (c->next < end - slack && (!first || c->next < first->next - slack)) first = c;
    }
    return first;
}

/* When a periodic clock ticks after this: never a sum of times. */
static double next_period(ticker_t *c)
{
    c->n++;
    if (!c->resolution) return c->origin + (c->offset + (double)c->n * c->interval);
    c->count += c->counter;
    return c->origin + (double)c->count / (double)c->resolution;
}

static int activate(doing_t *d, ticker_t *c, double now)
{
    typed_t *x = d->unit->typed;
    log_t *log = x->log;
    int result;

    if (now <= c->last) return RUN_INTERVAL; /* once at a time */
    x->active[c - x->clocks] = 1;
    result = feed_partitions(d);
    if (result != RUN_OK) return result;
    c->due = c->next;
    c->next = c->kind == CLOCK_PERIODIC ? next_period(c) : DBL_MAX;
    c->last = d->now = now;
    log->step = d;
    *d->status = ((activate_t3)x->activate)(d->unit->instance, c->reference, now);
    log->step = NULL;
    if (d->result != RUN_OK) return refused_inside(d);
    if (failed_call(*d->status)) return RUN_STEP;
    result = c->kind == CLOCK_CHANGING ? ask_interval(d, c, now) : RUN_OK;
    return result == RUN_OK ? take_partitions(d) : result;
}

/* All that is activated from t to before t + h, with the inputs of t. What is at the same time gets the
 * same time: that of the step, or of the first. */
SHARED int step_scheduled(doing_t *d, double t)
{
    typed_t *x = d->unit->typed;
    const double slack = SLACK * d->unit->h, end = t + d->unit->h;
    ticker_t *c;
    double now = t;
    int result = RUN_OK, calls = 0;

    for (int64_t i = 0; i < x->n_clocks; i++)
        if (x->clocks[i].kind == CLOCK_WIRED && is_due(x->clocks + i, 0, t, d->signals))
            x->clocks[i].next = t;
    while (result == RUN_OK && (c = next_partition(x, end, slack))) {
        if (c->next > now + slack) now = c->next;
        if (calls == CALLS_AT_MOST) return RUN_STUCK;
        if (!calls++)
            result = set_typed(x->inputs, x->n_inputs, d->unit->instance, d->signals, d->status, d->failed);
        if (result == RUN_OK) result = activate(d, c, now);
    }
    if (result != RUN_OK || !calls) return result;
    return get_typed(x->outputs, x->n_outputs, d->unit->instance, d->signals, d->status, d->failed);
}
