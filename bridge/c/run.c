/* run.c: slots on three clocks: wall, simulated, replay; see node.h. */
#include "node.h"

#include <string.h>

/* ---- wall ---- */

enum { SETTLE_NS = 500000000 }; /* peers that were told the same START run by then */

/* The emulated drives of a node: on and enabled, their watchdogs running; its tables at this slot. */
API void node_enable(node_t *n, int64_t now_ns)
{
    for (int64_t i = 0; i < n->n_played; i++)
        *n->played[i].row = (n->slot + n->played[i].period - 1) / n->played[i].period;
    for (int32_t i = 0; i < n->n_inlets; i++) {
        if (!n->inlets[i].drive) continue;
        n->inlets[i].asked = 0;
        drive_request(n->inlets[i].drive, DRIVE_POWER_ON, now_ns);
        drive_request(n->inlets[i].drive, DRIVE_ENABLE, now_ns);
    }
    n->begun = 1;
    n->host_due_ns = now_ns;
    n->alarms = -1;
}

/* A node whose start lies behind it (it was started again) begins at a later slot, in which all its
 * components are due. They are started anew for it, with the time of the run. Nonzero: they cannot. */
static int32_t begin(node_t *n)
{
    const int64_t now = pace_now() - n->start_ns - n->phase_ns;
    if (now > 0) {
        int64_t align = n->first > 0 ? n->first : 1; /* `first` comes in as what slots are a multiple of */
        n->slot = ((now + n->lead_ns) / n->h_ns / align + 2) * align;
        if (n->joined && n->slot < n->slots && n->joined(n->slot)) return 1;
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
    n->epoch.due_ns = pace_now() + SETTLE_NS;
    node_enable(n, n->slot * n->h_ns);
    return 0;
}

/* A late slot is done as if it had been in time; one later than it may be is a fault. */
static int32_t late_slot(node_t *n, int64_t late, uint32_t *flags)
{
    histogram_add(&n->late, late);
    if (late < n->h_ns) return 0;
    n->missed++;
    *flags |= ROW_BURST;
    if (n->overrun_ns > 0 && late > n->overrun_ns) n->life.now |= WHY_OVERRUN;
    return 1;
}

/* Where real drives are meant, the last slot has no torque any more. */
static void prepare_end(node_t *n)
{
    if (n->simulated || n->ending || n->slot < n->slots - n->life.ramp_ticks) return;
    for (int32_t i = 0; i < n->n_outlets; i++)
        if (n->outlets[i].guard && n->life.state == LIFE_ACTIVE) n->ending = 1;
    if (n->ending) n->life.commands = commands_add(n->life.commands, COMMAND_STOP);
}

API int32_t node_live(node_t *n)
{
    const int32_t waited = node_wait(n);
    if (waited != LIVE_FINISHED) return waited;
    if (begin(n)) return LIVE_NOT_JOINED;
    int64_t woke = pace_now();
    while (n->slot < n->slots) {
        const int64_t deadline = n->start_ns + n->phase_ns + n->slot * n->h_ns;
        uint32_t flags = 0;
        if (woke < deadline) woke = node_rest(n, deadline);
        if (*(volatile int32_t *)&n->quit) break;
        const int32_t missed = late_slot(n, woke - deadline, &flags);
        prepare_end(n);
        const int32_t result =
            node_slot(n, (missed ? deadline : woke) - n->start_ns, woke - n->start_ns, flags);
        if (result) {
            node_let_down(n);
            return result;
        }
        woke = n->done_ns + n->start_ns;
        if (n->stopping && n->life.state != LIFE_STOPPING) break;
    }
    return node_end(n);
}

/* ---- simulated ---- */

typedef struct {
    node_t **nodes;
    const int32_t *routes;  /* n_nodes rows of n_routes: the network of each bus, -1: none */
    int32_t n_nodes, n_routes;
    int64_t (*frame_time)(const frame_t *, double, double);
    const double *bitrates; /* two a network */
    int64_t *busy;          /* a network: until */
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

/* When what has come to a gateway came first, INT64_MAX: nothing has. */
static int64_t arrival_at(node_t *n)
{
    int64_t first = INT64_MAX;
    for (int32_t b = 0; n->gateway && b < n->n_buses; b++) {
        if (!n->has_pending[b]) n->has_pending[b] = bus_receive(n->buses + b, n->pending + b);
        if (n->has_pending[b] && n->pending[b].t_ns < first) first = n->pending[b].t_ns;
    }
    return first;
}

/* When a node has to do something next; at its end it does nothing any more. */
static int64_t due(node_t *n)
{
    const int64_t slot = deadline_of(n), frame = slot == INT64_MAX ? slot : arrival_at(n);
    return frame < slot ? frame : slot;
}

API int32_t nodes_simulate(node_t **nodes, int32_t n_nodes,
                           int64_t (*frame_time)(const frame_t *, double, double),
                           const double *bitrates, int64_t *busy, const int32_t *routes,
                           int32_t n_routes, int64_t until_ns)
{
    twin_t w = {nodes, routes, n_nodes, n_routes, frame_time, bitrates, busy};
    for (;;) {
        int32_t next = -1, result = 0;
        int64_t now = INT64_MAX;
        for (int32_t i = 0; i < n_nodes; i++) {
            const int64_t t = due(nodes[i]);
            if (t < now) now = t, next = i;
        }
        if (next < 0 || now >= until_ns) return 0;
        if (now < deadline_of(nodes[next])) node_hear(nodes[next], now);
        else result = node_slot(nodes[next], now, now, 0);
        if (result) return result;
        hand_over(&w, next);
    }
}

API int32_t node_follow(node_t *n, const int64_t *limits, int64_t count)
{
    frame_t frame;
    int32_t result = 0;
    for (int64_t i = 0; i < count && !result; i++) {
        result = node_slot(n, limits[i], limits[i], 0);
        for (int32_t b = 0; b < n->n_buses; b++)
            while (ring_get(n->buses[b].tx, &frame)) {}
    }
    return result;
}

/* ---- replay ---- */

API int32_t node_replay(node_t *n)
{
    while (n->replay_row < n->replayed_rows) {
        const row_t *row = (const row_t *)(n->replayed + n->replay_row * n->row_size);
        const uint32_t flags = row->flags & ~(uint32_t)ROW_FAILED;
        const int32_t failed = (row->flags & ROW_FAILED) != 0;
        const int32_t result = node_slot(n, row->deadline_ns, row->woke_ns, flags);
        if (result && !failed) return result;
    }
    return 0;
}
