/* replay.h: a node on the clock of its recording. */
#ifndef BRIDGE_REPLAY_H
#define BRIDGE_REPLAY_H

#include "node.h"

/* Runs the node along its recording, from the samples it held; returns the engine's result. */
API int32_t node_replay(node_t *n);

#endif
