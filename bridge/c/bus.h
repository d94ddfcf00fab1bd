/* bus.h: one attachment of a node to a network, as the tick sees it.
 *
 * BUS_SOCKET  a raw AF_CAN socket, read and written in the tick (non-blocking)
 * BUS_RING    rings that other threads fill and empty: python-can interfaces, Zenoh
 * BUS_MEMORY  rings between nodes of one process: the twin
 */
#ifndef BRIDGE_BUS_H
#define BRIDGE_BUS_H

#include "frame.h"
#include "journal.h"

enum { BUS_SOCKET = 1, BUS_RING = 2, BUS_MEMORY = 3 };
enum { BUS_ACTIVE, BUS_WARNING, BUS_PASSIVE, BUS_OFF, BUS_DOWN };

typedef struct {
    int32_t kind;
    int32_t fd;             /* BUS_SOCKET: the socket; BUS_RING: an eventfd the sender waits on, or -1 */
    ring_t *rx, *tx;        /* BUS_RING, BUS_MEMORY */
    journal_t *log;         /* every frame, both ways; or NULL */
    int64_t received, sent, send_failed;    /* frames; failed: ENOBUFS and the like */
    int64_t overruns;       /* frames the kernel or a ring dropped on the way in */
    int64_t error_frames;
    int32_t state;          /* BUS_ACTIVE ... from error frames and errors of the socket */
    int32_t last_errno;
    uint32_t number;        /* of the bus in its node */
    uint32_t reserved;
} bus_t;

/* The next frame that has arrived: 1 and *frame (t_ns: arrival; kernel time stamp on a socket,
 * put on CLOCK_MONOTONIC), or 0: none. Error frames are counted, change `state`, and are logged,
 * but not given. Never blocks. */
API int32_t bus_receive(bus_t *bus, frame_t *frame);

/* Hand over a frame: 0, or an errno. Sets frame->t_ns and logs it. Never blocks. */
API int32_t bus_send(bus_t *bus, frame_t *frame);

#endif
