/* forward.h: messages that a gateway makes from received messages. */
#ifndef BRIDGE_FORWARD_H
#define BRIDGE_FORWARD_H

#include "node.h"

/* A sample or preview of r that has been accepted, as the messages made of it, with the number, time and
 * status of its first sender. */
void node_forward(node_t *n, const reception_t *r, const header_t *header, const frame_t *came);
/* NMT or EPOCH (its place in services_t) from one bus, on all others. */
void node_pass(node_t *n, size_t service, const double *values, header_t header, const frame_t *came);
/* Replay: what receivers behind the gateway got of a sample, through both codecs. */
void forward_remember(forward_t *f, int64_t sample);

#endif
