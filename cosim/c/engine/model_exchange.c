/* model_exchange.c: one communication step of an FMU for model exchange: integration, with its events.
 *
 * The states go from event to event: time events are hit exactly, state events (an
 * indicator changes between "> 0" and "<= 0", FMI 2.0.5 3.1.1, 3.0.2 3.1.1) are located to the resolution
 * of time, and step events come from the FMU after each step. Indicators are compared with what they were
 * after the last event, and the FMU enters Event Mode at the right end of the bracket, where its relation
 * has changed. Inputs are constant over a communication step; a new value is an event.
 */
#include "engine_internal.h"

typedef int (*completed2_t)(void *, int, int *, int *);
typedef int (*completed3_t)(void *, _Bool, _Bool *, _Bool *);
typedef struct {
    int again, terminate, nominals, values, defined;
    double next;
} event_info_t;
typedef int (*new_states2_t)(void *, event_info_t *);
/* FMI 1.0: Booleans are char, and there are no modes. */
typedef int (*completed1_t)(void *, char *);
typedef struct {
    char converged, references, values, terminate, defined;
    double next;
} event_info1_t;
typedef int (*event_update1_t)(void *, char, event_info1_t *);

/* Whether indicator j of z is in another domain than after the last event. */
static int differs(const exchange_t *x, const double *z, int64_t j)
{
    const int now = z[j] > 0.0, before = indicators(x, BEFORE)[j] > 0.0;
    return now != before;
}

static int crossed(const exchange_t *x, const double *z)
{
    for (int64_t j = 0; j < x->n_indicators; j++)
        if (differs(x, z, j)) return 1;
    return 0;
}

/* A bracket of the first event: no indicator has changed its domain at `a`, one has at `b`. `weight`: of
 * the values at both ends (the Illinois method); `turns`: trials since the bracket was `wide`. */
typedef struct {
    double a, b, weight_a, weight_b, wide;
    const double *before, *after;
    int turns, last;
} bracket_t;

/* Where the line between the ends is zero first; the middle where lines have not halved the bracket. */
static double guess(const exchange_t *x, bracket_t *k)
{
    double first = k->b;

    if (k->turns++ == 3) {
        const int slow = k->b - k->a > 0.5 * k->wide;
        k->turns = 0, k->wide = k->b - k->a;
        if (slow) return k->a + 0.5 * (k->b - k->a);
    }
    for (int64_t j = 0; j < x->n_indicators; j++) {
        const double p = k->weight_a * k->before[j], q = k->weight_b * k->after[j];
        double t;
        if (!differs(x, k->after, j)) continue;
        t = q == p ? k->a : k->b - q * (k->b - k->a) / (q - p);
        if (t < first) first = t;
    }
    return first;
}

/* An end that stays twice counts half, so that the other one comes to move. */
static void narrow(bracket_t *k, double t, int left)
{
    if (left) {
        k->a = t, k->weight_a = 1.0;
        k->weight_b = k->last == 1 ? 0.5 * k->weight_b : 1.0;
    } else {
        k->b = t, k->weight_b = 1.0;
        k->weight_a = k->last == 2 ? 0.5 * k->weight_a : 1.0;
    }
    k->last = left ? 1 : 2;
}

/* The first event of the step to *end: *end becomes the first time after it, END the states there. */
static int locate(const exchanging_t *d, double *end)
{
    const exchange_t *x = d->x;
    const int64_t n = x->n_indicators;
    const double fine = time_resolution(x->now, *end), last = *end;
    double *before = indicators(x, LEFT), *after = indicators(x, AFTER);
    double *tried = indicators(x, TRIED);
    bracket_t k = {x->now, *end, 1.0, 1.0, *end - x->now, before, after, 0, 0};
    int result = RUN_OK;

    memcpy(before, indicators(x, BEFORE), (size_t)n * sizeof *before);
    while (k.b - k.a > fine && result == RUN_OK) {
        double t = guess(x, &k), *y = states(x, TRIAL);
        if (!(t > k.a + 0.5 * fine)) t = k.a + 0.5 * fine;
        if (!(t < k.b - 0.5 * fine)) t = k.b - 0.5 * fine;
        if (!(t > k.a && t < k.b)) break;
        result = interpolate(d, t, last, y);
        if (result == RUN_OK) result = put_states(d, t, y);
        if (result == RUN_OK) result = indicate(d, tried);
        if (result != RUN_OK) break;
        narrow(&k, t, !crossed(x, tried));
        memcpy(k.a == t ? before : after, tried, (size_t)n * sizeof *tried);
    }
    if (result == RUN_OK) result = interpolate(d, k.b, last, states(x, TRIAL));
    memcpy(states(x, END), states(x, TRIAL), (size_t)x->n_states * sizeof(double));
    *end = k.b;
    return result;
}

/* Tell the FMU that the step is done: whether it wants an event, or to end the simulation. */
static int complete(const exchanging_t *d, int *event, int *terminate)
{
    const exchange_t *x = d->x;
    _Bool wants = 0, ends = 0;
    int result;

    *event = *terminate = 0;
    if (!x->completed) return RUN_OK;
    if (x->fmi == 1) {
        char called = 0;
        result = did(d, ((completed1_t)x->completed)(d->fmu, &called), RUN_STEP);
        *event = called;
        return result;
    }
    if (x->fmi == 2)
        return did(d, ((completed2_t)x->completed)(d->fmu, !d->unit->repeats, event, terminate), RUN_STEP);
    result = did(d, ((completed3_t)x->completed)(d->fmu, !d->unit->repeats, &wants, &ends), RUN_STEP);
    *event = wants, *terminate = ends;
    return result;
}

static int update_states(const exchanging_t *d, event_info_t *info)
{
    const exchange_t *x = d->x;
    _Bool again = 0, terminate = 0, nominals = 0, values = 0, defined = 0;
    int result;

    info->again = info->defined = 0;
    if (x->fmi == 1) {
        event_info1_t one = {1, 0, 0, 0, 0, 0.0};
        result = did(d, ((event_update1_t)x->update)(d->fmu, 0, &one), RUN_EVENT);
        info->again = !one.converged, info->terminate = one.terminate, info->nominals = 0;
        info->values = one.values, info->defined = one.defined, info->next = one.next;
        return result;
    }
    if (x->fmi == 2) return did(d, ((new_states2_t)x->update)(d->fmu, info), RUN_EVENT);
    result =
        did(d, ((update_t)x->update)(d->fmu, &again, &terminate, &nominals, &values, &defined, &info->next),
            RUN_EVENT);
    info->again = again, info->terminate = terminate, info->nominals = nominals;
    info->values = values, info->defined = defined;
    return result;
}

/* An event, with the inputs if they are new: the FMU is in Continuous-Time Mode before and after it. */
static int handle_event(const exchanging_t *d, int inputs)
{
    exchange_t *x = d->x;
    const typed_t *typed = d->unit->typed;
    event_info_t info = {1, 0, 0, 0, 0, 0.0};
    int nominals = 0, result = RUN_OK;

    if (x->enter_event) result = did(d, ((mode_t3)x->enter_event)(d->fmu), RUN_EVENT);

    x->events++;
    note_event(typed, x->now);
    if (result == RUN_OK && inputs)
        result = set_typed(typed->discrete, typed->n_discrete, d->fmu, d->signals, d->status, d->failed);
    for (int i = 0; result == RUN_OK && info.again && !info.terminate; i++) {
        if (i == CALLS_AT_MOST) return RUN_STUCK;
        result = update_states(d, &info);
        nominals |= info.nominals;
    }
    if (result != RUN_OK) return result;
    x->next_event = info.defined ? info.next : DBL_MAX;
    x->fresh = 1;
    if (info.terminate) {
        d->unit->reached = x->now;
        return RUN_TERMINATED;
    }
    if (x->enter_continuous) result = did(d, ((mode_t3)x->enter_continuous)(d->fmu), RUN_EVENT);
    return result == RUN_OK && nominals && x->cvode ? cvode_tolerances(d) : result;
}

/* One step of the solver to `bound` at most, and the events at its end. */
static int move(const exchanging_t *d, double bound)
{
    exchange_t *x = d->x;
    double end = bound;
    int found = 0, wanted = 0, terminate = 0;
    int result = x->fresh ? solver_restart(d) : RUN_OK;

    if (result == RUN_OK) result = solver_step(d, bound, &end);
    if (result == RUN_OK) result = put_states(d, end, states(x, END));
    if (result == RUN_OK) result = indicate(d, indicators(x, AFTER));
    if (result == RUN_OK && (found = crossed(x, indicators(x, AFTER)))) {
        result = locate(d, &end);
        if (result == RUN_OK) result = put_states(d, end, states(x, END));
    }
    if (result != RUN_OK) return result;
    x->now = end;
    memcpy(states(x, START), states(x, END), (size_t)x->n_states * sizeof(double));
    memcpy(indicators(x, BEFORE), indicators(x, AFTER), (size_t)x->n_indicators * sizeof(double));
    result = complete(d, &wanted, &terminate);
    if (result == RUN_OK && terminate) {
        d->unit->reached = x->now;
        return RUN_TERMINATED;
    }
    return result == RUN_OK && (found || wanted) ? handle_event(d, 0) : result;
}

/* From event to event until the end of the communication step. */
static int integrate(const exchanging_t *d, double end)
{
    exchange_t *x = d->x;
    const double slack = SLACK * d->unit->h;
    const int64_t most = x->events + CALLS_AT_MOST;
    int result = RUN_OK;

    while (result == RUN_OK && (x->next_event <= x->now || x->now < end - slack)) {
        if (x->events > most) return RUN_STUCK;
        if (x->next_event <= x->now) result = handle_event(d, 0);
        else result = move(d, x->next_event <= end + slack ? x->next_event : end);
    }
    return result;
}

SHARED int step_exchange(unit_t *u, double *s, double t, int *status, int32_t *failed)
{
    exchange_t *x = u->exchange;
    const typed_t *typed = u->typed;
    const exchanging_t d = {u, x, u->instance, s, status, failed};
    int result = RUN_OK, end;

    if (x->now < t || x->now > t + SLACK * u->h) x->now = t;
    if (changed(typed->discrete, typed->n_discrete, s)) result = handle_event(&d, 1);
    if (result != RUN_OK) return result == RUN_TERMINATED ? RUN_ENDED : result;
    end = integrate(&d, t + u->h);
    if (end != RUN_OK && end != RUN_TERMINATED) return end;
    result = get_typed(typed->outputs, typed->n_outputs, u->instance, s, status, failed);
    return result != RUN_OK ? result : end;
}
