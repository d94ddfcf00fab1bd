/* many.h: executions of plans that differ in numbers only, an operation of all of them at a time.
 *
 * Part of engine.c. Each execution has an engine of its own, with its own signals, tables and records; none
 * sees another one. What they have in common is which operation is due when, so that the steps of instances
 * of one FMU, which belong to different executions, can be done at once. An execution that fails or ends is
 * left out from then on, as it stands; the others go on.
 */
enum { MANY = 16 };             /* executions, at most */

/* Executions that still run, by their number, and what became of each. */
typedef struct {
    engine_t *const *engines;
    int32_t *results;
    int64_t n;
    int32_t running[MANY];
    failure_t ended[MANY];      /* by an FMU, in this tick; `operation` -1: not */
} many_t;

NOINLINE void leave(many_t *m, int32_t number, int64_t tick, const failure_t *f, int result)
{
    engine_t *const e = m->engines[number];
    int64_t kept = 0;

    e->tick = tick;
    m->results[number] = result == RUN_STOPPED ? result : failed(e, f, result);
    for (int64_t k = 0; k < m->n; k++)
        if (m->running[k] != number) m->running[kept++] = m->running[k];
    m->n = kept;
}

/* What an operation came to in one execution, if not RUN_OK. */
NOINLINE void take_note(many_t *m, int32_t number, int64_t tick, failure_t *f, int result)
{
    f->result = result;
    f->tick = tick;
    f->operation = 0;
    if (result == RUN_TERMINATED)
        m->ended[number] = *f;  /* the others of its tick are done */
    else
        leave(m, number, tick, f, result);
}

/* The step of operation `place` and of the `count` behind it in all executions, at once. */
NOINLINE void step_all(many_t *m, int64_t tick, int64_t place, int64_t count)
{
    void *instances[MANY * AT_ONCE];
    int status[MANY * AT_ONCE];
    const int64_t n = m->n;
    const unit_t *first = NULL;
    size_t filled = 0;
    int refused[MANY] = {0}, status_of_inputs[MANY];
    int32_t numbers[MANY];

    for (int64_t k = 0; k < n; k++) {
        const engine_t *e = m->engines[numbers[k] = m->running[k]];
        const size_t before = filled;
        for (int64_t i = 0; i <= count && !refused[k]; i++) {
            const unit_t *u = e->units + e->operations[place + i].index;
            first = u;
            refused[k] = failed_call(status_of_inputs[k] = set_inputs(u, u->kind, e->signals));
            instances[filled++] = u->instance;
        }
        if (refused[k]) filled = before;
    }
    if (filled)
        ((steps_t)first->steps)(instances, filled, (double)(tick - first->lag) * m->engines[0]->h,
                                first->h, status);
    filled = 0;
    for (int64_t k = 0; k < n; k++) {
        engine_t *const e = m->engines[numbers[k]];
        const operation_t *op = e->operations + place;
        failure_t failure = {-1, 0, 0, 0, 0, 0};
        int result = RUN_OK;
        if (refused[k])
            result = step_units(e, tick, op, &failure); /* one by one */
        for (int64_t i = 0; i <= count && !refused[k] && result == RUN_OK; i++)
            result = take_outputs(e, op[i].index, status[filled + (size_t)i], &failure);
        if (!refused[k]) filled += (size_t)count + 1;
        if (result != RUN_OK) take_note(m, numbers[k], tick, &failure, result);
    }
}

/* One operation in all executions. The last ones come first: what leaves is behind those to come. */
INLINE void run_all(many_t *m, int64_t tick, int64_t place)
{
    for (int64_t k = m->n - 1; k >= 0; k--) {
        const int32_t number = m->running[k];
        engine_t *const e = m->engines[number];
        failure_t failure = {-1, 0, 0, 0, 0, 0};
        const int result = run_operation(e, tick, e->signals, e->operations + place, &failure);
        if (result != RUN_OK) take_note(m, number, tick, &failure, result);
    }
}

/* A copy in all executions, which have it from and to the same places. */
INLINE void copy_all(const many_t *m, const operation_t *op)
{
    for (int64_t k = 0; k < m->n; k++) {
        double *const s = m->engines[m->running[k]]->signals;
        copy(s + op->target, s + op->source, op->count);
    }
}

/* All executions have done a tick. */
INLINE void next_tick(many_t *m, int64_t tick)
{
    for (int64_t k = m->n - 1; k >= 0; k--) {
        const int32_t number = m->running[k];
        engine_t *const e = m->engines[number];
        e->tick = tick + 1;
        if (m->ended[number].operation >= 0)
            leave(m, number, tick + 1, &m->ended[number], RUN_TERMINATED);
        else if (*(volatile int32_t *)&e->stop)
            leave(m, number, tick + 1, NULL, RUN_STOPPED);
    }
}

/* Runs `ticks` ticks of up to MANY engines without teams, which are at the same tick, have the same
 * operations but for gains and offsets, and the same `every`; results[k] is what engine_run returns for
 * engine k. Rows are those of ticks k with k mod every = 0, and no others. */
API void engine_run_many(engine_t *const *engines, int64_t n, int64_t ticks, int32_t *results)
{
    many_t m = {engines, results, n, {0}, {{0}}};
    engine_t *const first = engines[0];
    const int64_t start = first->tick;

    for (int32_t k = 0; k < n; k++) {
        m.running[k] = k;
        m.ended[k].operation = -1;
        results[k] = RUN_OK;
    }
    catch_up(first->segments, first->n_segments, start);
    for (int64_t tick = start; tick < start + ticks && m.n > 0; tick++) {
        for (segment_t *x = first->segments; x < first->segments + first->n_segments; x++) {
            if (x->next != tick) continue;
            x->next = tick + x->period;
            for (int64_t i = x->first; i < x->last && m.n > 0; i++) {
                const operation_t *op = first->operations + i;
                if (op->code == OP_STEP && first->units[op->index].steps) {
                    step_all(&m, tick, i, op->count);
                    i += op->count;
                } else if (op->code == OP_COPY) {
                    copy_all(&m, op);
                } else if (op->code != OP_RECORD || tick % first->every == 0) {
                    run_all(&m, tick, i);
                }
            }
        }
        next_tick(&m, tick);
    }
}
