/* batch.c: executions of plans that differ in numbers only, an operation of all of them at a time.
 *
 * Each execution has an engine of its own, with its own signals, tables and records; none
 * sees another one. What they have in common is which operation is due when, so that the steps of instances
 * of one FMU, which belong to different executions, can be done at once. An execution that fails or ends is
 * left out from then on, as it stands; the others go on.
 */
#include "engine_internal.h"

enum { MANY = 16 }; /* executions, at most */

/* Executions that still run, by their number, and what became of each. */
typedef struct {
    engine_t *const *engines;
    int32_t *results;
    int64_t n;
    int64_t ticks; /* that are run as one now, see engine_run_many */
    int64_t apart; /* numbers from one column of a record to the next */
    int32_t running[MANY];
    failure_t ended[MANY]; /* why it leaves when these are done; `operation` -1: it does not */
} many_t;

static NOINLINE void leave(many_t *m, int32_t number, int64_t tick, const failure_t *f, int result)
{
    engine_t *const e = m->engines[number];
    int64_t kept = 0;

    e->tick = tick;
    m->results[number] = result == RUN_STOPPED ? result : keep_failure(e, f, result);
    for (int64_t k = 0; k < m->n; k++)
        if (m->running[k] != number) m->running[kept++] = m->running[k];
    m->n = kept;
}

/* What an operation came to in one execution, if not RUN_OK. */
static NOINLINE void take_note(many_t *m, int32_t number, int64_t tick, failure_t *f, int result)
{
    f->result = result;
    f->tick = tick;
    f->operation = 0;
    if (result == RUN_TERMINATED) m->ended[number] = *f; /* the others of its tick are done */
    else leave(m, number, tick, f, result);
}

/* A step that failed in one execution. Of ticks that are run as one, the first that fails counts, and units
 * behind this one may fail sooner. */
static NOINLINE void take_note_of_step(many_t *m, int32_t number, int64_t tick, failure_t *f, int result)
{
    failure_t *const ended = m->ended + number;

    if (m->ticks == 1 || result == RUN_TERMINATED) {
        take_note(m, number, tick, f, result);
    } else if (ended->operation < 0 || tick < ended->tick) {
        f->result = result;
        f->tick = tick;
        f->operation = 0;
        *ended = *f;
    }
}

/* Units of executions that are stepped at once: `each` of every execution in `numbers`. */
typedef struct {
    void *instances[MANY * AT_ONCE];
    int status[MANY * AT_ONCE];
    size_t made[MANY * AT_ONCE];
    int32_t numbers[MANY];
    int64_t n, each;
} stepped_t;

/* After steps from `tick` on: executions with one that failed are left out; the first one counts. */
static NOINLINE void drop_failed(many_t *m, stepped_t *s, int64_t tick, int64_t place)
{
    int64_t kept = 0;

    for (int64_t k = 0; k < s->n; k++) {
        const engine_t *e = m->engines[s->numbers[k]];
        const int *status = s->status + k * s->each;
        const size_t *made = s->made + k * s->each;
        int64_t first = s->each;
        for (int64_t i = s->each - 1; i >= 0; i--)
            if (failed_call(status[i]) && (first == s->each || made[i] <= made[first])) first = i;
        if (first < s->each) {
            failure_t failure = {-1, 0, 0, e->operations[place + first].index, status[first], 0};
            take_note_of_step(m, s->numbers[k], tick + (int64_t)made[first], &failure, RUN_STEP);
            continue;
        }
        s->numbers[kept] = s->numbers[k];
        memmove(s->instances + kept * s->each, s->instances + k * s->each,
                (size_t)s->each * sizeof *s->instances);
        kept++;
    }
    s->n = kept;
}

/* The inputs of the units of operation `place` and of those behind it in all executions; no FMU refuses them,
 * as the values of all are open. */
INLINE void enter_all(const many_t *m, stepped_t *s, int64_t place)
{
    for (s->n = 0; s->n < m->n; s->n++) {
        const int32_t number = s->numbers[s->n] = m->running[s->n];
        const engine_t *e = m->engines[number];
        for (int64_t i = 0; i < s->each; i++) {
            const unit_t *u = e->units + e->operations[place + i].index;
            s->instances[s->n * s->each + i] = u->instance;
            set_inputs(u, u->kind, 0, e->signals);
        }
    }
}

/* The step of operation `place` and of the `count` behind it in all executions, at once. */
static NOINLINE void step_all(many_t *m, int64_t tick, int64_t place, int64_t count)
{
    const engine_t *first = m->engines[m->running[0]];
    const unit_t *u = first->units + first->operations[place].index;
    const int64_t last = tick + (u->period == 1 ? m->ticks : 1) - 1;
    stepped_t s;

    s.each = count + 1;
    enter_all(m, &s, place);
    for (int64_t now = tick; now <= last && s.n > 0;) {
        double times[STEPS_AT_ONCE];
        size_t ticks = 0;
        int any = 0;
        for (; now + (int64_t)ticks <= last && ticks < STEPS_AT_ONCE; ticks++)
            times[ticks] = time_of(first, now + (int64_t)ticks - u->lag);
        ((steps_t)u->steps)(s.instances, (size_t)(s.n * s.each), times, ticks, u->h, s.status, s.made);
        for (int64_t k = 0; k < s.n * s.each; k++) any |= failed_call(s.status[k]);
        if (any) drop_failed(m, &s, now, place);
        now += (int64_t)ticks;
    }
    for (int64_t k = 0; k < s.n; k++) {
        engine_t *const e = m->engines[s.numbers[k]];
        for (int64_t i = 0; i < s.each; i++) take_outputs(e, e->operations[place + i].index, 0, NULL);
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

/* What is recorded of a tick, in all executions: the entries of a row are in different columns. */
INLINE void record_all(const many_t *m, const operation_t *op)
{
    for (int64_t k = 0; k < m->n; k++) {
        engine_t *const e = m->engines[m->running[k]];
        const columns_t *columns = e->columns + op->index;
        double *const row = e->record + e->row++;
        for (int64_t i = 0; i < columns->n_stretches; i++) {
            const stretch_t *x = columns->stretches + i;
            for (int64_t j = 0; j < x->count; j++) row[(x->place + j) * m->apart] = e->signals[x->source + j];
        }
    }
}

/* All executions have done these ticks. */
INLINE void next_ticks(many_t *m, int64_t tick)
{
    for (int64_t k = m->n - 1; k >= 0; k--) {
        const int32_t number = m->running[k];
        const failure_t *ended = m->ended + number;
        engine_t *const e = m->engines[number];
        e->tick = tick + m->ticks;
        if (ended->operation >= 0)
            leave(m, number, ended->tick + (ended->result == RUN_TERMINATED), ended, ended->result);
        else if (*(volatile int32_t *)&e->stop) leave(m, number, e->tick, NULL, RUN_STOPPED);
    }
}

/* Runs `ticks` ticks of up to MANY engines without teams, of FMUs with open values, which are at the same tick, have the same
 * operations but for gains and offsets, and the same `every`; results[k] is what engine_run returns for
 * engine k. Rows are those of ticks k with k mod every = 0, and no others; their entries are `apart` numbers
 * apart, one row behind the other.
 *
 * Ticks from one multiple of `stride` to the next are run as one, in which units with a period of a tick are stepped
 * so often, and everything else is done once. `stride` divides `every` and all periods but 1; within it, no
 * input of these units changes, and nothing reads their outputs. */
API void engine_run_many(engine_t *const *engines, int64_t n, int64_t ticks, int64_t stride, int64_t apart,
                         int32_t *results)
{
    many_t m = {engines, results, n, 1, apart, {0}, {{0}}};
    engine_t *const first = engines[0];
    const int64_t start = first->tick, end = start + ticks;

    for (int32_t k = 0; k < n; k++) {
        m.running[k] = k;
        m.ended[k].operation = -1;
        results[k] = RUN_OK;
    }
    catch_up(first->segments, first->n_segments, start);
    for (int64_t tick = start; tick < end && m.n > 0; tick += m.ticks) {
        m.ticks = stride - tick % stride;
        if (m.ticks > end - tick) m.ticks = end - tick;
        for (segment_t *x = first->segments; x < first->segments + first->n_segments; x++) {
            if (x->next != tick) continue;
            x->next = tick + (x->period == 1 ? m.ticks : x->period);
            for (int64_t i = x->first; i < x->last && m.n > 0; i++) {
                const operation_t *op = first->operations + i;
                if (op->code == OP_STEP && first->units[op->index].steps) {
                    step_all(&m, tick, i, op->count);
                    i += op->count;
                } else if (op->code == OP_COPY) {
                    copy_all(&m, op);
                } else if (op->code != OP_RECORD) {
                    run_all(&m, tick, i);
                } else if (tick % first->every == 0) {
                    record_all(&m, op);
                }
            }
        }
        next_ticks(&m, tick);
    }
}
