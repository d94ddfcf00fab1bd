/* slot.h: one slot of a node, for any clock: read the buses, step the life cycle, run one tick of the
 * plan (whose gates are inlets and outlets), write a row of the journal. It does not allocate, print
 * or wait. */
#ifndef BRIDGE_SLOT_H
#define BRIDGE_SLOT_H

#include "node.h"

/* With what has arrived by limit_ns (relative). Returns the engine's result. */
int32_t node_slot(node_t *n, int64_t limit_ns, int64_t woke_ns, uint32_t flags);
/* At the first slot: emulated drives on and enabled, tables at their rows. */
API void node_enable(node_t *n, int64_t now_ns);
/* A command from another thread: none is lost, whoever else gives one. */
API void node_tell(node_t *n, int32_t command);

#endif
