/* simulated.c: slots on the simulated clock: the twin, and a node along a bus log; see simulated.h. */
#include "simulated.h"

#include "hear.h"
#include "slot.h"

typedef struct {
    node_t **nodes;
    const int32_t *routes;  /* n_nodes rows of n_routes: the network of each bus, -1: none */
    int32_t n_nodes, n_routes;
    int64_t (*frame_time)(const frame_t *, double, double);
    const double *bitrates; /* two a network */
    int64_t *busy;          /* a network: until */
} twin_t;

/* Hands a frame to all other nodes of a network, at the time at which its last bit is on the bus. */
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
