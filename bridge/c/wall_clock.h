/* wall_clock.h: a node on the wall clock. */
#ifndef BRIDGE_WALL_CLOCK_H
#define BRIDGE_WALL_CLOCK_H

#include "node.h"

/* Wall clock: from configured to finished. Waits for COMMAND_START with start_ns set (or NMT start),
 * then slot by slot until the end, a stop, or `quit`. Where real drives are meant, the life cycle's
 * ramp ends with the last slot; a rehearsal, comparable to its end, sends zero torque after it. */
API int32_t node_live(node_t *n);

#endif
