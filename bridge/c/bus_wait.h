/* bus_wait.h: a sleep that ends when something has come. */
#ifndef BRIDGE_BUS_WAIT_H
#define BRIDGE_BUS_WAIT_H

#include "bus.h"

/* Sleeps until one of n (at most 16) buses has something to receive, or the deadline
 * (CLOCK_MONOTONIC, ns). Rings are seen at once where they have a bell (frame.h), else, and where
 * there is no ppoll (not Linux), at one of many looks. */
void bus_wait(const bus_t *buses, int32_t n, int64_t deadline_ns);

#endif
