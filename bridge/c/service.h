/* service.h: messages that a node sends in addition to its outlets. */
#ifndef BRIDGE_SERVICE_H
#define BRIDGE_SERVICE_H

#include "node.h"

/* `preview`: the first values of outlets, only in messages that mark them as previews. `host`: CANopen's
 * heartbeat (one byte, the state as numbered by CiA 301), when it is due; `host_sync`: its SYNC. */
void node_heartbeat(node_t *n, int64_t now_ns);
void node_preview(node_t *n, int64_t now_ns);
void node_sync(node_t *n, int64_t now_ns);
API void node_host(node_t *n, int64_t now_ns);
void node_host_sync(node_t *n, int64_t now_ns);
/* The same before the first slot, at most as often: drives tell their state and position at a SYNC. */
API void node_host_sync_early(node_t *n, int64_t now_ns);
/* ESTOP: the node that raised it repeats it every 10 ms until RESET; a node that receives it forwards it
 * ten times on all its buses (a gateway forwards it immediately the first time). */
void node_alarm(node_t *n, int64_t now_ns);
void node_estop(node_t *n, int64_t now_ns);

#endif
