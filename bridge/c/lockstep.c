/* lockstep.c: see lockstep.h */
#include "lockstep.h"

#include <errno.h>

#include "hear.h"
#include "mail.h"
#include "slot.h"

enum { LOOK_NS = 30000, SLEEP_NS = 1000000 };

API int64_t lockstep_needed(const stream_t *s, int64_t deadline_ns)
{
    const int64_t x = deadline_ns - s->offset_ns;
    int64_t n;
    if (x < 0 || (x == 0 && !s->before)) return 0;
    n = s->before ? x / s->period_ns + 1 : (x + s->period_ns - 1) / s->period_ns;
    return n < s->capacity ? n : s->capacity;
}

static int32_t has_command(const node_t *n, int32_t command)
{
    return commands_have(__atomic_load_n(&n->told, __ATOMIC_ACQUIRE), command);
}

static int32_t ended(const node_t *n)
{
    return *(const volatile int32_t *)&n->quit || has_command(n, COMMAND_STOP);
}

/* The counter of Profile 4, which every sample has. */
static int64_t counter(const frame_t *frame)
{
    return frame->data[2] << 8 | frame->data[3];
}

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
            if (store_sample(l, &frame, b)) return LOCKSTEP_LOST;
            came++;
        }
    }
    return came;
}

static int64_t deadline_of(const node_t *n)
{
    return n->slot * n->h_ns + n->phase_ns;
}

/* The first stream that the next slot waits for, -1: none. */
static int32_t awaited(const lockstep_t *l)
{
    for (int32_t i = 0; i < l->n_streams; i++)
        if (l->streams[i].received < lockstep_needed(l->streams + i, deadline_of(l->node))) return i;
    return -1;
}

/* Until something may have come. The end of a run is looked for as often, too. */
static int64_t sleep_from(const lockstep_t *l, int64_t now)
{
    if (l->node->n_buses > 1 || l->outside->kind != BUS_RING)
        return pace_wait(now + LOOK_NS, 0, &l->node->quit);
    mail_wait(l->outside->rx, now + SLEEP_NS);
    return pace_now();
}

/* Until the next slot is due: 0, or why not. */
static int32_t wait_for_samples(lockstep_t *l)
{
    int64_t now = pace_now(), last = now;
    for (;;) {
        const int32_t came = gather(l);
        if (came < 0) return came;
        if ((l->awaited = awaited(l)) < 0) break;
        if (ended(l->node)) return LIVE_STOPPED;
        if (came) last = now;
        if (now - last > l->patience_ns) return LOCKSTEP_STALLED;
        now = sleep_from(l, now);
    }
    return 0;
}

/* Give the node what the twin would have given it by now. */
static void give(lockstep_t *l)
{
    for (int32_t i = 0; i < l->n_streams; i++) {
        stream_t *s = l->streams + i;
        const int64_t n = lockstep_needed(s, deadline_of(l->node));
        for (; s->given < n; s->given++) {
            frame_t frame = s->frames[s->given];
            frame.t_ns = s->given * s->period_ns + s->offset_ns;
            ring_put(l->node->buses[s->bus].rx, &frame);
        }
    }
}

/* What the slot has sent, to the others; waits while a queue is full. */
static int32_t send(lockstep_t *l)
{
    frame_t frame;
    for (int32_t b = 0; b < l->node->n_buses; b++) {
        while (ring_get(l->node->buses[b].tx, &frame)) {
            while (bus_send(l->outside + b, &frame) == ENOBUFS) {
                if (ended(l->node)) return LIVE_STOPPED;
                pace_wait(pace_now() + LOOK_NS, 0, &l->node->quit);
            }
        }
    }
    return 0;
}

API int32_t lockstep_run(lockstep_t *l)
{
    node_t *n = l->node;
    while (!has_command(n, COMMAND_START)) {
        if (ended(n)) return LIVE_NEVER_STARTED;
        if (gather(l) < 0) return LOCKSTEP_LOST;
        pace_wait(pace_now() + 1000000, 0, &n->quit);
    }
    n->told = 0;
    n->start_ns = 0;
    n->life.state = LIFE_ACTIVE;
    n->life.armed = 1;
    node_enable(n, 0);
    while (n->slot < n->slots) {
        int32_t result = wait_for_samples(l);
        if (result) return result;
        give(l);
        result = node_slot(n, deadline_of(n), deadline_of(n), 0);
        if (result) return result;
        if ((result = send(l)) != 0) return result;
    }
    n->life.state = LIFE_FINISHED;
    return LIVE_FINISHED;
}
