/* traffic.h: counters of the traffic on a bus. */
#ifndef BRIDGE_TRAFFIC_H
#define BRIDGE_TRAFFIC_H

#include "frame.h"

/* Counters of the bus, read by other threads at any time (each number separately). Bits include the
 * inter-frame space and the average stuff bits of random data, one in 30; bits of a CAN FD frame's data
 * phase are counted separately. The last second is the sum of the last ten complete slots of 100 ms:
 * slot n % TRAFFIC_SLOTS, valid while number[] = n = t_ns / 100 ms. */
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
