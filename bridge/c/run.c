/* run.c: slots on three clocks: wall, simulated, replay; see node.h. */
#include "node.h"

#include <string.h>

/* ---- wall ---- */

enum { IDLE_NS = 5000000 };

/* Before the start: frames are heard, heartbeats and first values sent, commands obeyed. */
static int32_t wait_for_start(node_t *n)
{
    int64_t next = pace_now(), beat = 0;
    n->life.state = LIFE_INACTIVE;
    for (;;) {
        if (*(volatile int32_t *)&n->quit) return LIVE_NEVER_STARTED;
        n->now_ns = 0;
        node_hear(n, INT64_MAX);
        const int32_t command = __atomic_exchange_n(&n->command, COMMAND_NONE, __ATOMIC_ACQ_REL);
        if (command != COMMAND_NONE) n->life.command = command;
        n->life.now &= ~(uint32_t)WHY_NOT_YET;
        if (n->life.command == COMMAND_START && n->start_commands++ == 0 && !n->life.armed) {
            n->life.command = COMMAND_ARM;
            life_step(&n->life);
            n->life.command = COMMAND_START;
        }
        life_step(&n->life);
        if (n->life.state == LIFE_ACTIVE && n->start_ns) return LIVE_FINISHED;
        if (n->life.state == LIFE_FAULT) return LIVE_NEVER_STARTED;
        if (next >= beat) {
            node_heartbeat(n, 0);
            node_preview(n, 0);
            beat = next + 4 * IDLE_NS;
        }
        next += IDLE_NS;
        pace_wait(next, 0, &n->quit);
    }
}

/* The emulated drives of a node: on and enabled, their watchdogs running; its tables at this slot. */
API void node_enable(node_t *n, int64_t now_ns)
{
    for (int64_t i = 0; i < n->n_played; i++)
        *n->played[i].row = (n->slot + n->played[i].period - 1) / n->played[i].period;
    for (int32_t i = 0; i < n->n_inlets; i++) {
        if (!n->inlets[i].drive) continue;
        drive_request(n->inlets[i].drive, DRIVE_POWER_ON, now_ns);
        drive_request(n->inlets[i].drive, DRIVE_ENABLE, now_ns);
    }
}

/* A node whose start lies behind it (it was started again) begins at the next slot. */
static void begin(node_t *n)
{
    const int64_t now = pace_now() - n->start_ns - n->phase_ns;
    if (now > 0) {
        int64_t align = n->first > 0 ? n->first : 1; /* `first` comes in as what slots are a multiple of */
        n->slot = (now / n->h_ns / align + 2) * align;
    } else {
        n->slot = 0;
    }
    n->first = n->slot;
    for (int32_t i = 0; i < n->n_inlets; i++) n->inlets[i].heard_ns = n->slot * n->h_ns;
    for (int32_t i = 0; i < n->n_peers; i++) {
        watchdog_reset(&n->peers[i].heartbeat, n->slot * n->h_ns + n->h_ns);
        n->peers[i].state = -1;
    }
    watchdog_reset(&n->sync_watchdog, n->slot * n->h_ns);
    node_enable(n, n->slot * n->h_ns);
}

/* A component has failed: nothing can be computed any more, so the last torque is let down in the
 * life cycle's ramp, slot by slot, and the others are told. */
static void let_down(node_t *n)
{
    double last[8][32];
    const int32_t outlets = n->n_outlets < 8 ? n->n_outlets : 8;
    for (int32_t i = 0; i < outlets; i++)
        for (int32_t k = 0; n->outlets[i].guard && k < n->outlets[i].joints && k < 32; k++)
            last[i][k] = n->outlets[i].values[n->outlets[i].guarded + k];
    n->life.now |= WHY_COMPONENT;
    do {
        const int64_t deadline = n->start_ns + n->phase_ns + ++n->slot * n->h_ns;
        if (pace_now() < deadline) pace_wait(deadline, 0, &n->quit);
        life_step(&n->life);
        for (int32_t i = 0; i < outlets; i++) {
            outlet_t *o = n->outlets + i;
            if (!o->guard || n->slot / o->hit_ticks % o->every) continue;
            for (int32_t k = 0; k < o->joints && k < 32; k++)
                o->values[o->guarded + k] = last[i][k] * n->life.scale;
            node_say(o, n->slot / o->hit_ticks / o->every, pace_now() - n->start_ns);
        }
        node_heartbeat(n, pace_now() - n->start_ns);
    } while (n->life.state == LIFE_STOPPING && !*(volatile int32_t *)&n->quit);
}

API int32_t node_live(node_t *n)
{
    const int32_t waited = wait_for_start(n);
    if (waited != LIVE_FINISHED) return waited;
    begin(n);
    int64_t woke = pace_now();
    while (n->slot < n->slots) {
        const int64_t deadline = n->start_ns + n->phase_ns + n->slot * n->h_ns;
        int64_t limit;
        uint32_t flags = 0;
        if (woke < deadline) woke = pace_wait(deadline, n->spin_ns, &n->quit);
        if (*(volatile int32_t *)&n->quit) return LIVE_STOPPED;
        const int64_t late = woke - deadline;
        histogram_add(&n->late, late);
        limit = woke - n->start_ns;
        if (late >= n->h_ns) {
            n->missed++;
            flags |= ROW_BURST;
            limit = deadline - n->start_ns; /* as if it had been in time */
            if (n->overrun_ns > 0 && late > n->overrun_ns) n->life.now |= WHY_OVERRUN;
        }
        const int32_t result = node_slot(n, limit, woke - n->start_ns, flags);
        if (result) {
            let_down(n);
            return result;
        }
        woke = n->done_ns + n->start_ns;
        if (n->life.state == LIFE_INACTIVE) break; /* a stop, at the end of its ramp */
    }
    const int32_t stopped = n->slot < n->slots;
    if (!stopped) n->life.state = LIFE_FINISHED;
    node_heartbeat(n, pace_now() - n->start_ns);
    return stopped ? LIVE_STOPPED : LIVE_FINISHED;
}

/* ---- simulated ---- */

typedef struct {
    node_t **nodes;
    const int32_t *routes;  /* n_nodes rows of n_routes: the network of each bus, -1: none */
    int32_t n_nodes, n_routes;
    int64_t (*frame_time)(const frame_t *, double, double);
    const double *bitrates; /* two a network */
    int64_t busy[64];       /* a network: until */
} twin_t;

/* To everybody else on the network, when the frame has gone over it. */
static void deliver(twin_t *w, int32_t from, int32_t network, frame_t *frame)
{
    const int64_t begin = frame->t_ns > w->busy[network] ? frame->t_ns : w->busy[network];
    frame->t_ns = begin + w->frame_time(frame, w->bitrates[2 * network], w->bitrates[2 * network + 1]);
    w->busy[network] = frame->t_ns;
    for (int32_t i = 0; i < w->n_nodes; i++) {
        for (int32_t b = 0; i != from && b < w->nodes[i]->n_buses; b++)
            if (w->routes[i * w->n_routes + b] == network)
                ring_put(w->nodes[i]->buses[b].rx, frame);
    }
}

static void hand_over(twin_t *w, int32_t i)
{
    frame_t frame;
    node_t *n = w->nodes[i];
    for (int32_t b = 0; b < n->n_buses; b++)
        while (ring_get(n->buses[b].tx, &frame)) deliver(w, i, w->routes[i * w->n_routes + b], &frame);
}

static int64_t deadline_of(const node_t *n)
{
    return n->slot < n->slots ? n->slot * n->h_ns + n->phase_ns : INT64_MAX;
}

API int32_t nodes_simulate(node_t **nodes, int32_t n_nodes,
                           int64_t (*frame_time)(const frame_t *, double, double),
                           const double *bitrates, int32_t n_networks, const int32_t *routes,
                           int32_t n_routes)
{
    twin_t w = {nodes, routes, n_nodes, n_routes, frame_time, bitrates, {0}};
    if (n_networks > 64) return -1;
    for (;;) {
        int32_t next = 0;
        for (int32_t i = 1; i < n_nodes; i++)
            if (deadline_of(nodes[i]) < deadline_of(nodes[next])) next = i;
        const int64_t now = deadline_of(nodes[next]);
        if (now == INT64_MAX) return 0;
        const int32_t result = node_slot(nodes[next], now, now, 0);
        if (result) return result;
        hand_over(&w, next);
    }
}

/* ---- replay ---- */

/* Whether everything is there that the next slot held when it was recorded. */
static int32_t ready(const node_t *n)
{
    const char *row = n->replayed + n->replay_row * n->row_size;
    const inlet_row_t *in = (const inlet_row_t *)(row + n->inlet_offset);
    for (int32_t i = 0; i < n->n_inlets; i++) {
        const history_t *h = n->inlets[i].reception->history;
        if (!h || in[i].held < 0) continue;
        const int64_t k = in[i].held - h->first;
        if (k >= 0 && k < h->capacity && h->there[k] == SAMPLE_AWAITED) return 0;
    }
    return 1;
}

API int32_t nodes_replay(node_t **nodes, int32_t n_nodes, int32_t *stuck)
{
    for (;;) {
        int32_t moved = 0, left = -1;
        for (int32_t i = 0; i < n_nodes; i++) {
            node_t *n = nodes[i];
            while (n->replay_row < n->replayed_rows && ready(n)) {
                const row_t *row = (const row_t *)(n->replayed + n->replay_row * n->row_size);
                const int32_t result = node_slot(n, row->deadline_ns, row->woke_ns, row->flags);
                if (result) {
                    *stuck = i;
                    return result;
                }
                moved = 1;
            }
            if (n->replay_row < n->replayed_rows) left = i;
        }
        if (left < 0) return 0;
        if (!moved) {
            *stuck = left;
            return -1;
        }
    }
}
