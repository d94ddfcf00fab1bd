/* clock.c - the model as the partition of a periodic input clock.
 *
 * Tick k is at start + k clock_interval. A step of the model belongs to the tick at which it starts, and
 * its outputs hold until the next tick. If the importer activates the clock (FMI 3.0, Event Mode), a
 * tick is computed when a value is read, computed again if inputs are set again, and made permanent when
 * the discrete states are updated. Otherwise `step_clocked` makes the ticks of a communication step.
 */
#include <math.h>
#include <string.h>

#include "instance.h"

static double tick_time(const Instance *x)
{
    return x->start_time + x->clock.count * declared.clock_interval;
}

/* Times that differ by less than this, in s, count as equal, because importers may round them. */
static double close_to(double t) { return 1e-6 * declared.clock_interval + 1e-12 * fabs(t); }

Status clock_activate(Instance *x, const char *function)
{
    const double t = x->values[TIME];
    if (x->clock.active) return STATUS_OK;
    if (!(fabs(t - tick_time(x)) <= close_to(t)))
        return refuse(x, function, "the clock ticks every %g s, next at t = %.17g s; it is %.17g s",
                      declared.clock_interval, tick_time(x), t);
    memcpy(x->clock.before, x->values, N_STORED * sizeof *x->values);
    x->clock.active = 1;
    x->stale = 1;
    return STATUS_OK;
}

/* Restore all values except the inputs to those before the tick. */
static void rewind_states(Instance *x)
{
    unsigned from = 0; /* the first that is not rewound yet */
    for (unsigned i = 0; i <= declared.n_input_ranges; i++) {
        const Range none = {N_STORED, 0};
        const Range inputs = i < declared.n_input_ranges ? input_ranges[i] : none;
        memcpy(x->values + from, x->clock.before + from, (inputs.first - from) * sizeof *x->values);
        from = inputs.first + inputs.size;
    }
}

Status clock_evaluate(Instance *x, const char *function)
{
    const double t = tick_time(x);
    if (!x->clock.active || !x->stale) return STATUS_OK;
    rewind_states(x);
    if (check_inputs(x, t, function) != STATUS_OK) return STATUS_DISCARD;
    const char *why = model_step((Model *)x->values, t, declared.clock_interval);
    if (why != NULL) return discard(x, function, "at t = %g s %s", t, why);
    x->stale = 0;
    return STATUS_OK;
}

Status clock_update(Instance *x, const char *function)
{
    if (!x->clock.active) return STATUS_OK;
    const Status status = clock_evaluate(x, function);
    if (status != STATUS_OK) return status;
    x->clock.active = 0;
    x->clock.count += 1.0;
    return STATUS_OK;
}

/* The importer's step from t to `end`, which must lie between two ticks that the importer activates. */
static Status step_between(const Instance *x, double t, double end, const char *function)
{
    const double tick = tick_time(x);
    if (tick >= end - close_to(end)) return STATUS_OK;
    return refuse(x, function,
                  "the clock has not ticked at %.17g s, within the step from %.17g s to %.17g s; it "
                  "ticks every %g s",
                  tick, t, end, declared.clock_interval);
}

Status step_clocked(Instance *x, double t, double h, const char *function)
{
    const double end = t + h, first = x->clock.count;
    if (x->clock.used) return step_between(x, t, end, function);
    memcpy(x->clock.before, x->values, N_STORED * sizeof *x->values);
    while (tick_time(x) < end - close_to(end)) {
        const double tick = tick_time(x), at = fabs(tick - t) <= close_to(t) ? t : tick;
        const char *why = model_step((Model *)x->values, at, declared.clock_interval);
        if (why != NULL) {
            memcpy(x->values, x->clock.before, N_STORED * sizeof *x->values);
            x->clock.count = first;
            return discard(x, function, "at t = %g s %s", at, why);
        }
        x->clock.count += 1.0;
    }
    return STATUS_OK;
}
