/* emulated.h: the emulated drives of a node that are their vendors' state machines. `t_ns` is the time of
 * frame stamps: CLOCK_MONOTONIC, or the simulated clock. */
#ifndef BRIDGE_EMULATED_H
#define BRIDGE_EMULATED_H

#include "node.h"

/* On the wall clock they begin switched on and disabled; where time begins with the first slot, as their
 * bring-up leaves them. */
void emulated_begin(node_t *n, int64_t t_ns);
/* Gives a frame to the drives of its bus. Returns 1 if it asks one of them for something else than torque. */
int32_t emulated_hear(node_t *n, const frame_t *frame);
/* Before the run of a slot: what has become of them until t_ns, or was recorded; frames of their own. */
void emulated_step(node_t *n, int64_t t_ns);
/* Before the first slot, once in a while: what has become of them; then, behind their feedback, what they send. */
void emulated_attend(node_t *n, int64_t t_ns);
void emulated_flush(node_t *n, int64_t t_ns);
/* Whether the drive of an outlet sends this feedback in this slot. */
int32_t emulated_owes(const outlet_t *o);
/* Its feedback, as the drive makes a frame of it; `now_ns`: of the run. */
void emulated_say(outlet_t *o, frame_t *frame, int64_t now_ns);

#endif
