/* simulated_clock.h: nodes on the simulated clock. */
#ifndef BRIDGE_SIMULATED_CLOCK_H
#define BRIDGE_SIMULATED_CLOCK_H

#include "network.h"
#include "node.h"

/* Where a bus of a node leads: the number of a network, and of this node on it; network -1: nowhere. */
typedef struct {
    int32_t network, node;
} route_t;

/* All nodes to the end, the next deadline first. Frames travel on the networks; those that a gateway
 * forwards leave it when they arrive. `routes`: n_routes of each node, one a bus. Ends before `until_ns`;
 * the next call continues from there. */
API int32_t nodes_simulate(node_t **nodes, int32_t n_nodes, network_t *networks, int32_t n_networks,
                           const route_t *routes, int32_t n_routes, int64_t until_ns);

/* The next slot of one node, at its deadline, with what has arrived. Its frames are in its buses' tx. */
API int32_t node_step(node_t *n);

/* Slots of one node, slot i with what has arrived by limits[i]: of a bus log. */
API int32_t node_follow(node_t *n, const int64_t *limits, int64_t count);

#endif
