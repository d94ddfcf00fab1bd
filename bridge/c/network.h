/* network.h: the networks between the nodes of a twin.
 *
 * A CAN bus is simulated by cosim/c/bus/bus.h, with arbitration and exact times: a frame that is sent
 * waits in the transmit queue of its node, and arrives at the others at the end of its last bit. A
 * network without a bus delivers a frame at the time at which it is sent. Times are in ns since t = 0.
 */
#ifndef BRIDGE_NETWORK_H
#define BRIDGE_NETWORK_H

#include "frame.h"

/* The functions are bus_request, bus_advance and bus_next of cosim/c/bus/bus.h, which is in another
 * library. */
typedef struct {
    void *bus; /* bus_t of cosim/c/bus/bus.h; NULL: frames arrive when they are sent */
    int64_t (*request)(void *bus, const void *requests, int64_t count);
    int32_t (*advance)(void *bus, int64_t until, void *output);
    int64_t (*next)(const void *bus);
    void *output; /* bus_output_t with room for so many events and frames: */
    int64_t room;
    ring_t **rx;       /* of each node of this network: what has arrived */
    int64_t **refused; /* of each: counts its frames that the transmit queue had no room for */
    int64_t now_ps;    /* how far the bus was advanced */
    int32_t n_nodes, reserved;
} network_t;

/* A node sends a frame at frame->t_ns, or now if that is past. */
void network_send(network_t *network, int32_t node, const frame_t *frame);
/* Deliver all frames that have arrived until then, t_ns: at the end of their last bit. */
void network_advance(network_t *network, int64_t until_ns);
/* No frame arrives before this time, if nothing more is sent; after the last advance. INT64_MAX: none. */
int64_t network_next(const network_t *network);

#endif
