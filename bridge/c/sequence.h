/* sequence.h: drives with their own protocols: disabled, enabled, and emulated. */
#ifndef BRIDGE_SEQUENCE_H
#define BRIDGE_SEQUENCE_H

#include "node.h"

/* Called after the torques of a slot. In FAULT (after the ramp) the drives are disabled, and again every
 * 100 ms, because a frame may get lost or a supervisor may enable them. When the node is ACTIVE again,
 * they are cleared and enabled. Returns ROW_DISABLED, ROW_ENABLED or 0. */
uint32_t node_drives(node_t *n, int64_t now_ns);
/* Disabled now. */
void node_disable(node_t *n, int64_t now_ns);
/* Whether a frame belongs to a sequence of an emulated drive, which follows it. */
int32_t node_asked(node_t *n, const frame_t *frame);

#endif
