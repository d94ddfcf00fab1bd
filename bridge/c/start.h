/* start.h: a node before its first slot, on the wall clock. */
#ifndef BRIDGE_START_H
#define BRIDGE_START_H

#include "node.h"

/* Before the start, on the wall clock: sends heartbeats and previews until START is obeyed. START is
 * deferred until 100 ms before start_ns. It is obeyed then, or in the following 80 ms, as soon as
 * required peers are present, `awaited` messages have been received, drives have watchdogs and
 * positions are near each other; otherwise it is refused: `refusals`, `refused`. A START whose time
 * has passed (of a node that joins a run) waits for `patience_ns`. A node that `follows` joins a run
 * on its own when it receives EPOCH, until STOP. ARM waits for the same conditions, for 2 s at most. A rehearsal
 * arms itself; with real drives ARM must come first. LIVE_FINISHED: the node is ACTIVE. */
int32_t node_wait(node_t *n);
/* Between node_wait and the first slot, until this time of CLOCK_MONOTONIC: drives are fed. `hears`: what is
 * received until t = 0 counts as before the start, so that positions are those of now. */
void node_stand_by(node_t *n, int64_t until_ns, int32_t hears);
/* Message i is awaited and was not received; peer i is required and not present. */
API int32_t node_unheard(const node_t *n, int32_t i);
API int32_t node_absent(const node_t *n, int32_t i, int64_t now);

#endif
