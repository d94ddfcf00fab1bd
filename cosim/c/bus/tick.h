/* tick.h: a bus that is stepped inside the ticks of a run, as gates of the engine (engine.h).
 *
 * A frame whose bits are signals is requested when its sender's sample is there; the requests of all
 * others are known before the run. The receiver's gate advances the bus to its tick and writes the
 * row of the link's table that the engine reads next. Memory is the caller's; nothing allocates.
 */
#ifndef CAN_BUS_TICK_H
#define CAN_BUS_TICK_H

#include "bus.h"

enum { ENCODING_NONE, ENCODING_FLOAT32, ENCODING_FLOAT64, ENCODING_INT16, ENCODING_INT32 };

/* A frame of a link. Without an encoding its requests are among those known before. */
typedef struct {
    bus_request_t *pending;       /* ring of requests that the bus does not have yet */
    const bus_request_t *request; /* node and frame, without data */
    const int64_t *places;        /* of its values, into signals, in their order in the frame */
    double scale;                 /* integers: the value of 1 */
    int64_t offset;               /* ps from the sample to the request */
    int64_t requested;            /* samples that the bus has been given */
    int32_t head, count, room;    /* of `pending` */
    int32_t n_places, encoding, reserved;
} tick_frame_t;

/* A link: `held` is the newest sample that has arrived, -1: none. */
typedef struct {
    int32_t *table; /* rows of the present chunk, written one after the other */
    int64_t row;
    int32_t frame, node, held, reserved;
} tick_receiver_t;

typedef struct {
    bus_t *bus;
    tick_frame_t *frames;
    tick_receiver_t *receivers;
    const bus_request_t *known;    /* by time */
    const int32_t *owners;         /* of `known`: a frame, or n_frames */
    int32_t *frame_of, *sample_of; /* of each request; `room` of them */
    bus_output_t output;
    int64_t step; /* ps of a tick */
    int64_t n_known, next_known, n_requests, room, room_events;
    int32_t n_frames, n_receivers;
} tick_bus_t;

typedef struct {
    tick_bus_t *bus;
    int32_t index, reserved; /* of a frame (sending), of a receiver (receiving) */
} tick_gate_t;

/* Gates of the engine: 0, or 1 where a request cannot be made. */
BUS_API int32_t bus_tick_send(void *gate, int64_t tick, const double *signals);
BUS_API int32_t bus_tick_receive(void *gate, int64_t tick, const double *signals);

#endif
