/* firmware.h - one node of a deployment on a microcontroller: its start, its life on the wall clock, its slots.
 *
 * The node is that of portable.h, its attachment to the board hal.h. A program for a board is
 *
 *     int main(void)
 *     {
 *         ...clocks, pins, CAN controllers...
 *         for (;;) firmware_live();
 *     }
 */
#ifndef FIRMWARE_H
#define FIRMWARE_H

#include "portable.h"

/* The node at its start, its components, too, on this clock (CLOCK_WALL, CLOCK_SIMULATED: ACTIVE with the
 * first slot). NULL, or why its components cannot start. */
const char *firmware_begin(int32_t clock);
/* A life on the wall clock from its beginning to its end, by the rules of docs/rehearsal.md: START and ARM come
 * over the bus. Returns LIVE_..., or a positive number: a component has failed (firmware_why). */
int32_t firmware_live(void);
/* CLOCK_SIMULATED: the next slot, with what has arrived by limit_ns. Returns 0, or not 0: a component has
 * failed. */
int32_t firmware_slot(int64_t limit_ns);
/* The component that has failed, and why; NULL: none has. */
const char *firmware_who(void), *firmware_why(void);
node_t *firmware_node(void);
/* So many lives were before: for a board whose memory and time begin anew, so that its boots differ. */
void firmware_lived(uint32_t before);

#endif
