/* idle.h: sleep of a node. */
#ifndef BRIDGE_IDLE_H
#define BRIDGE_IDLE_H

#include "node.h"

/* Sleeps until the deadline (CLOCK_MONOTONIC) or `quit`; a gateway receives and forwards meanwhile.
 * Returns the time of the wake-up. */
int64_t node_idle(node_t *n, int64_t deadline_ns);

#endif
