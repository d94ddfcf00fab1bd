/* shutdown.h: the ends of a run on the wall clock; all leave zero torque on the bus. */
#ifndef BRIDGE_SHUTDOWN_H
#define BRIDGE_SHUTDOWN_H

#include "node.h"

/* A component has failed: its torque is let down in the life cycle's ramp. */
void node_ramp_down(node_t *n);
/* Zero torque, and the last heartbeat. */
void node_send_final(node_t *n);
/* The last slot is done, or the node was stopped. Returns LIVE_... */
int32_t node_end(node_t *n);

#endif
