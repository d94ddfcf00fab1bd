/* rest.h: how a node sleeps. */
#ifndef BRIDGE_REST_H
#define BRIDGE_REST_H

#include "node.h"

/* Until the deadline (CLOCK_MONOTONIC) or `quit`; a gateway hears, and forwards, meanwhile. Returns the
 * time it woke at. */
int64_t node_idle(node_t *n, int64_t deadline_ns);

#endif
