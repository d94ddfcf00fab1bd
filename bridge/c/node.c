/* node.c: one slot of a node: life cycle, outlets, journal; see node.h. */
#include "node.h"

#include <string.h>

API size_t node_sizes(int32_t which)
{
    static const size_t sizes[] = {sizeof(history_t), sizeof(reception_t), sizeof(inlet_t),
                                   sizeof(outlet_t), sizeof(node_t), sizeof(row_t),
                                   sizeof(inlet_row_t), sizeof(played_t)};
    return which >= 0 && which < 8 ? sizes[which] : 0;
}

/* ---- outlets ---- */

static void guarded(outlet_t *o, const double *signals)
{
    node_t *n = o->node;
    double out[32];
    guard_apply(o->guard, o->values + o->guarded, o->q < 0 ? 0 : signals + o->q,
                o->dq < 0 ? 0 : signals + o->dq, n->life.scale, out);
    memcpy(o->values + o->guarded, out, (size_t)o->joints * sizeof *out);
    n->life.now |= guard_why(o->guard);
}

static uint32_t status(const node_t *n, const outlet_t *o)
{
    uint32_t s = (uint32_t)n->life.state & STATUS_LIFE;
    if (n->life.armed) s |= STATUS_DEADMAN;
    if (n->life.reasons & WHY_ESTOP) s |= STATUS_ESTOP;
    if (o->guard && o->guard->bits) s |= STATUS_SATURATED;
    if (n->life.reasons & WHY_STALE) s |= STATUS_STALE;
    return n->simulated ? s | STATUS_SIMULATED : s;
}

/* As the drive's encoders see it; of what the message does not carry there is nothing to see. */
static void measured(outlet_t *o)
{
    double none[32] = {0};
    double *q = o->measured_q < 0 ? none : o->values + o->measured_q;
    double *dq = o->measured_dq < 0 ? none : o->values + o->measured_dq;
    drive_measure(o->drive, q, dq, q, dq);
}

static void gather(outlet_t *o, const double *signals)
{
    for (int32_t k = 0; k < o->width; k++) o->values[k] = signals[o->sources[k]];
    if (o->drive) measured(o);
    if (o->guard) guarded(o, signals);
}

/* What was sent, as its receivers see it. */
static void remember(outlet_t *o, const frame_t *frame, int64_t sequence)
{
    history_t *h = o->history;
    header_t header;
    const int64_t i = sequence - h->first;
    if (i < 0 || i >= h->capacity) return;
    if (message_decode(o->message, frame, h->values + i * h->width, &header) == DECODE_OK)
        h->there[i] = SAMPLE_THERE;
}

void node_say(outlet_t *o, int64_t sequence, int64_t now_ns)
{
    node_t *n = o->node;
    frame_t frame;
    header_t header;
    memset(&header, 0, sizeof header);
    header.counter = (uint32_t)sequence;
    header.status = status(n, o);
    header.t_us = (uint32_t)(now_ns / 1000);
    message_encode(o->message, o->values, &header, &frame);
    o->sent++;
    o->saturated += header.saturated != 0;
    if (o->history) remember(o, &frame, sequence);
    if (n->clock != CLOCK_REPLAY) node_send(n, o->bus, &frame, now_ns);
}

API int32_t outlet_pass(void *context, int64_t tick, double *signals)
{
    outlet_t *o = context;
    node_t *n = o->node;
    const int64_t hit = n->slot / o->hit_ticks;
    const int64_t began = n->clock == CLOCK_WALL ? pace_now() : 0;
    (void)tick;

    gather(o, signals);
    if (hit % o->every) return 0;
    node_say(o, hit / o->every, n->clock == CLOCK_WALL ? began - n->start_ns : n->now_ns + n->phase_ns);
    return 0;
}

/* ---- what else a node says ---- */

void node_send(node_t *n, int32_t bus, frame_t *frame, int64_t now_ns)
{
    bus_t *b = n->buses + bus;
    frame->bus = (uint8_t)bus;
    if (n->clock == CLOCK_WALL) {
        bus_send(b, frame);
        n->sent_ns = frame->t_ns - n->start_ns;
        return;
    }
    frame->t_ns = now_ns;
    b->sent++;
    if (!ring_put(b->tx, frame)) b->send_failed++;
}

/* Before the start: what this node would send first, so that others can look at it. */
void node_preview(node_t *n, int64_t now_ns)
{
    for (int32_t i = 0; i < n->n_outlets; i++) {
        outlet_t *o = n->outlets + i;
        if (!tells_life(o->message)) continue;
        for (int32_t k = 0; k < o->width; k++) o->values[k] = n->signals[o->sources[k]];
        if (o->guard) memset(o->values + o->guarded, 0, (size_t)o->joints * sizeof(double));
        node_say(o, 0, now_ns);
        o->sent = 0;
    }
}

void node_heartbeat(node_t *n, int64_t now_ns)
{
    if (!n->heartbeat) return;
    const double v[HEARTBEAT_VALUES] = {n->life.state, n->life.reasons, n->boots, n->life.armed};
    for (int32_t b = 0; b < n->n_buses; b++) {
        frame_t frame;
        header_t header;
        memset(&header, 0, sizeof header);
        message_encode(n->heartbeat, v, &header, &frame);
        node_send(n, b, &frame, now_ns);
    }
}

static void send_sync(node_t *n, int64_t now_ns)
{
    const double counter = 1.0 + n->sync_count++ % 240;
    for (int32_t b = 0; b < n->n_buses; b++) {
        frame_t frame;
        header_t header;
        memset(&header, 0, sizeof header);
        message_encode(n->sync, &counter, &header, &frame);
        node_send(n, b, &frame, now_ns);
    }
}

static void estop(node_t *n, int64_t now_ns)
{
    for (int32_t b = 0; b < n->n_buses; b++) {
        frame_t frame;
        header_t header;
        const double by[2] = {n->number, n->life.reasons};
        memset(&header, 0, sizeof header);
        message_encode(n->estop, by, &header, &frame);
        node_send(n, b, &frame, now_ns);
    }
}

/* ---- a slot ---- */

static void watch(node_t *n)
{
    for (int32_t i = 0; i < n->n_peers; i++) n->life.now |= peer_check(n->peers + i, n->now_ns);
    if (watchdog_check(&n->sync_watchdog, n->now_ns)) n->life.now |= WHY_SYNC;
}

static void live(node_t *n, row_t *row)
{
    if (n->clock == CLOCK_REPLAY) {
        const row_t *r = (const row_t *)(n->replayed + n->replay_row * n->row_size);
        n->life.now = r->now;
        n->life.command = r->command;
    } else {
        const int32_t command = __atomic_exchange_n(&n->command, COMMAND_NONE, __ATOMIC_ACQ_REL);
        watch(n);
        if (command != COMMAND_NONE) n->life.command = command;
    }
    if (row) {
        row->now = n->life.now;
        row->command = n->life.command;
    }
    life_step(&n->life);
}

static void write_row(node_t *n, row_t *row, int64_t limit_ns, int64_t woke_ns, uint32_t flags)
{
    char *base = (char *)row;
    inlet_row_t *in = (inlet_row_t *)(base + n->inlet_offset);
    double *out = (double *)(base + n->outlet_offset);

    row->slot = n->slot;
    row->deadline_ns = n->now_ns + n->phase_ns;
    row->woke_ns = woke_ns;
    row->sent_ns = n->sent_ns;
    row->done_ns = n->done_ns;
    row->state = n->life.state;
    row->reasons = n->life.reasons;
    row->scale = n->life.scale;
    row->flags = flags;
    row->guard = 0;
    for (int32_t i = 0; i < n->n_inlets; i++) {
        const inlet_t *x = n->inlets + i;
        in[i].held = x->held;
        in[i].newest = x->newest;
        in[i].transit_ns = x->reception->transit_ns;
        in[i].age_ns = x->held < 0 ? -1
                                   : limit_ns - x->held * x->reception->period_ns -
                                         x->reception->offset_ns;
    }
    for (int32_t i = 0; i < n->n_outlets; i++) {
        const outlet_t *o = n->outlets + i;
        memcpy(out, o->values, (size_t)o->width * sizeof *out);
        out += o->width;
        if (o->guard) row->guard |= o->guard->bits;
    }
}

static void housekeeping(node_t *n, int64_t now_ns)
{
    if (n->clock == CLOCK_REPLAY) return;
    if (n->heartbeat_slots > 0 && n->slot % n->heartbeat_slots == 0) node_heartbeat(n, now_ns);
    if (n->estop && n->life.reasons & WHY_ESTOP && n->slot % (n->heartbeat_slots + 1) == 0)
        estop(n, now_ns);
}

int32_t node_slot(node_t *n, int64_t limit_ns, int64_t woke_ns, uint32_t flags)
{
    row_t *row;
    n->now_ns = n->slot * n->h_ns;
    n->sent_ns = 0;
    if (n->clock != CLOCK_REPLAY) {
        if (n->sync_slots > 0 && n->slot % n->sync_slots == 0) send_sync(n, limit_ns);
        node_hear(n, limit_ns);
    }
    row = journal_next(n->journal);
    live(n, row);
    if (row) row->received_ns = n->clock == CLOCK_WALL ? pace_now() - n->start_ns : limit_ns;
    *n->record = row ? (double *)((char *)row + n->signals_offset) : 0;
    *n->record_row = 0;
    n->result = n->run(n->engine, 1);
    n->done_ns = n->clock == CLOCK_WALL ? pace_now() - n->start_ns : limit_ns;
    if (row) {
        write_row(n, row, limit_ns, woke_ns, flags);
        journal_commit(n->journal);
    }
    housekeeping(n, limit_ns);
    n->slot++;
    if (n->clock == CLOCK_REPLAY) n->replay_row++;
    return n->result;
}
