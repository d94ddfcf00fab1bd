/* engine.c: executes a plan.
 *
 * A plan is a flat array of operations over one contiguous vector of doubles (the signals), in
 * segments that are due every `period` ticks; time is (tick * h), never a sum. The loop handles FMI
 * function pointers, ticks and signals only. It contains no code for Python, robots or networks,
 * and neither allocates nor prints. It is called with the GIL released, in chunks of ticks.
 */
#include "mailbox.h"

/* An exponent of all ones is not a finite number: one more carries into the sign bit. */
static int not_finite(const double *x, int64_t n)
{
    uint64_t carry = 0;
    for (int64_t i = 0; i < n; i++) {
        uint64_t bits;
        memcpy(&bits, x + i, sizeof bits);
        carry |= (bits & 0x7ff0000000000000u) + 0x0010000000000000u;
    }
    return carry >> 63 != 0;
}

/* Neither OK nor a warning; this includes values that FMI does not define, such as -1. */
INLINE int failed_call(int status) { return (unsigned)status > 1u; }

/* The inputs of a unit of `kind`, UNIT_FMI2 or UNIT_FMI3; returns the FMU's status. The values of our own
 * FMUs are open between steps. */
INLINE int set_inputs(const unit_t *u, int32_t kind, const double *s)
{
    s += u->input;
    if (u->values) {
        for (int64_t i = 0; i < u->n_inputs; i++) u->values[u->inputs[i]] = s[i];
        return 0;
    }
    if (!u->n_inputs) return 0;
    if (kind == UNIT_FMI2)
        return ((set2_t)u->set)(u->instance, u->inputs, (size_t)u->n_inputs, s);
    return ((set3_t)u->set)(u->instance, u->inputs, (size_t)u->n_inputs, s,
                            (size_t)u->input_count);
}

/* The same of the outputs. */
INLINE int get_outputs(const unit_t *u, int32_t kind, double *s)
{
    s += u->output;
    if (u->values) {
        for (int64_t i = 0; i < u->n_outputs; i++) s[i] = u->values[u->outputs[i]];
        return 0;
    }
    if (!u->n_outputs) return 0;
    if (kind == UNIT_FMI2)
        return ((get2_t)u->get)(u->instance, u->outputs, (size_t)u->n_outputs, s);
    return ((get3_t)u->get)(u->instance, u->outputs, (size_t)u->n_outputs, s,
                            (size_t)u->output_count);
}

INLINE int step_fmi2(const unit_t *u, double *s, double t, int *status)
{
    *status = set_inputs(u, UNIT_FMI2, s);
    if (failed_call(*status)) return RUN_SET;
    *status = ((step2_t)u->step)(u->instance, t, u->h, !u->repeats);
    if (failed_call(*status)) return RUN_STEP;
    *status = get_outputs(u, UNIT_FMI2, s);
    return failed_call(*status) ? RUN_GET : RUN_OK;
}

INLINE int step_fmi3(unit_t *u, double *s, double t, int *status)
{
    _Bool event = 0, terminate = 0, early = 0;
    double reached = t;
    *status = set_inputs(u, UNIT_FMI3, s);
    if (failed_call(*status)) return RUN_SET;
    *status = ((step3_t)u->step)(u->instance, t, u->h, !u->repeats, &event, &terminate, &early,
                                 &reached);
    if (failed_call(*status)) return RUN_STEP;
    if (early && !terminate) return RUN_EARLY_RETURN;
    *status = get_outputs(u, UNIT_FMI3, s);
    if (failed_call(*status)) return RUN_GET;
    if (!terminate) return RUN_OK;
    u->reached = reached;
    return RUN_TERMINATED;
}

#include "fmu_log.h"
#include "typed.h"
#include "exchange.h"

/* One step of an FMU outside of a plan: for a process that has but one. */
API int32_t engine_unit(unit_t *u, double *s, double t, int64_t hit, int32_t *status,
                        int32_t *failed)
{
    switch (u->kind) {
    case UNIT_FMI2: return step_fmi2(u, s, t, status);
    case UNIT_FMI3: return step_fmi3(u, s, t, status);
    case UNIT_EXCHANGE: return step_exchange(u, s, t, status, failed);
    default: return step_typed(u, s, t, hit, status, failed);
    }
}

/* The time of a tick, s. */
INLINE double time_of(const engine_t *e, int64_t tick) { return e->start + (double)tick * e->h; }

/* A step of a unit from t (s); `tick`: the one in which it ends. */
INLINE int step_from(const engine_t *e, int64_t tick, double t, int32_t index, failure_t *failure)
{
    unit_t *u = e->units + index;
    double *s = e->signals;
    int status = 0, result = RUN_OK;

    if (u->kind == UNIT_FMI2) {
        result = step_fmi2(u, s, t, &status);
    } else if (u->kind == UNIT_FMI3) {
        result = step_fmi3(u, s, t, &status);
    } else if (u->kind == UNIT_TYPED) {
        result = step_typed(u, s, t, (tick - u->lag) / u->period, &status, &failure->signal);
    } else if (u->kind == UNIT_EXCHANGE) {
        result = step_exchange(u, s, t, &status, &failure->signal);
    } else if (u->kind == UNIT_REMOTE) {
        mailbox_ask(u, s, t, (tick - u->lag) / u->period);
        result = mailbox_answer(u, s, &u->reached, &status, &failure->signal);
    } else if (u->kind == UNIT_NATIVE) {
        if (((native_t)u->step)(u->instance, t, u->h, s + u->input, s + u->output))
            result = RUN_STEP;
    } else {
        result = ((call_t)u->step)(index, t, u->h);
    }
    if ((result == RUN_OK || result == RUN_TERMINATED) &&
        not_finite(s + u->output, u->output_count))
        result = RUN_NOT_FINITE;
    if (result != RUN_OK) {
        failure->index = index;
        failure->status = status;
    }
    return result;
}

INLINE int step_unit(const engine_t *e, int64_t tick, int32_t index, failure_t *failure)
{
    return step_from(e, tick, time_of(e, tick - e->units[index].lag), index, failure);
}

/* The outputs of a unit whose step had this status. */
INLINE int take_outputs(const engine_t *e, int32_t index, int status, failure_t *failure)
{
    const unit_t *u = e->units + index;
    int result = RUN_OK;

    if (failed_call(status))
        result = RUN_STEP;
    else if (failed_call(status = get_outputs(u, u->kind, e->signals)))
        result = RUN_GET;
    else if (not_finite(e->signals + u->output, u->output_count))
        result = RUN_NOT_FINITE;
    if (result != RUN_OK) {
        failure->index = index;
        failure->status = status;
    }
    return result;
}

#include "together.h"

/* Copy few numbers: a call of memcpy costs more. */
INLINE void copy(double *target, const double *source, int64_t n)
{
    for (int64_t i = 0; i < n; i++) target[i] = source[i];
}

INLINE void push(sender_t *l, const operation_t *op, const double *value)
{
    double *sample = l->history + (l->sent & (l->capacity - 1)) * l->width;
    if (op->gain == 1.0 && op->offset == 0.0)
        copy(sample, value, l->width);
    else
        for (int64_t i = 0; i < l->width; i++) sample[i] = op->gain * value[i] + op->offset;
    publish(&l->sent, l->sent + 1);
}

/* The receiver keeps its sample; a value is copied only if the row changes. */
INLINE int pull(link_t *l, double *target)
{
    const sender_t *from = l->sender;
    const double *value = l->initial;
    int64_t held;

    if (l->row >= l->rows) return RUN_HISTORY;
    held = l->table[l->row++] - l->before;
    if (held < 0) held = -1;
    if (held == l->held) return RUN_OK;
    if (held >= 0) {
        const int64_t sent = published(&from->sent);
        if (held >= sent || held < sent - from->capacity) return RUN_HISTORY;
        value = from->history + (held & (from->capacity - 1)) * from->width;
    }
    copy(target, value, from->width);
    l->held = held;
    return RUN_OK;
}

/* How old what a link holds is; before anything has arrived, as old as the run. */
static double age(const engine_t *e, int64_t tick, const operation_t *op)
{
    int64_t held = e->links[op->index].held;
    return (double)(tick - (held < 0 ? 0 : held) * op->source) * e->h;
}

/* What is recorded goes to the row of this tick. */
INLINE void record(engine_t *e, int64_t tick, const operation_t *op)
{
    const columns_t *columns = e->columns + op->index;
    const int64_t n = e->every > 1 && tick % e->every ? 0 : columns->n_stretches;
    double *row = e->record + (e->row + tick - e->tick) * e->width;

    for (int64_t i = 0; i < n; i++) {
        const stretch_t *x = columns->stretches + i;
        if (x->count > 64)
            memcpy(row + x->place, e->signals + x->source, (size_t)x->count * sizeof *row);
        else
            copy(row + x->place, e->signals + x->source, x->count);
    }
    if (!op->count) return;
    e->row++;
    if (e->recorded) publish(e->recorded, e->row);
}

static int play(player_t *p, double *target)
{
    if (p->row >= p->rows) return RUN_HISTORY;
    *target = p->values[p->row++];
    return RUN_OK;
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

#include "rollback.h"
#include "direct.h"
#include "macro.h"

/* Executes one operation; returns RUN_OK or why not, and then which unit, link or gate in *failure. */
INLINE int run_operation(engine_t *e, int64_t tick, double *s, const operation_t *op,
                         failure_t *failure)
{
    switch (op->code) {
    case OP_COPY:
        copy(s + op->target, s + op->source, op->count);
        break;
    case OP_SCALE:
        for (int64_t i = 0; i < op->count; i++)
            s[op->target + i] = op->gain * s[op->source + i] + op->offset;
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
 * simulation is kept in *ended, and the others go on; anything else that goes wrong ends it, and is in *failure. */
INLINE int run_operations(engine_t *e, int64_t tick, int64_t ticks, int64_t first, int64_t last,
                          failure_t *failure, failure_t *ended)
{
    double *const s = e->signals;
    const operation_t *const end = e->operations + last;
    int64_t left = ticks;

    for (const operation_t *op = e->operations + first; op < end; op++) {
        const operation_t *const last_done = op->code == OP_STEP ? op + op->count : op;
        int result = RUN_OK;
        if (ticks > 1 && op->code == OP_STEP && op->period == 1)
            run_often(e, tick, &left, op, failure);
        else
            result = run_operation(e, tick, s, op, failure);
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
        if (e->units[op->index].kind == UNIT_REMOTE) op = last_done;
    }
    return left < ticks ? failure->result : RUN_OK;
}

/* All of `segments` that are due at a tick, and at the `ticks` - 1 after it, in which only steps of a tick are. */
INLINE int run_tick(engine_t *e, int64_t tick, int64_t ticks, segment_t *segments,
                    int64_t n_segments, failure_t *failure, failure_t *ended)
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
INLINE void catch_up(segment_t *segments, int64_t n_segments, int64_t tick)
{
    for (int64_t i = 0; i < n_segments; i++) {
        segment_t *x = segments + i;
        if (x->next < tick) x->next += (tick - x->next + x->period - 1) / x->period * x->period;
    }
}

NOINLINE int32_t failed(engine_t *e, const failure_t *f, int32_t result)
{
    e->failed_index = f->index;
    e->failed_status = f->status;
    e->failed_signal = f->signal;
    e->failed_tick = f->tick;
    return result;
}

#include "parts.h"

/* Runs `ticks` ticks; returns RUN_OK or why it stopped. e->tick is then the tick that failed. A tick in
 * which an FMU ends the simulation after its step (RUN_TERMINATED) is done to its end and counted. */
API int32_t engine_run(engine_t *e, int64_t ticks)
{
    const int64_t end = e->tick + ticks;
    failure_t failure = {-1, 0, 0, 0, 0, 0}, ended = {-1, 0, 0, 0, 0, 0};

    if (e->team) return run_windows(e, end);
    catch_up(e->segments, e->n_segments, e->tick);
    for (; e->tick < end; e->tick++) {
        int result;
        if (*(volatile int32_t *)&e->stop) return RUN_STOPPED;
        result = run_tick(e, e->tick, 1, e->segments, e->n_segments, &failure, &ended);
        if (result != RUN_OK) return failed(e, &failure, result);
        if (ended.operation < 0) continue;
        e->tick++;
        return failed(e, &ended, RUN_TERMINATED);
    }
    return RUN_OK;
}

#include "many.h"
