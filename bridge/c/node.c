/* node.c: one slot of a node: outlets, life cycle, journal; see node.h. */
#include "node.h"

#include <errno.h>
#include <string.h>

/* ---- outlets ---- */

static void guarded(outlet_t *o, const double *signals)
{
    node_t *n = o->node;
    double out[SAFETY_JOINTS];
    guard_apply(o->guard, o->values + o->guarded, o->q < 0 ? 0 : signals + o->q,
                o->dq < 0 ? 0 : signals + o->dq, n->life.scale, out);
    memcpy(o->values + o->guarded, out, (size_t)o->joints * sizeof *out);
    n->life.now |= guard_why(o->guard);
}

static uint32_t status(const node_t *n, const outlet_t *o)
{
    /* once it runs, what it sends are samples, also after a stop */
    const int32_t idle = n->begun && n->life.state == LIFE_INACTIVE;
    uint32_t s = (uint32_t)(idle ? LIFE_STOPPING : n->life.state) & STATUS_LIFE;
    if (n->life.armed) s |= STATUS_DEADMAN;
    if (n->life.reasons & WHY_ESTOP) s |= STATUS_ESTOP;
    if (o->guard && o->guard->bits) s |= STATUS_SATURATED;
    if (n->life.reasons & WHY_STALE) s |= STATUS_STALE;
    return n->simulated ? s | STATUS_SIMULATED : s;
}

/* As the drive's encoders see it; of what the message does not carry there is nothing to see. */
static void measured(outlet_t *o)
{
    double none[SAFETY_JOINTS] = {0};
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
    if (message_decode(o->message, frame, h->values + i * h->width, &header) != DECODE_OK) return;
    h->there[i] = SAMPLE_THERE;
    for (int64_t k = 0; k < o->n_forwards; k++) forward_remember(o->forwards + k, i);
}

void node_say(outlet_t *o, int64_t sequence, int64_t now_ns)
{
    node_t *n = o->node;
    frame_t frame;
    header_t header;
    if (o->foreign && n->disabled) return; /* some would take a torque for a request to be enabled */
    memset(&frame, 0, sizeof frame);
    memset(&header, 0, sizeof header);
    header.counter = (uint32_t)sequence;
    header.status = status(n, o);
    header.t_us = (uint32_t)((sequence * o->every * o->hit_ticks * n->h_ns + n->phase_ns) / 1000);
    message_encode(o->message, o->values, &header, &frame);
    o->sent++;
    o->saturated += header.saturated != 0;
    if (o->history) remember(o, &frame, sequence);
    if (n->clock == CLOCK_WALL && n->start_ns) frame.t_ns = n->start_ns + now_ns;
    if (n->clock != CLOCK_REPLAY) node_send(n, o->bus, &frame, now_ns);
}

API int32_t outlet_pass(void *context, int64_t tick, double *signals)
{
    outlet_t *o = context;
    node_t *n = o->node;
    const int64_t hit = n->slot / o->hit_ticks;
    (void)tick;

    gather(o, signals);
    if (hit % o->every) return 0;
    const int64_t began = n->clock == CLOCK_WALL ? pace_now() : 0;
    node_say(o, hit / o->every, n->clock == CLOCK_WALL ? began - n->start_ns : n->now_ns + n->phase_ns);
    if (n->clock == CLOCK_WALL) n->send_ns += pace_now() - began;
    return 0;
}

API int32_t inside_pass(void *context, int64_t tick, double *signals)
{
    const inside_t *x = context;
    node_t *n = x->node;
    double out[SAFETY_JOINTS];
    (void)tick;
    guard_apply(x->guard, signals + x->tau, x->q < 0 ? 0 : signals + x->q,
                x->dq < 0 ? 0 : signals + x->dq, n->life.scale, out);
    memcpy(signals + x->tau, out, (size_t)x->guard->joints * sizeof *out);
    n->life.now |= guard_why(x->guard);
    return 0;
}

int32_t node_send(node_t *n, int32_t bus, frame_t *frame, int64_t now_ns)
{
    bus_t *b = n->buses + bus;
    frame->bus = (uint8_t)bus;
    if (n->clock == CLOCK_WALL) return bus_send(b, frame);
    frame->t_ns = now_ns;
    b->sent++;
    if (ring_put(b->tx, frame)) return 0;
    b->send_failed++;
    return ENOBUFS;
}

/* ---- a slot ---- */

/* At its own end a node does not mind that its peers end, too. */
static void watch(node_t *n)
{
    for (int32_t i = 0; i < n->n_peers && !n->ending; i++)
        n->life.now |= peer_check(n->peers + i, n->now_ns);
    if (watchdog_check(&n->sync_watchdog, n->now_ns)) n->life.now |= WHY_SYNC;
    if (n->alarm == ALARM_RAISED) n->life.now |= WHY_ESTOP, n->alarm = ALARM_OURS;
    for (int32_t i = 0; i < n->n_outlets; i++)
        if (n->buses[n->outlets[i].bus].state >= BUS_OFF) n->life.now |= WHY_BUS;
}

/* Emulated drives follow their node: RESET clears them, START enables them, FAULT stops them. */
static void drives(node_t *n, int32_t before)
{
    const int32_t state = n->life.state;
    if (state == before) return;
    /* FAULT -> RESET, ARM, START in one slot: cleared, then enabled */
    for (int32_t i = 0; i < n->n_inlets; i++) {
        drive_t *d = n->inlets[i].drive;
        if (!d) continue;
        if (before == LIFE_FAULT) drive_request(d, DRIVE_CLEAR, n->now_ns);
        if (state == LIFE_ACTIVE) drive_request(d, DRIVE_ENABLE, n->now_ns);
        else if (state == LIFE_FAULT && d->state == DRIVE_ENABLED) d->state = DRIVE_FAULT;
    }
}

void node_tell(node_t *n, int32_t command)
{
    uint32_t before = __atomic_load_n(&n->told, __ATOMIC_ACQUIRE);
    while (!__atomic_compare_exchange_n(&n->told, &before, commands_add(before, command), 0,
                                        __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE)) {}
}

/* The commands of this slot: those heard, then those told. */
static uint32_t take_told(node_t *n)
{
    uint32_t found = n->life.commands;
    for (uint32_t told = __atomic_exchange_n(&n->told, 0, __ATOMIC_ACQ_REL); told; told >>= 3)
        found = commands_add(found, (int32_t)(told & 7));
    return found;
}

static void live(node_t *n, row_t *row)
{
    const int32_t before = n->life.state;
    if (n->clock == CLOCK_REPLAY) {
        const row_t *r = (const row_t *)(n->replayed + n->replay_row * n->row_size);
        n->life.now = r->now;
        n->life.commands = r->commands;
    } else {
        watch(n);
        n->life.commands = take_told(n);
        if (commands_have(n->life.commands, COMMAND_STOP)) n->stopping = 1;
    }
    if (row) {
        row->now = n->life.now;
        row->commands = n->life.commands;
    }
    life_step(&n->life);
    drives(n, before);
}

static void write_row(node_t *n, row_t *row, int64_t limit_ns, int64_t woke_ns, uint32_t flags)
{
    char *base = (char *)row;
    inlet_row_t *in = (inlet_row_t *)(base + n->inlet_offset);
    double *out = (double *)(base + n->outlet_offset);

    row->slot = n->slot;
    row->deadline_ns = n->now_ns + n->phase_ns;
    row->woke_ns = woke_ns;
    row->send_ns = n->send_ns;
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
        in[i].requests = x->requests;
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
    for (int32_t i = 0; i < n->n_insides; i++) row->guard |= n->insides[i].guard->bits;
}

static void housekeeping(node_t *n, int64_t now_ns)
{
    if (n->clock == CLOCK_REPLAY) return;
    if (n->heartbeat_slots > 0 && n->slot % n->heartbeat_slots == 0) node_heartbeat(n, now_ns);
    node_host(n, now_ns);
    node_host_sync(n, now_ns);
    node_alarm(n, now_ns);
    node_epoch_answer(n);
}

int32_t node_slot(node_t *n, int64_t limit_ns, int64_t woke_ns, uint32_t flags)
{
    row_t *row;
    n->now_ns = n->slot * n->h_ns;
    n->send_ns = 0;
    if (n->clock != CLOCK_REPLAY) {
        if (n->sync_slots > 0 && n->slot % n->sync_slots == 0) node_sync(n, limit_ns);
        node_hear(n, limit_ns);
    }
    row = journal_next(n->journal);
    live(n, row);
    if (row) row->received_ns = n->clock == CLOCK_WALL ? pace_now() - n->start_ns : limit_ns;
    *n->record = row ? (double *)((char *)row + n->signals_offset) : 0;
    *n->record_row = 0;
    n->result = n->run(n->engine, 1);
    flags |= node_drives(n, limit_ns);
    n->done_ns = n->clock == CLOCK_WALL ? pace_now() - n->start_ns : limit_ns;
    if (row) {
        write_row(n, row, limit_ns, woke_ns, flags | (n->result ? ROW_FAILED : 0));
        journal_commit(n->journal);
    }
    housekeeping(n, limit_ns);
    n->slot++;
    if (n->clock == CLOCK_REPLAY) n->replay_row++;
    return n->result;
}
