/* service.h: what a node says besides its outlets. */
#ifndef BRIDGE_SERVICE_H
#define BRIDGE_SERVICE_H

#include "node.h"

/* `preview`: what outlets would send first, only in messages that tell it from samples. `host`: CANopen's
 * heartbeat (one byte, the state as CiA 301 numbers it), when it is due; `host_sync`: its SYNC. */
void node_heartbeat(node_t *n, int64_t now_ns);
void node_preview(node_t *n, int64_t now_ns);
void node_sync(node_t *n, int64_t now_ns);
void node_host(node_t *n, int64_t now_ns);
void node_host_sync(node_t *n, int64_t now_ns);
/* ESTOP: the node that raised it repeats it every 10 ms until RESET; one that heard it passes it on ten
 * times, on all its buses (a gateway the first time at once). */
void node_alarm(node_t *n, int64_t now_ns);
void node_estop(node_t *n, int64_t now_ns);

#endif
