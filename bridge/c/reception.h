/* reception.h: a message that a node receives, from frame to delay line. */
#ifndef BRIDGE_RECEPTION_H
#define BRIDGE_RECEPTION_H

#include "node.h"

/* Checks, decodes, numbers and forwards a frame of r, and puts it into the delay lines of its inlets. */
void reception_take(node_t *n, reception_t *r, const frame_t *frame);

#endif
