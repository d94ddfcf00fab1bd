/* engine.c: executes a plan.
 *
 * A plan is a flat array of operations over one contiguous vector of doubles (the signals). Each
 * operation is due every `period` ticks; time is (tick * h), never a sum. The loop handles FMI
 * function pointers, ticks and signals only. It contains no code for Python, robots or networks,
 * and neither allocates nor prints. It is called with the GIL released, in chunks of ticks.
 */
#include "engine.h"

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

INLINE int step_fmi2(const unit_t *u, double *s, double t, int *status)
{
    if (u->n_inputs) {
        *status = ((set2_t)u->set)(u->instance, u->inputs, (size_t)u->n_inputs, s + u->input);
        if (failed_call(*status)) return RUN_SET;
    }
    *status = ((step2_t)u->step)(u->instance, t, u->h, 1);
    if (failed_call(*status)) return RUN_STEP;
    if (u->n_outputs) {
        *status = ((get2_t)u->get)(u->instance, u->outputs, (size_t)u->n_outputs, s + u->output);
        if (failed_call(*status)) return RUN_GET;
    }
    return RUN_OK;
}

INLINE int step_fmi3(unit_t *u, double *s, double t, int *status)
{
    _Bool event = 0, terminate = 0, early = 0;
    double reached = t;
    if (u->n_inputs) {
        *status = ((set3_t)u->set)(u->instance, u->inputs, (size_t)u->n_inputs, s + u->input,
                                   (size_t)u->input_count);
        if (failed_call(*status)) return RUN_SET;
    }
    *status = ((step3_t)u->step)(u->instance, t, u->h, 1, &event, &terminate, &early, &reached);
    if (failed_call(*status)) return RUN_STEP;
    if (early && !terminate) return RUN_EARLY_RETURN;
    if (u->n_outputs) {
        *status = ((get3_t)u->get)(u->instance, u->outputs, (size_t)u->n_outputs, s + u->output,
                                   (size_t)u->output_count);
        if (failed_call(*status)) return RUN_GET;
    }
    if (!terminate) return RUN_OK;
    u->reached = reached;
    return RUN_TERMINATED;
}

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

static int step_unit(engine_t *e, int32_t index)
{
    unit_t *u = e->units + index;
    double *s = e->signals;
    double t = (double)(e->tick - u->lag) * e->h;
    int status = 0, result = RUN_OK;

    if (u->kind == UNIT_FMI2) {
        result = step_fmi2(u, s, t, &status);
    } else if (u->kind == UNIT_FMI3) {
        result = step_fmi3(u, s, t, &status);
    } else if (u->kind == UNIT_TYPED) {
        result = step_typed(u, s, t, (e->tick - u->lag) / u->period, &status, &e->failed_signal);
    } else if (u->kind == UNIT_EXCHANGE) {
        result = step_exchange(u, s, t, &status, &e->failed_signal);
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
        e->failed_index = index;
        e->failed_status = status;
    }
    return result;
}

static void push(link_t *l, const operation_t *op, const double *value)
{
    double *sample = l->history + (l->sent % l->capacity) * l->width;
    if (op->gain == 1.0 && op->offset == 0.0)
        memcpy(sample, value, (size_t)l->width * sizeof *value);
    else
        for (int64_t i = 0; i < l->width; i++) sample[i] = op->gain * value[i] + op->offset;
    l->sent++;
}

/* The receiver keeps its sample; a value is copied only if the row changes. */
static int pull(link_t *l, double *target)
{
    int64_t held;
    const double *value = l->initial;

    if (l->row >= l->rows) return RUN_HISTORY;
    held = l->table[l->row++] - l->before;
    if (held < 0) held = -1;
    if (held == l->held) return RUN_OK;
    if (held >= 0) {
        if (held >= l->sent || held < l->sent - l->capacity) return RUN_HISTORY;
        value = l->history + (held % l->capacity) * l->width;
    }
    memcpy(target, value, (size_t)l->width * sizeof *value);
    l->held = held;
    return RUN_OK;
}

/* How old what a link holds is; before anything has arrived, as old as the run. */
static double age(const engine_t *e, const operation_t *op)
{
    int64_t held = e->links[op->index].held;
    return (double)(e->tick - (held < 0 ? 0 : held) * op->source) * e->h;
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

/* Runs `ticks` ticks; returns RUN_OK or why it stopped. e->tick is then the tick that failed. A tick in
 * which an FMU ends the simulation after its step (RUN_TERMINATED) is done to its end and counted. */
API int32_t engine_run(engine_t *e, int64_t ticks)
{
    double *s = e->signals;
    operation_t *const first = e->operations, *const last = first + e->n_operations;
    const int64_t end = e->tick + ticks;
    int32_t result = RUN_OK, terminated = 0;

    for (; e->tick < end; e->tick++) {
        const int64_t tick = e->tick;
        if (*(volatile int32_t *)&e->stop) return RUN_STOPPED;
        for (operation_t *op = first; op < last; op++) {
            if (op->next != tick) continue;
            op->next += op->period;
            switch (op->code) {
            case OP_COPY:
                for (int64_t i = 0; i < op->count; i++) s[op->target + i] = s[op->source + i];
                break;
            case OP_SCALE:
                for (int64_t i = 0; i < op->count; i++)
                    s[op->target + i] = op->gain * s[op->source + i] + op->offset;
                break;
            case OP_AHEAD:
            case OP_BETWEEN: extrapolate(op, s); break;
            case OP_SLOPE_AHEAD:
            case OP_SLOPE_BETWEEN: draw(op, e->h, s); break;
            case OP_PUSH: push(e->links + op->index, op, s + op->source); break;
            case OP_PULL:
                result = pull(e->links + op->index, s + op->target);
                if (result != RUN_OK) e->failed_index = op->index;
                break;
            case OP_AGE: s[op->target] = age(e, op); break;
            case OP_PLAY: result = play(e->players + op->index, s + op->target); break;
            case OP_STEP: result = step_unit(e, op->index); break;
            case OP_GATE:
                if (e->gates[op->index].passing(e->gates[op->index].context, tick, s)) {
                    e->failed_index = op->index;
                    result = RUN_GATE;
                }
                break;
            case OP_RECORD:
                if (e->record) {
                    memcpy(e->record + e->row * e->n_signals, s, (size_t)e->n_signals * sizeof *s);
                    e->row++;
                    if (e->recorded) publish(e->recorded, e->row);
                }
                break;
            }
            if (result == RUN_OK) continue;
            if (result != RUN_TERMINATED) return result;
            terminated = 1;
            result = RUN_OK;
        }
        if (terminated) {
            e->tick++;
            return RUN_TERMINATED;
        }
    }
    return RUN_OK;
}

#include "fmu_log.h"

API int32_t engine_abi(void) { return ENGINE_ABI; }
API size_t engine_sizes(int32_t which)
{
    static const size_t sizes[] = {sizeof(operation_t), sizeof(unit_t), sizeof(link_t),
                                   sizeof(engine_t), sizeof(log_t), sizeof(player_t),
                                   sizeof(access_t), sizeof(ticker_t), sizeof(typed_t),
                                   sizeof(gate_t), sizeof(triggered_t), sizeof(partition_t),
                                   sizeof(exchange_t)};
    return which >= 0 && which < 13 ? sizes[which] : 0;
}
