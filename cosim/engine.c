/* engine.c: executes a plan.
 *
 * A plan is a flat array of operations over one contiguous vector of doubles (the signals). Each
 * operation is due every `period` ticks; time is (tick * h), never a sum. The loop knows FMI
 * function pointers, ticks and signals. It knows no Python, no robot and no network, allocates
 * nothing, and prints nothing. Called with the GIL released, in chunks of ticks.
 */
#include <float.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

/* The common steps are part of the loop, though a lonely FMU's process calls them as well. */
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

#define ENGINE_ABI 7

enum { OP_COPY, OP_SCALE, OP_PUSH, OP_PULL, OP_STEP, OP_RECORD, OP_AGE, OP_PLAY,
       OP_AHEAD, OP_BETWEEN, OP_GATE, OP_SLOPE_AHEAD, OP_SLOPE_BETWEEN };
enum { UNIT_CALL = 0, UNIT_FMI2 = 2, UNIT_FMI3 = 3, UNIT_TYPED = 4 };
enum { RUN_OK, RUN_STOPPED, RUN_STEP, RUN_SET, RUN_GET, RUN_NOT_FINITE, RUN_HISTORY, RUN_TERMINATED,
       RUN_EARLY_RETURN, RUN_VALUE, RUN_EVENT, RUN_STUCK, RUN_GATE };
enum { TYPE_F64, TYPE_F32, TYPE_I8, TYPE_U8, TYPE_I16, TYPE_U16, TYPE_I32, TYPE_U32, TYPE_I64,
       TYPE_U64, TYPE_BOOL2, TYPE_BOOL3 };

typedef struct {
    int32_t code;
    int32_t index;          /* of the unit or link; of what was there last time, in signals */
    int64_t period, next;   /* ticks */
    int64_t source, target; /* into signals */
    int64_t count;
    double gain, offset;
} operation_t;

typedef int32_t (*call_t)(int32_t unit, double t, double h);
typedef int (*set2_t)(void *, const uint32_t *, size_t, const double *);
typedef int (*get2_t)(void *, const uint32_t *, size_t, double *);
typedef int (*step2_t)(void *, double, double, int);
typedef int (*set3_t)(void *, const uint32_t *, size_t, const double *, size_t);
typedef int (*get3_t)(void *, const uint32_t *, size_t, double *, size_t);
typedef int (*step3_t)(void *, double, double, _Bool, _Bool *, _Bool *, _Bool *, double *);

typedef int (*access2_t)(void *, const uint32_t *, size_t, void *);
typedef int (*access3_t)(void *, const uint32_t *, size_t, void *, size_t);
typedef int (*mode_t3)(void *);
typedef int (*update_t)(void *, _Bool *, _Bool *, _Bool *, _Bool *, _Bool *, double *);
typedef int (*set_clock_t3)(void *, const uint32_t *, size_t, const _Bool *);
typedef int (*get_clock_t3)(void *, const uint32_t *, size_t, _Bool *);
typedef int (*slopes2_t)(void *, const uint32_t *, size_t, const int32_t *, const double *);

/* All variables of one FMI type: one call moves them, by way of a buffer of that type. */
typedef struct {
    void *call;
    const uint32_t *references;
    const int64_t *places;  /* into signals, one a scalar */
    void *buffer;
    double *held;           /* what was set last, where only changes are; else NULL */
    int64_t n_references, count;
    int32_t type, fmi;
} access_t;

/* A clock that ticks every `period` steps of its FMU, first in step `shift`. */
typedef struct {
    uint32_t reference;
    int32_t reserved;
    int64_t period, shift;
} ticker_t;

/* A clock the FMU ticks itself; `clocks`: those it belongs to, as indices of typed_t's `active`. */
typedef struct {
    uint32_t reference;
    int32_t n_clocks;
    const int32_t *clocks;
} triggered_t;

/* Variables of the same clocks: set and got while one of them is active. */
typedef struct {
    const access_t *inputs, *outputs;
    const int32_t *clocks;  /* indices of `active` */
    int64_t n_inputs, n_outputs;
    int32_t n_clocks, fed;  /* fed: its inputs were set in this instant */
} partition_t;

/* An FMU with other types than float64, with event mode, with slopes of inputs, or all of it. */
typedef struct {
    const access_t *inputs, *outputs;
    const access_t *discrete;   /* inputs set in Event Mode, on change */
    const ticker_t *clocks;
    const triggered_t *triggered;
    partition_t *partitions;
    _Bool *active;              /* which tick now: of `clocks`, then of `triggered` */
    const access_t *slopes;     /* or NULL */
    const int32_t *orders;      /* of `slopes`: all 1 */
    void *enter_event, *update, *enter_step, *set_clock, *get_clock; /* NULL: no event mode */
    int64_t n_inputs, n_outputs, n_discrete, n_clocks, n_triggered, n_partitions;
    double next_event;      /* s, the time event it announced, or infinity */
    int32_t fmi, variable;  /* variable: steps may be cut at that time */
} typed_t;

typedef struct {
    int32_t kind, lag;      /* lag: ticks from the start of the interval to the tick of the step */
    double h;               /* s, length of a step */
    void *instance;
    void *set, *step, *get; /* FMI functions, or the call-back in `step` */
    const uint32_t *inputs, *outputs;   /* value references */
    int64_t n_inputs, n_outputs;        /* value references */
    int64_t input, input_count;         /* signals */
    int64_t output, output_count;
    typed_t *typed;
    int64_t period;         /* ticks */
} unit_t;

typedef struct {
    double *history;        /* capacity rows of `width`, in the receiver's unit */
    const int32_t *table;   /* held sample at each hit of the receiver, for this chunk */
    const double *initial;  /* pre-history */
    int64_t width, capacity, sent, row, rows, held;
    int64_t before;         /* samples sent before this began: it holds none of them */
} link_t;

typedef struct {
    const double *values;   /* one a hit of the receiver, for this chunk */
    int64_t row, rows;
} player_t;

/* Where signals leave the plan or enter it; what happens there is not the engine's business. */
typedef struct {
    int32_t (*pass)(void *context, int64_t tick, double *signals); /* not 0: the run stops */
    void *context;
} gate_t;

typedef struct {
    operation_t *operations;
    unit_t *units;
    link_t *links;
    player_t *players;
    gate_t *gates;
    double *signals;
    double *record;         /* rows of n_signals, or NULL */
    int64_t n_operations, n_signals;
    int64_t row, tick;
    double h;
    int32_t stop;           /* set from outside */
    int32_t failed_index, failed_status;
    int32_t failed_signal;
} engine_t;

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

INLINE int step_fmi2(const unit_t *u, double *s, double t, int *status)
{
    if (u->n_inputs) {
        *status = ((set2_t)u->set)(u->instance, u->inputs, (size_t)u->n_inputs, s + u->input);
        if (*status > 1) return RUN_SET;
    }
    *status = ((step2_t)u->step)(u->instance, t, u->h, 1);
    if (*status > 1) return RUN_STEP;
    if (u->n_outputs) {
        *status = ((get2_t)u->get)(u->instance, u->outputs, (size_t)u->n_outputs, s + u->output);
        if (*status > 1) return RUN_GET;
    }
    return RUN_OK;
}

INLINE int step_fmi3(const unit_t *u, double *s, double t, int *status)
{
    _Bool event = 0, terminate = 0, early = 0;
    double reached = t;
    if (u->n_inputs) {
        *status = ((set3_t)u->set)(u->instance, u->inputs, (size_t)u->n_inputs, s + u->input,
                                   (size_t)u->input_count);
        if (*status > 1) return RUN_SET;
    }
    *status = ((step3_t)u->step)(u->instance, t, u->h, 1, &event, &terminate, &early, &reached);
    if (*status > 1) return RUN_STEP;
    if (early) return RUN_EARLY_RETURN;
    if (u->n_outputs) {
        *status = ((get3_t)u->get)(u->instance, u->outputs, (size_t)u->n_outputs, s + u->output,
                                   (size_t)u->output_count);
        if (*status > 1) return RUN_GET;
    }
    return terminate ? RUN_TERMINATED : RUN_OK;
}

#include "typed.h"

/* One step of an FMU outside of a plan: for a process that has but one. */
API int32_t engine_unit(const unit_t *u, double *s, double t, int64_t hit, int32_t *status,
                        int32_t *failed)
{
    switch (u->kind) {
    case UNIT_FMI2: return step_fmi2(u, s, t, status);
    case UNIT_FMI3: return step_fmi3(u, s, t, status);
    default: return step_typed(u, s, t, hit, status, failed);
    }
}

static int step_unit(engine_t *e, int32_t index)
{
    const unit_t *u = e->units + index;
    double *s = e->signals;
    double t = (double)(e->tick - u->lag) * e->h;
    int status = 0, result = RUN_OK;

    if (u->kind == UNIT_FMI2) {
        result = step_fmi2(u, s, t, &status);
    } else if (u->kind == UNIT_FMI3) {
        result = step_fmi3(u, s, t, &status);
    } else if (u->kind == UNIT_TYPED) {
        result = step_typed(u, s, t, (e->tick - u->lag) / u->period, &status, &e->failed_signal);
    } else {
        status = ((call_t)u->step)(index, t, u->h);
        if (status) result = RUN_STEP;
    }
    if (result == RUN_OK && not_finite(s + u->output, u->output_count)) result = RUN_NOT_FINITE;
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

/* The receiver keeps what it holds; only a change is looked up. */
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

/* The same line, for an FMU that takes slopes: the value where its step begins, and behind the last
 * values what it changes by a second. */
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

/* Runs `ticks` ticks; returns RUN_OK or why it stopped. e->tick is then the tick that failed. */
API int32_t engine_run(engine_t *e, int64_t ticks)
{
    double *s = e->signals;
    operation_t *const first = e->operations, *const last = first + e->n_operations;
    const int64_t end = e->tick + ticks;
    int32_t result = RUN_OK;

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
                if (e->gates[op->index].pass(e->gates[op->index].context, tick, s)) {
                    e->failed_index = op->index;
                    result = RUN_GATE;
                }
                break;
            case OP_RECORD:
                if (e->record) {
                    memcpy(e->record + e->row * e->n_signals, s, (size_t)e->n_signals * sizeof *s);
                    e->row++;
                }
                break;
            }
            if (result != RUN_OK) return result;
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
                                   sizeof(gate_t), sizeof(triggered_t), sizeof(partition_t)};
    return which >= 0 && which < 12 ? sizes[which] : 0;
}
