/* bus_wait.h: sleep until a frame has arrived. */
#ifndef BRIDGE_BUS_WAIT_H
#define BRIDGE_BUS_WAIT_H

#include "bus.h"

/* Sleeps until one of n (at most 16) buses has something to receive, or until the deadline
 * (CLOCK_MONOTONIC, ns). Rings with a bell (frame.h) wake the sleeper at once. Other rings, and all
 * buses on systems without ppoll (not Linux), are polled. */
void bus_wait(const bus_t *buses, int32_t n, int64_t deadline_ns);

#endif
