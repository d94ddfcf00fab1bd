/* plain_steps.c: copies, links, records, and steps of units that are called through FMI only and begin at their tick.
 * That is most of what a plan has, and all of many; apart from the rest, a compiler keeps in registers what it takes.
 */
#include "engine_internal.h"

HOT void push(sender_t *l, const operation_t *op, const double *value)
{
    double *sample = l->history + (l->sent & (l->capacity - 1)) * l->width;
    if (op->gain == 1.0 && op->offset == 0.0) copy(sample, value, l->width);
    else
        for (int64_t i = 0; i < l->width; i++) sample[i] = op->gain * value[i] + op->offset;
    publish(&l->sent, l->sent + 1);
}

/* The receiver keeps its sample; a value is copied only if the row changes. */
HOT int pull(link_t *l, double *target)
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

HOT int play(player_t *p, double *target)
{
    if (p->row >= p->rows) return RUN_HISTORY;
    *target = p->values[p->row++];
    return RUN_OK;
}

INLINE void fill_row(double *row, const columns_t *columns, const double *s)
{
    const stretch_t *const end = columns->stretches + columns->n_stretches;

    for (const stretch_t *x = columns->stretches; x < end; x++) copy(row + x->place, s + x->source, x->count);
}

INLINE void count_row(engine_t *e)
{
    e->row++;
    if (e->recorded) publish(e->recorded, e->row);
}

/* What is recorded goes to the row of this tick. */
HOT void record(engine_t *e, int64_t tick, const operation_t *op)
{
    double *const row = e->record + (e->row + tick - e->tick) * e->width;

    if (e->every <= 1 || tick % e->every == 0) fill_row(row, e->columns + op->index, e->signals);
    if (op->count) count_row(e);
}

/* The steps of units of one kind that follow each other in one loop; *op becomes the one whose step was not RUN_OK, or
 * is behind them. */
INLINE int run_steps(engine_t *e, int64_t tick, double t, const operation_t **op, failure_t *failure)
{
    unit_t *const first = e->units + (*op)->index, *u = first;
    const unit_t *const last = first + (*op)->count;
    int32_t *const signal = &failure->signal;
    double *const s = e->signals;
    int status = 0, result;

    if (u->plain == UNIT_FMI2) result = step_each(UNIT_FMI2, &u, last, s, t, &status, signal);
    else if (u->plain == UNIT_FMI3) result = step_each(UNIT_FMI3, &u, last, s, t, &status, signal);
    else if (u->plain == UNIT_DIRECT) result = step_each(UNIT_DIRECT, &u, last, s, t, &status, signal);
    else result = step_plain_typed(u, s, tick, t, &status, signal);
    *op += result == RUN_OK ? (*op)->count + 1 : u - first;
    if (result == RUN_OK) return RUN_OK;
    failure->index = (*op)->index;
    failure->status = status;
    return result;
}

/* Runs such operations. Returns the first one that is another, or that was not RUN_OK: see *result and *failure. */
SHARED NOINLINE const operation_t *run_plain(engine_t *e, int64_t tick, const operation_t *op,
                                             const operation_t *end, failure_t *failure, int *result)
{
    double *const s = e->signals;
    const double t = time_of(e, tick);

    while (op < end) {
        switch (op->code) {
        case OP_COPY: copy(s + op->target, s + op->source, op->count); break;
        case OP_STEP:
            if (!e->units[op->index].plain) return op;
            *result = run_steps(e, tick, t, &op, failure);
            if (*result != RUN_OK) return op;
            continue;
        case OP_PUSH: push(e->senders + op->index, op, s + op->source); break;
        case OP_PULL:
            *result = pull(e->links + op->index, s + op->target);
            if (*result == RUN_OK) break;
            failure->index = op->index;
            return op;
        case OP_RECORD:
            if (e->record) record(e, tick, op);
            break;
        default: return op;
        }
        op++;
    }
    return op;
}

/* Ticks up to `end` that are a row, if one is recorded, copies, and steps of units of one kind which follow each other:
 * these begin with *op, which becomes the one whose step was not RUN_OK. */
INLINE int run_cycles(int32_t kind, engine_t *e, int64_t end, const operation_t *first,
                      const operation_t **op, failure_t *failure)
{
    const operation_t *const steps = *op;
    const columns_t *const kept = e->record && first->code == OP_RECORD ? e->columns + first->index : NULL;
    double *row = kept ? e->record + e->row * e->width : NULL, *const s = e->signals;
    unit_t *const first_unit = e->units + steps->index, *const last_unit = first_unit + steps->count;

    if (first->code == OP_RECORD) first++;
    for (; e->tick < end && !*(volatile int32_t *)&e->stop; e->tick++) {
        unit_t *u = first_unit;
        int status = 0, result;
        if (kept) {
            if (e->every <= 1 || e->tick % e->every == 0) fill_row(row, kept, s);
            row += e->width;
            count_row(e);
        }
        for (const operation_t *x = first; x < steps; x++) copy(s + x->target, s + x->source, x->count);
        result = step_each(kind, &u, last_unit, s, time_of(e, e->tick), &status, &failure->signal);
        if (result == RUN_OK) continue;
        *op = steps + (u - first_unit);
        failure->index = (*op)->index;
        failure->status = status;
        return result;
    }
    return RUN_OK;
}

/* The first step of a plan whose ticks are such cycles, from `first` on; or NULL. */
static const operation_t *cycle_of(const engine_t *e, const operation_t *first)
{
    const operation_t *const last = e->operations + e->segments->last, *op = first;

    if (e->n_segments != 1 || e->segments->period != 1 || e->segments->next != e->tick) return NULL;
    if (op < last && op->code == OP_RECORD && op->count) op++;
    while (op < last && op->code == OP_COPY) op++;
    if (op == last || op->code != OP_STEP || op + op->count + 1 != last) return NULL;
    return e->units[op->index].plain == UNIT_TYPED ? NULL : op;
}

/* Runs ticks up to `end` of a plan that has nothing else; the operation that ended that, or NULL. */
SHARED NOINLINE const operation_t *run_ticks(engine_t *e, int64_t end, failure_t *failure, int *result)
{
    segment_t *const segments = e->segments, *const behind = segments + e->n_segments;
    const operation_t *const first = e->operations + segments->first, *op = cycle_of(e, first);

    if (op) {
        switch (e->units[op->index].plain) {
        case UNIT_FMI2: *result = run_cycles(UNIT_FMI2, e, end, first, &op, failure); break;
        case UNIT_FMI3: *result = run_cycles(UNIT_FMI3, e, end, first, &op, failure); break;
        default: *result = run_cycles(UNIT_DIRECT, e, end, first, &op, failure);
        }
        segments->next = e->tick + (*result != RUN_OK);
        return *result == RUN_OK ? NULL : op;
    }
    for (; e->tick < end && !*(volatile int32_t *)&e->stop; e->tick++) {
        for (segment_t *x = segments; x < behind; x++) {
            const operation_t *const last = e->operations + x->last;
            if (x->next != e->tick) continue;
            x->next = e->tick + x->period;
            op = run_plain(e, e->tick, e->operations + x->first, last, failure, result);
            if (op < last) return op;
        }
    }
    return NULL;
}

static int32_t plain_kind(const unit_t *u)
{
    const int numbers = (u->kind == UNIT_FMI2 || u->kind == UNIT_FMI3) && !u->values;
    if (u->lag || u->repeats || !(numbers || u->kind == UNIT_TYPED)) return 0;
    return u->direct ? UNIT_DIRECT : u->kind;
}

static int is_plain(const operation_t *op)
{
    return op->code == OP_COPY || op->code == OP_PUSH || op->code == OP_PULL || op->code == OP_RECORD;
}

/* Finds the units that are plain, and how many follow each other; returns whether a plan has nothing but such operations. */
SHARED int find_plain(engine_t *e)
{
    int all = 1;

    for (const segment_t *x = e->segments; x < e->segments + e->n_segments; x++) {
        operation_t *const first = e->operations + x->first, *const last = e->operations + x->last - 1;
        for (operation_t *op = last; op >= first; op--) {
            const int next = op < last && op[1].code == OP_STEP && op[1].index == op->index + 1;
            unit_t *u;
            if (op->code != OP_STEP) {
                all = all && is_plain(op);
                continue;
            }
            u = e->units + op->index;
            u->plain = plain_kind(u);
            all = all && u->plain;
            if (!u->plain) continue;
            op->count = next && u->plain != UNIT_TYPED && u[1].plain == u->plain ? op[1].count + 1 : 0;
        }
    }
    return all;
}
