/* engine.c: executes a plan.
 *
 * A plan is a flat array of operations over one contiguous vector of doubles (the signals), in
 * segments that are due every `period` ticks; time is (tick * h), never a sum. The loop handles FMI
 * function pointers, ticks and signals only. It contains no code for Python, robots or networks,
 * and neither allocates nor prints. It is called with the GIL released, in chunks of ticks.
 */
#include "engine.h"
#include "team.h"

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

INLINE int step_unit(engine_t *e, int32_t index, failure_t *failure)
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
        result = step_typed(u, s, t, (e->tick - u->lag) / u->period, &status, &failure->signal);
    } else if (u->kind == UNIT_EXCHANGE) {
        result = step_exchange(u, s, t, &status, &failure->signal);
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

INLINE void push(link_t *l, const operation_t *op, const double *value)
{
    double *sample = l->history + (l->sent % l->capacity) * l->width;
    if (op->gain == 1.0 && op->offset == 0.0)
        memcpy(sample, value, (size_t)l->width * sizeof *value);
    else
        for (int64_t i = 0; i < l->width; i++) sample[i] = op->gain * value[i] + op->offset;
    l->sent++;
}

/* The receiver keeps its sample; a value is copied only if the row changes. */
INLINE int pull(link_t *l, double *target)
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

/* Executes one operation; returns RUN_OK or why not, and then which unit, link or gate in *failure. */
INLINE int run_operation(engine_t *e, double *s, const operation_t *op, failure_t *failure)
{
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
    case OP_PULL: {
        const int result = pull(e->links + op->index, s + op->target);
        if (result != RUN_OK) failure->index = op->index;
        return result;
    }
    case OP_AGE: s[op->target] = age(e, op); break;
    case OP_PLAY: return play(e->players + op->index, s + op->target);
    case OP_STEP: return step_unit(e, op->index, failure);
    case OP_GATE:
        if (e->gates[op->index].passing(e->gates[op->index].context, e->tick, s)) {
            failure->index = op->index;
            return RUN_GATE;
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
    return RUN_OK;
}

/* Executes operations from `first` to before `last`. An FMU that ends the simulation is kept in
 * *ended, and the others go on; anything else that goes wrong ends it, and is in *failure. */
INLINE int run_operations(engine_t *e, int64_t first, int64_t last, failure_t *failure,
                          failure_t *ended)
{
    double *const s = e->signals;
    const operation_t *const end = e->operations + last;

    for (const operation_t *op = e->operations + first; op < end; op++) {
        const int result = run_operation(e, s, op, failure);
        if (result == RUN_OK) continue;
        failure->result = result;
        failure->operation = op - e->operations;
        if (result != RUN_TERMINATED) return result;
        *ended = *failure;
        failure->operation = -1;
    }
    return RUN_OK;
}

/* The part of `count` things that is number `part` of `parts`: where it begins. */
static int64_t begin_of(int64_t count, uint64_t part, uint64_t parts)
{
    return (int64_t)((uint64_t)count * part / parts);
}

/* A chunk of the blocks of member `owner`, executed by another or itself: `mine`. */
NOINLINE void run_chunk(engine_t *e, const segment_t *segment, int32_t owner, uint64_t chunk,
                      uint64_t chunks, member_t *mine)
{
    const uint64_t parts = (uint64_t)e->team->threads;
    const int64_t begin = begin_of(segment->n_blocks, (uint64_t)owner, parts);
    const int64_t size = begin_of(segment->n_blocks, (uint64_t)owner + 1, parts) - begin;
    const int64_t first = segment->blocks[begin + begin_of(size, chunk, chunks)];
    const int64_t last = segment->blocks[begin + begin_of(size, chunk + 1, chunks)];
    failure_t now = {-1, 0, 0, 0, 0}, over = {-1, 0, 0, 0, 0};

    run_operations(e, first, last, &now, &over);
    if (over.operation > mine->ended.operation) mine->ended = over;
    if (now.operation >= 0 &&
        (mine->failed.operation < 0 || now.operation < mine->failed.operation))
        mine->failed = now;
}

/* Takes chunks of a member until it has no more. */
static void take_chunks(engine_t *e, int32_t owner, member_t *mine)
{
    team_t *team = e->team;
    uint64_t *place = &team->members[owner].ticket;

    for (;;) {
        uint64_t ticket = LOAD(place), chunks = chunks_of(ticket);
        if (next_of(ticket) >= chunks) return;
        ticket = ADD(place, 1);
        chunks = chunks_of(ticket);
        if (next_of(ticket) >= chunks) return;
        run_chunk(e, team->segment, owner, next_of(ticket), chunks, mine);
        ADD(&team->finished, 1);
    }
}

/* Its own chunks first, then those of the others. */
static void take_all_chunks(engine_t *e, int32_t thread)
{
    team_t *team = e->team;

    for (int32_t i = 0; i < team->threads; i++)
        take_chunks(e, (thread + i) % team->threads, team->members + thread);
}

/* A segment by all threads; the result is that of its first operation that failed. */
NOINLINE int run_shared(engine_t *e, const segment_t *segment, failure_t *failure, failure_t *ended)
{
    team_t *team = e->team;
    const uint64_t generation = LOAD(&team->members[0].ticket) >> 2 * CHUNK_BITS;
    uint64_t chunks = (uint64_t)(segment->n_blocks / team->threads / LEAST_BLOCKS);
    int spins = 0;

    chunks = chunks < 1 ? 1 : chunks > CHUNKS_A_THREAD ? CHUNKS_A_THREAD : chunks;
    team->segment = segment;
    STORE(&team->finished, 0);
    for (int32_t i = 0; i < team->threads; i++)
        STORE(&team->members[i].ticket, ticket_of(generation + 1, chunks));
    take_all_chunks(e, 0);
    while (LOAD(&team->finished) < chunks * (uint64_t)team->threads) wait_a_moment(&spins);
    for (int32_t i = 0; i < team->threads; i++) {
        member_t *m = team->members + i;
        if (m->ended.operation > ended->operation) *ended = m->ended;
        if (m->failed.operation >= 0 &&
            (failure->operation < 0 || m->failed.operation < failure->operation))
            *failure = m->failed;
        m->ended.operation = -1;
    }
    return failure->operation < 0 ? RUN_OK : failure->result;
}

/* What a further thread does while engine_run runs: `thread` is its number, from 1. It returns when
 * `quit` is set. */
API int32_t engine_work(engine_t *e, int32_t thread)
{
    team_t *team = e->team;
    int spins = 0;

    while (!LOAD(&team->quit)) {
        int32_t i = 0;
        while (i < team->threads) {
            const uint64_t ticket = LOAD(&team->members[i].ticket);
            if (next_of(ticket) < chunks_of(ticket)) break;
            i++;
        }
        if (i < team->threads) {
            take_all_chunks(e, thread);
            spins = 0;
        } else {
            wait_a_moment(&spins);
        }
    }
    return RUN_OK;
}

NOINLINE int32_t failed(engine_t *e, const failure_t *f, int32_t result)
{
    e->failed_index = f->index;
    e->failed_status = f->status;
    e->failed_signal = f->signal;
    return result;
}

/* Runs `ticks` ticks; returns RUN_OK or why it stopped. e->tick is then the tick that failed. A tick in
 * which an FMU ends the simulation after its step (RUN_TERMINATED) is done to its end and counted. */
API int32_t engine_run(engine_t *e, int64_t ticks)
{
    segment_t *const segments = e->segments;
    segment_t *const behind = segments + e->n_segments;
    const int64_t end = e->tick + ticks;
    const int threads = HAS_THREADS && e->team && e->team->threads > 1;
    failure_t failure = {-1, 0, 0, 0, 0}, ended = {-1, 0, 0, 0, 0};

    for (; e->tick < end; e->tick++) {
        const int64_t tick = e->tick;
        if (*(volatile int32_t *)&e->stop) return RUN_STOPPED;
        for (segment_t *segment = segments; segment < behind; segment++) {
            int result;
            if (segment->next != tick) continue;
            segment->next = tick + segment->period;
            result = threads && segment->shared
                         ? run_shared(e, segment, &failure, &ended)
                         : run_operations(e, segment->first, segment->last, &failure, &ended);
            if (result != RUN_OK) return failed(e, &failure, result);
        }
        if (ended.operation < 0) continue;
        e->tick++;
        return failed(e, &ended, RUN_TERMINATED);
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
                                   sizeof(exchange_t), sizeof(segment_t), sizeof(failure_t),
                                   sizeof(team_t), sizeof(member_t)};
    return which >= 0 && which < 17 ? sizes[which] : 0;
}
