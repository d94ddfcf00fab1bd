/* partitions.c: parts of a plan that run apart, for as many ticks as a value needs from one to another.
 *
 * The parts of a plan are connected by links only. Where the least delay of all these
 * links is n ticks, a part needs nothing of the others that is newer than n ticks: each can run n ticks
 * on its own, whoever runs it and in whatever order. That is a window. What a part needs stays in the
 * cache of the processor for its length, and threads meet once a window. Where wires connect parts, a
 * window is one tick, in two stages: all take their inputs before any computes its new outputs.
 *
 * Each thread has a share of the parts, the same in every window; who is done takes chunks of the others.
 * The chunks of a share are handed out by one atomic number, the ticket: generation, number of chunks,
 * next chunk. A thread that comes late finds fewer chunks, and no thread waits for one that has none. The
 * caller starts the threads: each calls engine_work while engine_run runs.
 */
#include "engine_internal.h"

#if defined(_WIN32)
#define WIN32_LEAN_AND_MEAN /* nothing of sockets, whose names are common words */
#include <windows.h>
#define YIELD() SwitchToThread()
#else
#include <sched.h>
#define YIELD() sched_yield()
#endif

#if defined(__GNUC__)
#define LOAD(place) __atomic_load_n(place, __ATOMIC_ACQUIRE)
#define STORE(place, value) __atomic_store_n(place, value, __ATOMIC_RELEASE)
#define ADD(place, value) __atomic_fetch_add(place, value, __ATOMIC_ACQ_REL)
/* With the assembler's nothing, since gcc leaves out calls of functions that only prefetch. */
#define PREFETCH(place)            \
    (__extension__({               \
        __builtin_prefetch(place); \
        __asm__ volatile("");      \
    }))
#define SWAP(place, old, value) \
    __atomic_compare_exchange_n(place, old, value, 0, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE)
#else /* a compiler whose atomic operations are not known here: one thread */
#define LOAD(place) (*(place))
#define STORE(place, value) (*(place) = (value))
#define ADD(place, value) ((*(place) += (value)) - (value))
#define SWAP(place, old, value) (*(place) = (value), 1)
#define PREFETCH(place) (void)(place)
#endif

enum { LINE = 64 }; /* bytes of a line of the cache */
enum { CHUNK_BITS = 20, CHUNKS_A_THREAD = 16, SPINS = 2000, FATAL = 4 };

static inline uint64_t ticket_of(uint64_t generation, uint64_t chunks)
{
    return generation << 2 * CHUNK_BITS | chunks << CHUNK_BITS;
}

static inline uint64_t next_of(uint64_t ticket) { return ticket & ((1u << CHUNK_BITS) - 1); }

static inline uint64_t chunks_of(uint64_t ticket) { return ticket >> CHUNK_BITS & ((1u << CHUNK_BITS) - 1); }

/* A moment of waiting: first on this processor, then others may have it. */
static inline void wait_a_moment(int *spins)
{
    if (++*spins < SPINS) {
#if defined(__x86_64__) || defined(__i386__)
        __builtin_ia32_pause();
#endif
        return;
    }
    YIELD();
}

/* No part goes further than `limit`. */
static void lower(int64_t *place, int64_t limit)
{
    int64_t old = LOAD(place);
    while (old > limit && !SWAP(place, &old, limit));
}

/* Whether a comes before b, by tick and place in it. */
static int precedes(const failure_t *a, const failure_t *b)
{
    return b->operation < 0 || a->tick < b->tick || (a->tick == b->tick && a->operation < b->operation);
}

/* Of what ended the simulation, the first tick counts, and the last one in it. */
static int supersedes(const failure_t *a, const failure_t *b)
{
    return b->operation < 0 || a->tick < b->tick || (a->tick == b->tick && a->operation > b->operation);
}

/* The part of `count` things that is number `part` of `parts`: where it begins. */
static int64_t begin_of(int64_t count, uint64_t part, uint64_t parts)
{
    return (int64_t)((uint64_t)count * part / parts);
}

/* Parts that run later in this window, or NULL, and the ticks in which what they need is brought into the
 * cache, a little in each: first what a part uses in every tick, then the rows of its links up to the end of
 * the window, then the samples that these hold. */
typedef struct {
    const part_t *spans, *rows, *samples;
    uint64_t ticks;
} ahead_t;

static void fetch_spans(const span_t *x, const span_t *end)
{
    for (; x < end; x++)
        for (int64_t i = 0; i < x->size; i += LINE) PREFETCH(x->first + i);
}

/* The last row of a link's table that is read in this window, or one before its first. */
static int64_t last_row(const engine_t *e, received_t x)
{
    const link_t *l = e->links + x.link;
    const int64_t row = l->row + (LOAD(&e->team->limit) - e->tick - 1) / x.period;
    return row < l->rows ? row : l->rows - 1;
}

static void fetch_rows(const engine_t *e, const received_t *x, const received_t *end)
{
    for (; x < end; x++) {
        const link_t *l = e->links + x->link;
        const int64_t last = last_row(e, *x);
        for (int64_t row = l->row; row <= last; row += LINE / (int64_t)sizeof *l->table)
            PREFETCH(l->table + row);
        if (last > l->row) PREFETCH(l->table + last);
    }
}

static void fetch_samples(const engine_t *e, const received_t *x, const received_t *end)
{
    for (; x < end; x++) {
        const link_t *l = e->links + x->link;
        const sender_t *from = l->sender;
        const int64_t last = last_row(e, *x);
        const char *before = NULL;
        for (int64_t row = l->row; row <= last; row++) {
            const int64_t held = l->table[row] - l->before;
            const char *sample = (const char *)(from->history + (held & (from->capacity - 1)) * from->width);
            if (held < 0 || (before && sample >= before && sample < before + LINE)) continue;
            PREFETCH(sample);
            before = sample;
        }
    }
}

/* What is fetched in the ticks of the window from number `k` to before `end`. */
static void fetch_ahead(const engine_t *e, const ahead_t *a, uint64_t k, uint64_t end)
{
    const uint64_t n = a->ticks;

    if (a->spans)
        fetch_spans(a->spans->spans + begin_of(a->spans->n_spans, k, n),
                    a->spans->spans + begin_of(a->spans->n_spans, end, n));
    if (a->rows)
        fetch_rows(e, a->rows->links + begin_of(a->rows->n_links, k, n),
                   a->rows->links + begin_of(a->rows->n_links, end, n));
    if (a->samples)
        fetch_samples(e, a->samples->links + begin_of(a->samples->n_links, k, n),
                      a->samples->links + begin_of(a->samples->n_links, end, n));
}

/* How many ticks from `tick` on are run as one, of those before `limit`. */
static int64_t ticks_as_one(const team_t *team, int64_t tick, int64_t limit)
{
    const int64_t stride = team->stride > 1 ? team->stride : 1;
    int64_t ticks = stride - tick % stride;

    if (ticks > STEPS_AT_ONCE) ticks = STEPS_AT_ONCE;
    return ticks < limit - tick ? ticks : limit - tick;
}

/* A part up to the end of the window, or to the tick after which another one has failed. */
static NOINLINE void run_part(engine_t *e, part_t *part, const ahead_t *ahead, member_t *mine)
{
    team_t *team = e->team;
    failure_t failure = {-1, 0, 0, 0, 0, 0}, ended = {-1, 0, 0, 0, 0, 0};
    segment_t *const segments = part->segments + (team->stage ? part->n_first : 0);
    const int64_t n = team->stage || !team->staged ? part->n_segments : part->n_first;
    const int64_t n_segments = n - (segments - part->segments);
    int64_t tick = e->tick;
    int result = RUN_OK;

    catch_up(segments, n_segments, tick);
    for (int64_t limit; tick < (limit = LOAD(&team->limit)) && ended.operation < 0;) {
        const int64_t ticks = ticks_as_one(team, tick, limit), number = tick - e->tick;
        fetch_ahead(e, ahead, (uint64_t)number, (uint64_t)(number + ticks));
        result = run_tick(e, tick, ticks, segments, n_segments, &failure, &ended);
        tick = result == RUN_OK ? tick + ticks : failure.tick;
        if (result != RUN_OK) break;
    }
    part->tick = tick;
    if (result != RUN_OK) {
        lower(&team->limit, failure.status == FATAL ? e->tick : tick + 1);
        failure.operation = team->places[failure.operation - team->n_plan];
        if (precedes(&failure, &mine->failed)) mine->failed = failure;
    } else if (ended.operation >= 0) {
        lower(&team->limit, tick);
        ended.operation = team->places[ended.operation - team->n_plan];
        if (supersedes(&ended, &mine->ended)) mine->ended = ended;
    }
}

/* A chunk of the share of thread `owner`. */
static void run_chunk(engine_t *e, int32_t owner, uint64_t chunk, uint64_t chunks, member_t *mine)
{
    team_t *team = e->team;
    const int64_t n = team->n_parts - team->first;
    const int64_t begin = begin_of(n, (uint64_t)owner, (uint64_t)team->threads);
    const int64_t size = begin_of(n, (uint64_t)owner + 1, (uint64_t)team->threads) - begin;
    part_t *parts = team->parts + team->first + begin;
    const int64_t end = begin_of(size, chunk + 1, chunks);
    const uint64_t ticks = (uint64_t)(LOAD(&team->limit) - e->tick);

    for (int64_t i = begin_of(size, chunk, chunks); i < end; i++) {
        const int64_t left = size - i - 1;
        const ahead_t ahead = {left > 2 ? parts + i + 3 : NULL, left > 1 ? parts + i + 2 : NULL,
                               left > 0 ? parts + i + 1 : NULL, ticks};
        run_part(e, parts + i, &ahead, mine);
    }
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
        run_chunk(e, owner, next_of(ticket), chunks, mine);
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

/* All parts up to the tick `limit`, or one stage of a tick, and what went wrong first. */
static void run_stage(engine_t *e, int64_t limit, failure_t *failure, failure_t *ended)
{
    team_t *team = e->team;
    const uint64_t generation = LOAD(&team->members[0].ticket) >> 2 * CHUNK_BITS;
    const uint64_t chunks = CHUNKS_A_THREAD;
    const ahead_t none = {NULL, NULL, NULL, 1};
    int spins = 0;

    team->limit = limit;
    for (int32_t i = 0; i < team->first; i++) run_part(e, team->parts + i, &none, team->members);
    STORE(&team->finished, 0);
    for (int32_t i = 0; i < team->threads; i++)
        STORE(&team->members[i].ticket, ticket_of(generation + 1, chunks));
    take_all_chunks(e, 0);
    while (LOAD(&team->finished) < chunks * (uint64_t)team->threads) wait_a_moment(&spins);
    for (int32_t i = 0; i < team->threads; i++) {
        const member_t *m = team->members + i;
        if (m->failed.operation >= 0 && precedes(&m->failed, failure)) *failure = m->failed;
        if (m->ended.operation >= 0 && supersedes(&m->ended, ended)) *ended = m->ended;
    }
}

static void run_window(engine_t *e, int64_t limit, failure_t *failure, failure_t *ended)
{
    team_t *team = e->team;

    run_stage(e, team->staged ? e->tick + 1 : limit, failure, ended);
    if (!team->staged || failure->operation >= 0) return;
    team->stage = 1;
    run_stage(e, e->tick + 1, failure, ended);
    team->stage = 0;
}

/* Parts that are beyond `tick` go back to it, as far as signals are recorded in every tick: to what they were
 * when the row of `tick` was, or `done`, at the end of that tick. */
static void go_back(engine_t *e, int64_t tick, int done)
{
    const team_t *team = e->team;

    for (int64_t k = 0; k < team->n_parts && e->record && e->every <= 1; k++) {
        const columns_t *columns = e->columns + 1 + k;
        if (team->parts[k].tick <= tick + done) continue;
        for (int64_t i = 0; i < columns->n_stretches; i++) {
            const stretch_t *x = columns->stretches + i;
            const int64_t row = e->row + tick - e->tick + (done && x->late);
            memcpy(e->signals + x->source, e->record + row * e->width + x->place,
                   (size_t)x->count * sizeof *e->signals);
        }
    }
}

/* Rows up to `tick` are complete: it is the next one, or the one that failed. */
static void arrive(engine_t *e, int64_t tick, int rows)
{
    if (e->record) {
        e->row += tick - e->tick + rows;
        if (e->recorded) publish(e->recorded, e->row);
    }
    e->tick = tick;
}

/* A window did not end well: e->tick is then as if all had been run tick by tick. After a fatal status
 * no more is called, so that it may be an earlier tick. */
static int stop_early(engine_t *e, const failure_t *failure, const failure_t *ended)
{
    const team_t *team = e->team;
    int64_t tick = failure->tick;

    if (failure->operation < 0 ||
        (ended->operation >= 0 && ended->tick < failure->tick && failure->status != FATAL)) {
        go_back(e, ended->tick, 1);
        arrive(e, ended->tick + 1, 0);
        return keep_failure(e, ended, RUN_TERMINATED);
    }
    for (int64_t k = 0; k < team->n_parts; k++)
        if (team->parts[k].tick < tick) tick = team->parts[k].tick;
    go_back(e, tick, 0);
    arrive(e, tick, tick == failure->tick && failure->operation > team->record);
    return keep_failure(e, failure, failure->result);
}

SHARED int32_t run_windows(engine_t *e, int64_t end)
{
    failure_t failure = {-1, 0, 0, 0, 0, 0}, ended = {-1, 0, 0, 0, 0, 0};

    while (e->tick < end) {
        int64_t limit = e->tick + (e->team->staged ? 1 : e->team->longest);
        if (limit > end) limit = end;
        if (*(volatile int32_t *)&e->stop) return RUN_STOPPED;
        run_window(e, limit, &failure, &ended);
        if (failure.operation >= 0 || ended.operation >= 0) return stop_early(e, &failure, &ended);
        arrive(e, limit, 0);
    }
    return RUN_OK;
}
