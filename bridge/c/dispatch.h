/* dispatch.h: reception of frames by a node. */
#ifndef BRIDGE_DISPATCH_H
#define BRIDGE_DISPATCH_H

#include "node.h"

/* Dispatches the frames that have arrived by limit_ns (relative) to their receivers. */
void node_hear(node_t *n, int64_t limit_ns);
/* Whether a frame is an emergency stop, which stops every node on its bus. */
int32_t node_is_estop(const node_t *n, const frame_t *frame);
/* The command in an NMT frame for this node, COMMAND_NONE: it is none. */
int32_t node_told_by(const node_t *n, const frame_t *frame);

#endif
