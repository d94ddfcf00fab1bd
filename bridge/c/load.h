/* load.h: how long a CAN frame takes on its bus, to the bit, and who sends when.
 *
 * Bit times as in bridge/can/timing.py: classic and FD (ISO 11898-1:2015), from start of frame to
 * the end of the intermission, stuff bits from the frame's own bits. FD frames of a length there is
 * none of count as filled with zeros to the next.
 *
 * An arbiter is one bus. Frames are put in when they are handed over; what arbiter_next gives are
 * frames that have arrived. Both at times that do not decrease, and a request is put before the
 * arbiter is asked for anything later: then the result does not depend on how often it is asked.
 */
#ifndef BRIDGE_LOAD_H
#define BRIDGE_LOAD_H

#include <stddef.h>
#include <stdint.h>

#include "frame.h"

enum { LOAD_INTERMISSION = 3 };     /* bits between frames, part of a frame's time */
enum { LOAD_NEVER = -1 };

typedef struct {
    int32_t nominal, data;          /* bit times at each bit rate; data: FD with BRS only */
} bits_t;

/* {0, 0}: no CAN frame (more than 8, FD 64 bytes; remote FD; error frame). */
API void frame_bits_exact(const frame_t *frame, bits_t *bits);
/* ns, to the nearest; rates in bit/s; data_bitrate 0: as the nominal. 0: no CAN frame. */
API int64_t frame_time_ns(const frame_t *frame, double bitrate, double data_bitrate);
/* The bits that arbitrate; the smallest wins. */
API uint32_t frame_rank(const frame_t *frame);

typedef struct {
    int64_t request_ns, duration_ns;
    uint32_t rank;
    uint32_t node;
    frame_t frame;
} request_t;                        /* 280 bytes */

typedef struct {
    double bitrate, data_bitrate;
    int32_t fifo;           /* 1: a node sends in the order of handing over; 0: most urgent first */
    int32_t sending;        /* waiting[0] is on the wire */
    int64_t capacity, n;    /* requests, the one on the wire included */
    request_t *waiting;     /* in the order of handing over, after the one on the wire */
    int64_t free_ns;        /* when the bus is free, the intermission over */
    int64_t sent, dropped;  /* frames begun; that did not fit, or are no CAN frames */
    int64_t busy_ns;        /* of all frames begun */
} arbiter_t;

/* Node `node` hands over a frame at request_ns: 1, or 0: dropped. */
API int32_t arbiter_put(arbiter_t *a, const frame_t *frame, uint32_t node, int64_t request_ns);
/* The next frame that has arrived by now_ns: 1, *frame with t_ns = end of its last bit before the
 * intermission, and *node who sent it (NULL: not wanted); or 0. */
API int32_t arbiter_next(arbiter_t *a, int64_t now_ns, frame_t *frame, uint32_t *node);
/* When the next frame arrives if nothing else is put in; LOAD_NEVER: none waits. */
API int64_t arbiter_due(const arbiter_t *a);

API size_t load_sizes(int32_t which);   /* 0 bits_t, 1 request_t, 2 arbiter_t, 3 frame_t */

#endif
