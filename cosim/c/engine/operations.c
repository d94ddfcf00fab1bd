/* operations.c: the operations of a tick: copies, links, records and steps, in the order of the plan. */
#include "engine_internal.h"

/* How old what a link holds is; before anything has arrived, as old as the run. */
static double age(const engine_t *e, int64_t tick, const operation_t *op)
{
    int64_t held = e->links[op->index].held;
    return (double)(tick - (held < 0 ? 0 : held) * op->source) * e->h;
}

/* The mean over a step of the line through this value and the last one, which is `op->period` ticks
 * older: half a step ahead of this value, or between the two. */
static void extrapolate(const operation_t *op, double *s)
{
    const double half = op->code == OP_AHEAD ? 0.5 : -0.5;
    const double *source = s + op->source;
    double *target = s + op->target, *last = s + op->index;

    for (int64_t i = 0; i < op->count; i++) {
        const double value = op->gain * source[i] + op->offset;
        target[i] = value + half * (value - last[i]);
        last[i] = value;
    }
}

/* The same line for an FMU that accepts slopes: the value at the start of its step and, after the last
 * values, its change per second. */
static void draw(const operation_t *op, double h, double *s)
{
    const double length = (double)op->period * h, *source = s + op->source;
    double *target = s + op->target, *last = s + op->index, *slope = last + op->count;

    for (int64_t i = 0; i < op->count; i++) {
        const double value = op->gain * source[i] + op->offset;
        target[i] = op->code == OP_SLOPE_AHEAD ? value : last[i];
        slope[i] = (value - last[i]) / length;
        last[i] = value;
    }
}

/* Executes one operation; returns RUN_OK or why not, and then which unit, link or gate in *failure. */
HOT int run_operation(engine_t *e, int64_t tick, double *s, const operation_t *op, failure_t *failure)
{
    switch (op->code) {
    case OP_COPY: copy(s + op->target, s + op->source, op->count); break;
    case OP_SCALE:
        for (int64_t i = 0; i < op->count; i++) s[op->target + i] = op->gain * s[op->source + i] + op->offset;
        break;
    case OP_AHEAD:
    case OP_BETWEEN: extrapolate(op, s); break;
    case OP_SLOPE_AHEAD:
    case OP_SLOPE_BETWEEN: draw(op, e->h, s); break;
    case OP_PUSH: push(e->senders + op->index, op, s + op->source); break;
    case OP_PULL: {
        const int result = pull(e->links + op->index, s + op->target);
        if (result != RUN_OK) failure->index = op->index;
        return result;
    }
    case OP_AGE: s[op->target] = age(e, tick, op); break;
    case OP_PLAY: return play(e->players + op->index, s + op->target);
    case OP_STEP:
        if (op->count) return step_units(e, tick, op, failure);
        return step_unit(e, tick, op->index, failure);
    case OP_GATE:
        if (e->gates[op->index].passing(e->gates[op->index].context, tick, s)) {
            failure->index = op->index;
            return RUN_GATE;
        }
        break;
    case OP_MACRO: return run_macro(e, tick, e->macros + op->index, failure);
    case OP_RECORD:
        if (e->record) record(e, tick, op);
        break;
    }
    return RUN_OK;
}

/* Steps of `*ticks` ticks, of fewer once one has failed: then only what fails sooner takes its place in *failure. */
static void run_often(const engine_t *e, int64_t tick, int64_t *ticks, const operation_t *op,
                      failure_t *failure)
{
    failure_t found = {-1, 0, 0, 0, 0, 0};

    if (*ticks == 0) return;
    found.result = step_often(e, tick, ticks, op, &found);
    if (found.result == RUN_OK) return;
    while (op->index != found.index) op++;
    found.operation = op - e->operations;
    *failure = found;
}

/* Executes operations from `first` to before `last`; steps of a tick are made `ticks` times. An FMU that ends the
 * simulation is kept in *ended, and the others go on; anything else that goes wrong ends it, and is in *failure.
 * If that has an operation already, it is the first one, whose step was made. */
HOT int run_operations(engine_t *e, int64_t tick, int64_t ticks, int64_t first, int64_t last,
                       failure_t *failure, failure_t *ended)
{
    double *const s = e->signals;
    const operation_t *const end = e->operations + last;
    int64_t left = ticks;
    int result = failure->operation < 0 ? RUN_OK : failure->result;

    for (const operation_t *op = e->operations + first;; op++) {
        const operation_t *last_done;
        if (result == RUN_OK && op < end && op->code == OP_STEP && e->units[op->index].plain)
            op = run_plain(e, tick, op, end, failure, &result);
        if (op >= end) break;
        last_done = op->code == OP_STEP ? op + op->count : op;
        if (result != RUN_OK) last_done = op;
        else if (ticks > 1 && op->code == OP_STEP && op->period == 1) run_often(e, tick, &left, op, failure);
        else result = run_operation(e, tick, s, op, failure);
        if (result == RUN_OK) {
            op = last_done;
            continue;
        }
        if (op->code == OP_STEP)
            while (op->index != failure->index) op++; /* of those at once */
        failure->result = result;
        failure->tick = tick;
        failure->operation = op - e->operations;
        if (result != RUN_TERMINATED) return result;
        *ended = *failure;
        failure->operation = -1;
        result = RUN_OK;
        if (e->units[op->index].kind == UNIT_REMOTE) op = last_done;
    }
    return left < ticks ? failure->result : RUN_OK;
}

/* All of `segments` that are due at a tick, and at the `ticks` - 1 after it, in which only steps of a tick are. */
HOT int run_tick(engine_t *e, int64_t tick, int64_t ticks, segment_t *segments, int64_t n_segments,
                 failure_t *failure, failure_t *ended)
{
    segment_t *const behind = segments + n_segments;

    for (segment_t *segment = segments; segment < behind; segment++) {
        int result;
        if (segment->next != tick) continue;
        segment->next = tick + (segment->period == 1 ? ticks : segment->period);
        result = run_operations(e, tick, ticks, segment->first, segment->last, failure, ended);
        if (result != RUN_OK) return result;
    }
    return RUN_OK;
}

/* Segments that others have run up to `tick` are due then, or later. */
HOT void catch_up(segment_t *segments, int64_t n_segments, int64_t tick)
{
    for (int64_t i = 0; i < n_segments; i++) {
        segment_t *x = segments + i;
        if (x->next < tick) x->next += (tick - x->next + x->period - 1) / x->period * x->period;
    }
}

SHARED int32_t keep_failure(engine_t *e, const failure_t *f, int32_t result)
{
    e->failed_index = f->index;
    e->failed_status = f->status;
    e->failed_signal = f->signal;
    e->failed_tick = f->tick;
    return result;
}
