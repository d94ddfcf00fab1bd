/* simulated_clock.c: slots on the simulated clock: the twin, and a node along a bus log; see simulated_clock.h. */
#include "simulated_clock.h"

#include "dispatch.h"
#include "slot.h"

typedef struct {
    node_t **nodes;
    network_t *networks;
    const route_t *routes; /* n_nodes rows of n_routes */
    int32_t n_nodes, n_networks, n_routes;
    int32_t forwarding; /* a node forwards frames when they arrive */
} twin_t;

/* What a node has sent, to its networks. */
static void hand_over(const twin_t *w, int32_t i)
{
    frame_t frame;
    node_t *n = w->nodes[i];
    for (int32_t b = 0; b < n->n_buses; b++) {
        const route_t *r = w->routes + i * w->n_routes + b;
        while (ring_get(n->buses[b].tx, &frame))
            if (r->network >= 0) network_send(w->networks + r->network, r->node, &frame);
    }
}

static void go_on(const twin_t *w, int64_t until_ns)
{
    for (int32_t i = 0; i < w->n_networks; i++) network_advance(w->networks + i, until_ns);
}

/* When a frame may arrive next on any network. */
static int64_t next_arrival(const twin_t *w)
{
    int64_t first = INT64_MAX;
    for (int32_t i = 0; i < w->n_networks; i++) {
        const int64_t next = network_next(w->networks + i);
        if (next < first) first = next;
    }
    return first;
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

static int32_t forwards(const twin_t *w)
{
    for (int32_t i = 0; i < w->n_nodes; i++)
        if (w->nodes[i]->gateway) return 1;
    return 0;
}

API int32_t nodes_simulate(node_t **nodes, int32_t n_nodes, network_t *networks, int32_t n_networks,
                           const route_t *routes, int32_t n_routes, int64_t until_ns)
{
    twin_t w = {nodes, networks, routes, n_nodes, n_networks, n_routes, 0};
    w.forwarding = forwards(&w);
    for (;;) {
        int32_t next = -1, result = 0;
        int64_t now = INT64_MAX;
        for (int32_t i = 0; i < n_nodes; i++) {
            const int64_t t = due(nodes[i]);
            if (t < now) now = t, next = i;
        }
        if (next < 0 || now >= until_ns) return 0;
        const int64_t arrival = w.forwarding ? next_arrival(&w) : INT64_MAX;
        go_on(&w, arrival < now ? arrival : now);
        if (arrival < now) continue; /* a gateway may have to forward it first */
        if (now < deadline_of(nodes[next])) node_hear(nodes[next], now);
        else result = node_slot(nodes[next], now, now, 0);
        if (result) return result;
        hand_over(&w, next);
    }
}

API int32_t node_step(node_t *n)
{
    const int64_t now = deadline_of(n);
    return node_slot(n, now, now, 0);
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
