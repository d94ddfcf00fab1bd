/* events.h: Event Mode and clocks of an FMU of FMI 3.0 (3.0.2, 2.2.8, 2.3.5 and 4.2.1).
 *
 * Part of typed.h. Clocked variables have values only while one of their clocks is active: from when
 * it ticks until the discrete states are updated. In between they are set and got, and the signals
 * hold them until the next tick.
 */

#define SLACK 1e-9               /* of a step: two times closer than this are one */
enum { CALLS_AT_MOST = 100000 }; /* without getting anywhere, within one step */

/* A step being done: what everything in it needs. */
typedef struct {
    const unit_t *unit;
    double *signals;
    int *status;
    int32_t *failed;
} doing_t;

static int any_active(const typed_t *x, const int32_t *clocks, int64_t n)
{
    for (int64_t i = 0; i < n; i++)
        if (x->active[clocks[i]]) return 1;
    return 0;
}

/* Inputs whose clocks are active, once an instant. */
static int feed_partitions(const doing_t *d)
{
    const typed_t *x = d->unit->typed;
    int result = RUN_OK;

    for (int64_t i = 0; i < x->n_partitions && result == RUN_OK; i++) {
        partition_t *p = x->partitions + i;
        if (p->fed || !any_active(x, p->clocks, p->n_clocks)) continue;
        p->fed = 1;
        result = set_typed(p->inputs, p->n_inputs, d->unit->instance, d->signals, d->status,
                           d->failed);
    }
    return result;
}

/* Which clocks the FMU ticks itself; one that belongs to others only while these are active. */
static int ask_clocks(const doing_t *d)
{
    const typed_t *x = d->unit->typed;

    for (int64_t i = 0; i < x->n_triggered; i++) {
        const triggered_t *c = x->triggered + i;
        _Bool *active = x->active + x->n_clocks + i;
        if (c->n_clocks && !any_active(x, c->clocks, c->n_clocks)) continue;
        *d->status = ((get_clock_t3)x->get_clock)(d->unit->instance, &c->reference, 1, active);
        if (*d->status > 1) return RUN_EVENT;
    }
    return RUN_OK;
}

/* Clocked values of this instant, in and out. No clock is active afterwards. */
static int exchange(const doing_t *d)
{
    const typed_t *x = d->unit->typed;
    int result = feed_partitions(d);

    if (result == RUN_OK) result = ask_clocks(d);
    if (result == RUN_OK && x->n_triggered) result = feed_partitions(d);
    for (int64_t i = 0; i < x->n_partitions && result == RUN_OK; i++) {
        partition_t *p = x->partitions + i;
        if (p->fed)
            result = get_typed(p->outputs, p->n_outputs, d->unit->instance, d->signals, d->status,
                               d->failed);
        p->fed = 0;
    }
    memset(x->active, 0, (size_t)(x->n_clocks + x->n_triggered) * sizeof *x->active);
    return result;
}

/* fmi3UpdateDiscreteStates until nothing changes, then Step Mode. */
static int leave_event_mode(const doing_t *d)
{
    typed_t *x = d->unit->typed;
    void *instance = d->unit->instance;
    _Bool again = 1, terminate = 0, nominals, values, defined = 0;
    double next = 0.0;

    for (int i = 0; again && !terminate; i++) {
        const int result = exchange(d);
        if (result != RUN_OK) return result;
        if (i == CALLS_AT_MOST) return RUN_STUCK;
        again = 0;
        *d->status = ((update_t)x->update)(instance, &again, &terminate, &nominals, &values,
                                           &defined, &next);
        if (*d->status > 1) return RUN_EVENT;
    }
    x->next_event = defined ? next : DBL_MAX;
    if (terminate) return RUN_TERMINATED;
    *d->status = ((mode_t3)x->enter_step)(instance);
    return *d->status > 1 ? RUN_EVENT : RUN_OK;
}

static int enter_event_mode(const doing_t *d)
{
    *d->status = ((mode_t3)d->unit->typed->enter_event)(d->unit->instance);
    return *d->status > 1 ? RUN_EVENT : RUN_OK;
}

static int changed(const access_t *a, int64_t n, const double *s)
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

static int due(const ticker_t *c, int64_t hit)
{
    return hit >= c->shift && (hit - c->shift) % c->period == 0;
}

/* One event at the start of step `hit`: discrete inputs that changed, and all clocks due. */
static int input_event(const doing_t *d, int64_t hit)
{
    typed_t *x = d->unit->typed;
    void *instance = d->unit->instance;
    int result, needed = changed(x->discrete, x->n_discrete, d->signals), ticks = 0;

    for (int64_t i = 0; i < x->n_clocks; i++) ticks |= x->active[i] = due(x->clocks + i, hit);
    if (!needed && !ticks) return RUN_OK;
    result = enter_event_mode(d);
    for (int64_t i = 0; i < x->n_clocks && result == RUN_OK; i++) {
        if (!x->active[i]) continue;
        *d->status = ((set_clock_t3)x->set_clock)(instance, &x->clocks[i].reference, 1, x->active + i);
        if (*d->status > 1) return RUN_EVENT;
    }
    if (result == RUN_OK && needed)
        result = set_typed(x->discrete, x->n_discrete, instance, d->signals, d->status, d->failed);
    return result == RUN_OK ? leave_event_mode(d) : result;
}

/* doStep until t + h: the FMU may return early, and is stopped at the time events it announced. */
static int advance(const doing_t *d, double t)
{
    const unit_t *u = d->unit;
    typed_t *x = u->typed;
    const double end = t + u->h, slack = SLACK * u->h;
    double now = t;

    for (int calls = 0; calls < CALLS_AT_MOST; calls++) {
        _Bool event = 0, terminate = 0, early = 0;
        double length = calls ? end - now : u->h, reached = now + length;
        int cut = x->variable && x->next_event < end - slack && x->next_event > now + slack;
        if (cut) length = x->next_event - now;
        *d->status = ((step3_t)u->step)(u->instance, now, length, 1, &event, &terminate, &early,
                                        &reached);
        if (*d->status > 1) return RUN_STEP;
        if (terminate) return RUN_TERMINATED;
        now = early ? reached : cut ? x->next_event : end;
        if (x->update && (event || x->next_event <= now + slack)) {
            int result = enter_event_mode(d);
            if (result == RUN_OK) result = leave_event_mode(d);
            if (result != RUN_OK) return result;
        }
        if (now >= end - slack) return RUN_OK;
    }
    return RUN_STUCK;
}
