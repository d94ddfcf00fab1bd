/* start.h: a node before its first slot, on the wall clock. */
#ifndef BRIDGE_START_H
#define BRIDGE_START_H

#include "node.h"

/* Before the start, on the wall clock: heartbeats and previews, until START is obeyed. START is held
 * until 100 ms before start_ns and obeyed then, or in the 80 ms after it, as soon as required peers
 * are there, messages that are `awaited` were heard, drives have watchdogs and positions are near each
 * other; else it is refused: `refusals`, `refused`. A START whose time has passed (of a node that joins
 * a run) waits for `patience_ns`. A node that `follows` joins by itself a run whose EPOCH it hears, until
 * it is told to STOP. ARM is refused likewise. A rehearsal arms itself; where real drives
 * are meant, ARM has to come first. LIVE_FINISHED: it is ACTIVE. */
int32_t node_wait(node_t *n);
/* Message i is awaited and was not heard; peer i is required and not there. */
API int32_t node_unheard(const node_t *n, int32_t i);
API int32_t node_absent(const node_t *n, int32_t i, int64_t now);

#endif
