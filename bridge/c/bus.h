/* bus.h: one attachment of a node to a network, as the tick sees it.
 *
 * BUS_SOCKET  a raw AF_CAN socket, read and written in the tick (non-blocking)
 * BUS_RING    rings that other threads fill and empty: python-can interfaces, Zenoh
 * BUS_MEMORY  rings between nodes of one process: the twin
 *
 * Clocks: a BUS_SOCKET compares CLOCK_REALTIME and CLOCK_MONOTONIC when it begins to drain its queue
 * and the frame that came is stamped a second or more after the last comparison, or before it: the
 * kernel's stamps are wall time. (If the wall clock is set, arrivals are off by that much for up to a
 * second.) Sending on it and on a BUS_RING reads pace_now() where frame->t_ns is 0. A BUS_MEMORY
 * reads none: frame->t_ns is the caller's.
 */
#ifndef BRIDGE_BUS_H
#define BRIDGE_BUS_H

#include "frame.h"
#include "journal.h"
#include "traffic.h"

enum bus_kind { BUS_SOCKET = 1, BUS_RING = 2, BUS_MEMORY = 3 };
enum bus_state { BUS_ACTIVE, BUS_WARNING, BUS_PASSIVE, BUS_OFF, BUS_DOWN };

typedef struct {
    int32_t kind;
    int32_t fd;      /* BUS_SOCKET: the socket; BUS_RING: an eventfd the sender waits on, or -1 */
    ring_t *rx, *tx; /* BUS_RING, BUS_MEMORY */
    journal_t *log;  /* every frame, both ways; or NULL */
    int64_t received, sent, send_failed; /* frames; failed: ENOBUFS and the like */
    int64_t overruns;                    /* frames the kernel or a ring dropped on the way in */
    int64_t error_frames;
    int32_t state; /* BUS_ACTIVE ... from error frames and errors of the socket */
    int32_t last_errno;
    uint32_t number;              /* of the bus in its node */
    uint32_t overflow;            /* BUS_SOCKET: SO_RXQ_OVFL as last seen */
    int64_t restarts;             /* after bus-off, and after the interface was down */
    int32_t tx_errors, rx_errors; /* error counters of the controller, from error frames that have them */
    const accept_t *accepts;      /* which frames are given; NULL: all. All are logged and counted */
    int64_t n_accepts;
    int64_t foreign;        /* frames that were received, but are not accepted */
    traffic_t *traffic;     /* every frame, both ways; or NULL */
    int64_t offset_ns;      /* CLOCK_MONOTONIC - CLOCK_REALTIME when this drain began */
    int64_t empty_ns;       /* what comes now had not arrived then: the drain before this one began */
    int64_t clock_steps;    /* times the wall clock was set (by 1 ms or more) */
    int32_t draining;       /* a frame has come since the queue was last empty */
    int32_t stepped;        /* in this drain, or the one before */
    int64_t wall_ns;        /* when the two clocks were compared last, by the wall clock; 0: never well */
    int64_t began_ns;       /* when this drain did; CLOCK_MONOTONIC */
    int32_t batched, given; /* BUS_SOCKET: frames that one call to the kernel gave, and passed on of them */
    int32_t emptied;        /* they were all there was */
    int32_t reserved;
    frame_t batch[BUS_BATCH];
} bus_t;

/* The next frame that has arrived: 1 and *frame (t_ns: arrival; kernel time stamp on a socket,
 * put on CLOCK_MONOTONIC), or 0: none. Error frames are counted, change `state`, and are logged,
 * but not given. Never blocks. If the wall clock was set since a frame arrived, its t_ns is bounded
 * by when the drain before began and by now. */
API int32_t bus_receive(bus_t *bus, frame_t *frame);

/* Who stops before there is none says so: behind what was taken by then, more may have come. */
static inline void bus_leave(bus_t *bus) { bus->emptied = 0; }

/* Hand over a frame: 0, or an errno (EINVAL: a length no CAN frame has; ENETDOWN; ENOBUFS: queue
 * full, also that of a ring; ...). Sets frame->t_ns where it is 0 (not on a BUS_MEMORY), and logs what was handed
 * over. A bus with error frames of its own may send them (FRAME_ERROR). Never blocks. */
API int32_t bus_send(bus_t *bus, frame_t *frame);
/* The same in two steps: several frames can be handed over before the thread that empties `tx` is woken. */
API int32_t bus_queue(bus_t *bus, frame_t *frame);
API void bus_wake(const bus_t *bus);

#endif
