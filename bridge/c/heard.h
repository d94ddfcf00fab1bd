/* heard.h: the journal of what a node heard. */
#ifndef BRIDGE_HEARD_H
#define BRIDGE_HEARD_H

#include "node.h"

/* A sample of r that was accepted, with r's values. */
void node_heard(node_t *n, const reception_t *r, int64_t sequence, int64_t arrival_ns, uint32_t status);

#endif
