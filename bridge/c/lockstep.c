/* lockstep.c: see lockstep.h */
#include "lockstep.h"

#include <errno.h>

#include "dispatch.h"
#include "mail.h"
#include "slot.h"

enum { LOOK_NS = 30000, SLEEP_NS = 1000000, FLUSH_NS = 1000000 };
/* The samples for which a node waits: of the next slot; of the end of the run; sent before until_ns. */
enum { OF_SLOT, OF_END, OF_UNTIL };

/* Samples sent before a time, or at it. */
static int64_t sent_by(const stream_t *s, int64_t time_ns, int32_t at_it)
{
    const int64_t x = time_ns - s->offset_ns;
    if (x < 0 || (x == 0 && !at_it)) return 0;
    const int64_t n = at_it ? x / s->period_ns + 1 : (x + s->period_ns - 1) / s->period_ns;
    return n < s->capacity ? n : s->capacity;
}

API int64_t lockstep_sent(const stream_t *s, int64_t deadline_ns)
{
    return sent_by(s, deadline_ns, s->before);
}

API int64_t lockstep_needed(const stream_t *s, int64_t deadline_ns)
{
    return s->lead_ns ? sent_by(s, deadline_ns - s->lead_ns, 1) : lockstep_sent(s, deadline_ns);
}

API int64_t lockstep_sent_before(const stream_t *s, int64_t time_ns) { return sent_by(s, time_ns, 0); }

static int32_t has_command(const node_t *n, int32_t command)
{
    return commands_have(__atomic_load_n(&n->told, __ATOMIC_ACQUIRE), command);
}

static int32_t ended(const node_t *n)
{
    return *(const volatile int32_t *)&n->quit || has_command(n, COMMAND_STOP);
}

/* The counter of Profile 4, which every sample has. */
static int64_t counter(const frame_t *frame) { return frame->data[2] << 8 | frame->data[3]; }

/* Into its stream; nonzero: samples are missing before it. */
static int32_t store_sample(lockstep_t *l, const frame_t *frame, int32_t bus)
{
    for (int32_t i = 0; i < l->n_streams; i++) {
        stream_t *s = l->streams + i;
        if (s->bus != bus || !message_is(s->message, frame)) continue;
        if (s->received >= s->capacity) return 0;
        if (counter(frame) != (s->received & 0xFFFF)) {
            l->awaited = i;
            l->found = counter(frame);
            return LOCKSTEP_LOST;
        }
        s->frames[s->received++] = *frame;
        return 0;
    }
    return 0;
}

/* What has come: how many frames, or LOCKSTEP_LOST. */
static int32_t gather(lockstep_t *l)
{
    int32_t came = 0;
    frame_t frame;
    for (int32_t b = 0; b < l->node->n_buses; b++) {
        while (bus_receive(l->outside + b, &frame)) {
            if (node_is_estop(l->node, &frame)) l->node->quit = 1;
            const int32_t told = node_told_by(l->node, &frame);
            if (told == COMMAND_START || told == COMMAND_STOP) node_tell(l->node, told);
            if (store_sample(l, &frame, b)) return LOCKSTEP_LOST;
            came++;
        }
    }
    return came;
}

static int64_t deadline_of(const node_t *n) { return n->slot * n->h_ns + n->phase_ns; }

static int64_t last_deadline(const node_t *n) { return (n->slots - 1) * n->h_ns + n->phase_ns; }

/* What has been sent, to the threads of the buses. */
static void flush(lockstep_t *l)
{
    if (!l->unsent_ns) return;
    for (int32_t b = 0; b < l->node->n_buses; b++) bus_wake(l->outside + b);
    l->unsent_ns = 0;
}

/* Samples of a stream before the next slot of which the node hears in it, or at another point. */
static int64_t wanted(const lockstep_t *l, int32_t stream, int32_t of)
{
    const stream_t *s = l->streams + stream;
    if (of == OF_UNTIL) return lockstep_sent_before(s, l->until_ns);
    return of == OF_END ? lockstep_sent(s, last_deadline(l->node)) : lockstep_needed(s, deadline_of(l->node));
}

/* The first stream that the node waits for, -1: none. */
static int32_t awaited(const lockstep_t *l, int32_t of)
{
    for (int32_t i = 0; i < l->n_streams; i++)
        if (l->streams[i].received < wanted(l, i, of)) return i;
    return -1;
}

/* Until something may have come. The end of a run is looked for as often, too. */
static int64_t sleep_from(lockstep_t *l, int64_t now)
{
    flush(l);
    if (l->node->n_buses > 1 || l->outside->kind != BUS_RING)
        return pace_wait(now + LOOK_NS, 0, &l->node->quit);
    mail_wait(l->outside->rx, now + SLEEP_NS);
    return pace_now();
}

/* Until the samples are there: 0, or why not. */
static int32_t wait_for_samples(lockstep_t *l, int32_t of)
{
    int64_t now = pace_now(), last = now;
    for (;;) {
        const int32_t came = gather(l);
        if (came < 0) return came;
        if (ended(l->node)) return LIVE_STOPPED;
        if ((l->awaited = awaited(l, of)) < 0) break;
        if (came) last = now;
        if (now - last > l->patience_ns) return LOCKSTEP_STALLED;
        now = sleep_from(l, now);
    }
    return 0;
}

/* The next sample of a stream, to the node. */
static void give_sample(const lockstep_t *l, stream_t *s)
{
    frame_t frame = s->frames[s->given];
    frame.t_ns = s->given * s->period_ns + s->offset_ns;
    ring_put(l->node->buses[s->bus].rx, &frame);
    s->given++;
}

/* Give the node what it hears before its next slot. */
static void give(lockstep_t *l)
{
    for (int32_t i = 0; i < l->n_streams; i++) {
        stream_t *s = l->streams + i;
        while (s->given < wanted(l, i, OF_SLOT)) give_sample(l, s);
        if (s->lead_ns) s->reception->promised = lockstep_sent(s, deadline_of(l->node)) - 1;
    }
}

/* Whether the node has accepted the samples for which it did not wait. */
static int32_t check_promises(lockstep_t *l)
{
    for (int32_t i = 0; i < l->n_streams; i++) {
        const stream_t *s = l->streams + i;
        if (!s->lead_ns || s->reception->newest == s->given - 1) continue;
        l->awaited = i;
        return LOCKSTEP_REFUSED;
    }
    return 0;
}

/* What the slot has sent, to the others; waits while a queue is full. */
static int32_t send(lockstep_t *l)
{
    frame_t frame;
    for (int32_t b = 0; b < l->node->n_buses; b++) {
        while (ring_get(l->node->buses[b].tx, &frame)) {
            while (bus_queue(l->outside + b, &frame) == ENOBUFS) {
                bus_wake(l->outside + b);
                if (ended(l->node)) return LIVE_STOPPED;
                pace_wait(pace_now() + LOOK_NS, 0, &l->node->quit);
            }
            if (!l->unsent_ns) l->unsent_ns = pace_now();
        }
    }
    if (l->unsent_ns && pace_now() - l->unsent_ns > FLUSH_NS) flush(l);
    return 0;
}

/* One slot once its samples are there: 0, or why there is no other. */
static int32_t step(lockstep_t *l)
{
    node_t *n = l->node;
    const int32_t there = l->until_ns >= 0 && deadline_of(n) >= l->until_ns;
    int32_t result = wait_for_samples(l, there ? OF_UNTIL : OF_SLOT);
    if (result) return result;
    if (there) return LOCKSTEP_UNTIL;
    give(l);
    if ((result = node_slot(n, deadline_of(n), deadline_of(n), 0)) != 0) return result;
    if ((result = send(l)) != 0) return result;
    return check_promises(l);
}

/* After the last slot: the rest of what the twin hears. */
static int32_t hear_rest(lockstep_t *l)
{
    const int32_t result = wait_for_samples(l, OF_END);
    if (result) return result;
    for (int32_t i = 0; i < l->n_streams; i++) {
        while (l->streams[i].given < wanted(l, i, OF_END)) {
            give_sample(l, l->streams + i);
            node_hear(l->node, last_deadline(l->node));
        }
    }
    return check_promises(l);
}

/* Wait for START: 0, or why there is no slot. */
static int32_t begin(lockstep_t *l)
{
    node_t *n = l->node;
    while (!has_command(n, COMMAND_START)) {
        if (ended(n)) return LIVE_NEVER_STARTED;
        if (gather(l) < 0) return LOCKSTEP_LOST;
        pace_wait(pace_now() + 1000000, 0, &n->quit);
    }
    l->begun = 1;
    n->told = 0;
    if (l->resumed) return 0;
    n->start_ns = 0;
    n->life.state = LIFE_ACTIVE;
    n->life.armed = 1;
    node_enable(n, 0);
    return 0;
}

static int32_t run(lockstep_t *l)
{
    node_t *n = l->node;
    int32_t result = l->begun ? 0 : begin(l);
    while (!result && n->slot < n->slots) result = step(l);
    if (result || (result = hear_rest(l)) != 0) return result;
    n->life.state = LIFE_FINISHED;
    return LIVE_FINISHED;
}

API int32_t lockstep_run(lockstep_t *l)
{
    const int32_t result = run(l);
    flush(l);
    return result;
}
