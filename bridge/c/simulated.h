/* simulated.h: nodes on the simulated clock. */
#ifndef BRIDGE_SIMULATED_H
#define BRIDGE_SIMULATED_H

#include "node.h"

/* All nodes to the end, the next deadline first; frames take frame_time on their bus (ns), one after the
 * other, and are forwarded when they arrive. `routes`: for each node and bus the number of the shared
 * network, or -1; `busy`: until when each network is busy. Ends before `until_ns`; the next call
 * continues from there. */
API int32_t nodes_simulate(node_t **nodes, int32_t n_nodes,
                           int64_t (*frame_time)(const frame_t *, double, double),
                           const double *bitrates, int64_t *busy, const int32_t *routes, int32_t n_routes,
                           int64_t until_ns);

/* Slots of one node, slot i with what has arrived by limits[i]: of a bus log. */
API int32_t node_follow(node_t *n, const int64_t *limits, int64_t count);

#endif
