/* frame.h: a frame, and the queue for frames inside a process.
 *
 * A frame is a CAN frame (id as in linux/can.h, up to 64 bytes) or a message of another network
 * (id: the message's number in the deployment, up to FRAME_DATA bytes). Time is CLOCK_MONOTONIC.
 * A ring has one writer and one reader, which may be different threads; it never blocks, never
 * allocates, and counts frames that did not fit. In a ring `sequence` is the number of the frame, from 0.
 */
#ifndef BRIDGE_FRAME_H
#define BRIDGE_FRAME_H

#include <stddef.h>
#include <stdint.h>

#include "target.h"

#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

enum flags {
    FRAME_FD = 1 << 0,
    FRAME_BRS = 1 << 1,
    FRAME_ESI = 1 << 2,
    FRAME_REMOTE = 1 << 3,
    FRAME_EXTENDED = 1 << 4,
    FRAME_ERROR = 1 << 5,
    FRAME_SENT = 1 << 6 /* in a log: sent by this node, not received */
};
/* The flags that tell two frames of one identifier apart. The bit rate of the data (BRS) and the
 * sender's error state (ESI) do not. */
enum { FRAME_FORMAT = FRAME_FD | FRAME_REMOTE | FRAME_EXTENDED | FRAME_ERROR };

typedef struct {
    int64_t t_ns; /* arrival, or hand-over to the network */
    uint32_t id;  /* without the flag bits of linux/can.h: those are in `flags` */
    uint8_t flags;
    uint8_t bus;       /* number of the bus in its node */
    uint16_t length;   /* bytes of data */
    uint32_t sequence; /* of this frame in its ring or log */
    uint32_t reserved;
    uint8_t data[FRAME_DATA];
} frame_t; /* 256 bytes; of firmware 88 */

/* Which frames: those with this identifier and these flags under the two masks. This is the only rule
 * by which frames are selected: for messages, for services, and in the filters of buses. */
typedef struct {
    uint32_t id, mask;
    uint32_t flags, flag_mask;
} accept_t;

static inline int32_t frame_accepted(const accept_t *a, const frame_t *frame)
{
    return !((frame->id ^ a->id) & a->mask) && !((frame->flags ^ a->flags) & a->flag_mask);
}

typedef struct {
    uint64_t head;    /* frames written; moved by the writer only */
    uint64_t dropped; /* did not fit; counted by the writer */
    int32_t bell;     /* a descriptor written to (8 bytes) after each frame; 0: none */
    int32_t reserved0;
    uint64_t pad0[5]; /* each end on its own cache line */
    uint64_t tail;    /* frames read; moved by the reader only */
    uint32_t asleep;  /* the reader: see mail.h */
    uint32_t reserved;
    uint64_t pad1[6];
    int64_t capacity; /* a power of two */
    frame_t *frames;
} ring_t;

API int32_t ring_put(ring_t *ring, const frame_t *frame); /* 1, or 0: full */
API int32_t ring_get(ring_t *ring, frame_t *frame);       /* 1, or 0: empty */

#endif
