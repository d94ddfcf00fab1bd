/* hal.h: the functions that a node on a microcontroller needs of its board. */
#ifndef BRIDGE_HAL_H
#define BRIDGE_HAL_H

#include "frame.h"

/* Monotonic, ns, from any origin. */
int64_t hal_time_ns(void);
/* Hand a frame to the controller of a bus: 0, or not 0: its queue is full. Must not block. */
int32_t hal_can_send(int32_t bus, const frame_t *frame);
/* The next frame that a bus has received: 1, with t_ns of its arrival by hal_time_ns; or 0: there is none.
 * Must not block. */
int32_t hal_can_receive(int32_t bus, frame_t *frame);
/* The limited torque of an outlet, N.m, in each slot and at each end of a run: of a node that has the drive at
 * its own pins. */
void hal_torque(int32_t outlet, const double *tau, int32_t n);
/* A line for people. */
void hal_log(const char *text);

/* Nothing is to be done until `until_ns`, or until a frame comes: the processor may sleep, at most so long.
 * If the board does not have this function, the node waits in a loop. */
void hal_idle(int64_t until_ns);

#endif
