/* reception.h: a message that a node hears, from frame to delay line. */
#ifndef BRIDGE_RECEPTION_H
#define BRIDGE_RECEPTION_H

#include "node.h"

/* A frame of r: checked, decoded, numbered, forwarded, and put into the delay lines of its inlets. */
void reception_take(node_t *n, reception_t *r, const frame_t *frame);

#endif
