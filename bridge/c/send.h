/* send.h: a frame handed to a bus, or in a twin to its queue. */
#ifndef BRIDGE_SEND_H
#define BRIDGE_SEND_H

#include "node.h"

/* Sets the number of the bus and the time now_ns (relative). Returns 0, or why it was not handed over: of
 * bus_send. */
int32_t node_send(node_t *n, int32_t bus, frame_t *frame, int64_t now_ns);
/* A message of services_t on one bus; m NULL: the bus does not have it. */
void node_service(node_t *n, int32_t bus, const message_t *m, const double *values, header_t header,
                  int64_t now_ns);

#endif
