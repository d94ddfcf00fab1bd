/* sequence.h: emulated drives with protocols of their own. */
#ifndef BRIDGE_SEQUENCE_H
#define BRIDGE_SEQUENCE_H

#include "node.h"

/* Whether a frame belongs to a sequence of an emulated drive, which follows it. */
int32_t node_asked(node_t *n, const frame_t *frame);

#endif
