/* traffic.h: what is on a bus, counted. */
#ifndef BRIDGE_TRAFFIC_H
#define BRIDGE_TRAFFIC_H

#include "frame.h"

/* What was on the bus, read by other threads at any time (each number for itself). Bits include
 * inter-frame space and the stuff bits that random data has on average, one in 30; those of a CAN
 * FD frame's data phase apart. The last second is the sum of the last ten slots of 100 ms that are
 * over: slot n % TRAFFIC_SLOTS, valid while number[] = n = t_ns / 100 ms. */
enum { TRAFFIC_SLOTS = 16, TRAFFIC_SLOT_NS = 100000000 };
typedef struct {
    int64_t frames, error_frames;
    double bits, data_bits;
    int64_t number[TRAFFIC_SLOTS];
    int64_t slot_frames[TRAFFIC_SLOTS];
    double slot_bits[TRAFFIC_SLOTS], slot_data_bits[TRAFFIC_SLOTS];
} traffic_t;

/* Adds a frame to what was on the bus. */
API void traffic_add(traffic_t *traffic, const frame_t *frame);

#endif
