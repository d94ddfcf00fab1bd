/* clocks.c: the clocks of an FMU of FMI 3.0 (3.0.2, 2.2.8): which tick now, when next, and what
 * belongs to them.
 *
 * Clocked variables have values only while one of their clocks is active: from when it ticks until
 * the discrete states are updated. In between they are set and got, and the signals hold them until
 * the next tick.
 */
#include "engine_internal.h"

enum { INTERVAL_NOT_YET_KNOWN, INTERVAL_UNCHANGED, INTERVAL_CHANGED };

static int any_active(const typed_t *x, const int32_t *clocks, int64_t n)
{
    for (int64_t i = 0; i < n; i++)
        if (x->active[clocks[i]]) return 1;
    return 0;
}

/* At the start of step `hit`, or within one: then `hit` is negative, and only time ticks clocks. */
SHARED int is_due(ticker_t *c, int64_t hit, double now, const double *s)
{
    double before = c->held;

    switch (c->kind) {
    case CLOCK_PERIODIC: return hit >= c->shift && (hit - c->shift) % c->period == 0;
    case CLOCK_WIRED:
        if (hit < 0) return 0;
        c->held = s[c->place];
        return c->held > before;
    default: return c->next <= now;
    }
}

/* Which input clocks tick now: they become active. */
SHARED int wake(const doing_t *d, int64_t hit, double now)
{
    const typed_t *x = d->unit->typed;
    const double reach = now + SLACK * d->unit->h;
    int any = 0;

    for (int64_t i = 0; i < x->n_clocks; i++)
        any |= x->active[i] = is_due(x->clocks + i, hit, reach, d->signals);
    return any;
}

/* Calls fmi3SetClock for active clocks; a clock whose time has passed is late. */
SHARED int tick_clocks(const doing_t *d, double now)
{
    typed_t *x = d->unit->typed;

    for (int64_t i = 0; i < x->n_clocks; i++) {
        ticker_t *c = x->clocks + i;
        const double late = now - c->next;
        if (!x->active[i]) continue;
        if (late > SLACK * d->unit->h) {
            x->late++;
            if (late > x->latest) x->latest = late;
        }
        c->due = c->next;
        c->next = DBL_MAX;
        *d->status = ((set_clock_t3)x->set_clock)(d->unit->instance, &c->reference, 1, x->active + i);
        if (failed_call(*d->status)) return RUN_EVENT;
    }
    return RUN_OK;
}

/* An interval from now on, as a fraction. Where it begins with a tick of the clock itself, at its time, the
 * counts since the start are added up: their sum is exact. */
static double after_fraction(const doing_t *d, ticker_t *c, double now, uint64_t counter, uint64_t resolution)
{
    if (c->resolution != (int64_t)resolution || fabs(now - c->due) > SLACK * d->unit->h) {
        c->origin = now;
        c->count = 0;
        c->resolution = (int64_t)resolution;
    }
    c->count += (int64_t)counter;
    return c->origin + (double)c->count / (double)resolution;
}

/* The next tick after an interval from now on. */
SHARED int ask_interval(const doing_t *d, ticker_t *c, double now)
{
    const typed_t *x = d->unit->typed;
    double next = 0.0;
    uint64_t counter = 0, resolution = 0;
    int qualifier = INTERVAL_NOT_YET_KNOWN;

    if (c->exact)
        *d->status = ((get_fraction_t3)x->get_fraction)(d->unit->instance, &c->reference, 1, &counter,
                                                        &resolution, &qualifier);
    else
        *d->status =
            ((get_interval_t3)x->get_interval)(d->unit->instance, &c->reference, 1, &next, &qualifier);
    if (failed_call(*d->status)) return RUN_EVENT;
    if (c->kind == CLOCK_COUNTDOWN && qualifier != INTERVAL_CHANGED) return RUN_OK;
    if (qualifier == INTERVAL_NOT_YET_KNOWN || !(next >= 0.0)) return RUN_INTERVAL;
    if (c->exact && (!resolution || resolution > INT64_MAX || counter > INT64_MAX / 2)) return RUN_INTERVAL;
    c->next = c->exact ? after_fraction(d, c, now, counter, resolution) : now + next;
    return RUN_OK;
}

/* Reads the intervals of countdown clocks always, of changing clocks after a tick. A clock that ticks
 * immediately becomes active, and `*again` is set. */
SHARED int ask_intervals(const doing_t *d, double now, _Bool *again)
{
    const typed_t *x = d->unit->typed;
    const double reach = now + SLACK * d->unit->h;

    for (int64_t i = 0; i < x->n_clocks; i++) {
        ticker_t *c = x->clocks + i;
        const double before = c->next;
        int result;
        if (c->kind != CLOCK_COUNTDOWN && !(c->kind == CLOCK_CHANGING && before == DBL_MAX)) continue;
        result = ask_interval(d, c, now);
        if (result != RUN_OK) return result;
        if (c->next <= reach && c->next != before) *again = x->active[i] = 1;
    }
    return RUN_OK;
}

/* Time of the next clock tick or time event (s). */
SHARED double next_time(const typed_t *x)
{
    double next = x->next_event;
    if (!x->asks) return next;
    for (int64_t i = 0; i < x->n_clocks; i++)
        if (x->clocks[i].next < next) next = x->clocks[i].next;
    return next;
}

/* Sets the inputs whose clocks are active, once per instant. */
SHARED int feed_partitions(const doing_t *d)
{
    const typed_t *x = d->unit->typed;
    int result = RUN_OK;

    for (int64_t i = 0; i < x->n_partitions && result == RUN_OK; i++) {
        partition_t *p = x->partitions + i;
        if (p->fed || !any_active(x, p->clocks, p->n_clocks)) continue;
        p->fed = 1;
        result = set_typed(p->inputs, p->n_inputs, d->unit->instance, d->signals, d->status, d->failed);
    }
    return result;
}

/* Which clocks the FMU ticks itself; one that belongs to others only while these are active. */
SHARED int ask_clocks(const doing_t *d)
{
    const typed_t *x = d->unit->typed;

    for (int64_t i = 0; i < x->n_triggered; i++) {
        const triggered_t *c = x->triggered + i;
        _Bool ticks = 0;
        if (c->n_clocks && !any_active(x, c->clocks, c->n_clocks)) continue;
        *d->status = ((get_clock_t3)x->get_clock)(d->unit->instance, &c->reference, 1, &ticks);
        if (failed_call(*d->status)) return RUN_EVENT;
        if (!ticks) continue;
        x->active[x->n_clocks + i] = 1;
        d->signals[c->place] += 1.0;
    }
    return RUN_OK;
}

/* Gets the outputs whose clocks are active. No clock is active afterwards. */
SHARED int take_partitions(const doing_t *d)
{
    const typed_t *x = d->unit->typed;
    int result = RUN_OK;

    for (int64_t i = 0; i < x->n_partitions && result == RUN_OK; i++) {
        partition_t *p = x->partitions + i;
        p->fed = 0;
        if (!any_active(x, p->clocks, p->n_clocks)) continue;
        result = get_typed(p->outputs, p->n_outputs, d->unit->instance, d->signals, d->status, d->failed);
        if (result == RUN_OK && p->texts && (*d->status = p->texts())) result = RUN_GET;
    }
    memset(x->active, 0, (size_t)(x->n_clocks + x->n_triggered) * sizeof *x->active);
    return result;
}

/* Clocked values of this instant, in and out. */
SHARED int exchange_clocked(const doing_t *d)
{
    const typed_t *x = d->unit->typed;
    int result = feed_partitions(d);

    if (result == RUN_OK) result = ask_clocks(d);
    if (result == RUN_OK && x->n_triggered) result = feed_partitions(d);
    return result == RUN_OK ? take_partitions(d) : result;
}
