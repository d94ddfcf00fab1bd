/* bus.h: a CAN or CAN FD bus as a simulation: arbitration, exact frame times, errors.
 *
 * Time is an integer of picoseconds from the start of the simulation; no rounding accumulates. All
 * memory is given at creation (bus_size, bus_create); no function allocates. What happens does not
 * depend on how the simulated time is cut into calls of bus_advance.
 *
 * A transmission without a disturbance is computed as a whole ("clean path", clean.c). Everything
 * else is simulated bit by bit, with a state machine for each node ("bit path", wire.c, node.c,
 * parser.c), until all nodes are idle again. Both give the same events.
 */
#ifndef CAN_BUS_H
#define CAN_BUS_H

#include <stddef.h>
#include <stdint.h>

#include "length.h"

#if defined(_WIN32)
#define BUS_API __declspec(dllexport)
#else
#define BUS_API __attribute__((visibility("default")))
#endif

/* Transmit queues: order of requests; by arbitration, equals by age; as sorted, but a newer frame
 * replaces the pending one of the same identifier. */
enum { QUEUE_FIFO, QUEUE_SORTED, QUEUE_MAILBOXES };
enum { LEVEL_INVERTED, LEVEL_DOMINANT, LEVEL_RECESSIVE, LEVEL_DISCONNECTED };
/* Controller states by the counters: TEC and REC <= 95, <= 127, above; bus-off; and the 11
 * recessive bits that a node waits for after a reset. */
enum { STATE_ACTIVE, STATE_WARNING, STATE_PASSIVE, STATE_OFF, STATE_INTEGRATING };
enum {
    EVENT_STARTED,   /* the node sends a start of frame; time: its begin */
    EVENT_SENT,      /* at the end of EOF */
    EVENT_RECEIVED,  /* at the end of EOF; frame: see bus_event_t */
    EVENT_LOST,      /* arbitration lost; bit: where */
    EVENT_ERROR,     /* code: ERROR_; role: ROLE_ */
    EVENT_STATE,     /* code: STATE_ */
    EVENT_DROPPED,   /* a frame will not be sent (or not be kept); code: DROP_ */
    EVENT_RECOVERED, /* back on the bus after bus-off or a reset */
    EVENT_OVERLOAD,  /* the node begins an overload flag in the next bit */
    EVENT_FREE       /* node -1: after error or overload flags, all nodes are idle */
};
enum { ERROR_BIT = 1, ERROR_STUFF, ERROR_FORM, ERROR_CRC, ERROR_ACK };
/* PRIMARY: no other node sent an active error flag in that bit. SENDER: by the transmitter. */
enum { ROLE_PRIMARY = 1, ROLE_SENDER = 2 };
enum { DROP_OVERFLOW, DROP_REPLACED, DROP_ABORTED, DROP_ONE_SHOT, DROP_RESET, DROP_RECEIVE_OVERFLOW };

typedef struct {
    uint32_t id;
    uint8_t flags;  /* CAN_ */
    uint8_t length; /* data bytes; for a remote frame, the number requested */
    uint16_t reserved;
    uint8_t data[64];
} can_frame_t; /* 72 bytes */

typedef struct {
    int64_t at; /* ps; the frame is pending from here on */
    int32_t node;
    int32_t reserved;
    can_frame_t frame;
} bus_request_t;

typedef struct {
    int64_t time;    /* ps; the end of the bit in which it was seen, if not said */
    int64_t request; /* number of the request, -1: none */
    int32_t frame;   /* RECEIVED, SENT: row in the frames of this call; else -1 */
    int16_t bit;     /* bits since the start of frame (stuff bits count), -1: none */
    int16_t node;
    int16_t tec, rec; /* of the node, after the event */
    uint8_t kind, code, role, reserved;
} bus_event_t; /* 32 bytes */

typedef struct {
    uint32_t id, mask;
    uint32_t flags, flag_mask; /* of CAN_EXTENDED, CAN_REMOTE, CAN_FD */
} bus_filter_t;

typedef struct {
    int32_t queue, queue_length;     /* QUEUE_; frames */
    int32_t receive_length;          /* frames of the receive FIFO; 0: events only */
    int32_t first_filter, n_filters; /* in the filters of the bus; none: everything is accepted */
    int32_t one_shot, recovers;      /* recovers: without a reset by the host */
    int32_t inbox;                   /* requests that may lie in the future */
    int32_t tec, rec;                /* error counters at time 0; TEC above 255: bus-off since then */
    int32_t clock_ppb;               /* its clock is faster than nominal, parts per 10^9 */
    int32_t sample_point, sjw;       /* 1/1000 of its bit; sjw: most that one edge corrects */
} bus_node_settings_t;

/* Bits of the nth attempt of an identifier. */
typedef struct {
    uint32_t id, extended;
    int32_t attempt;     /* from 1; 0: each */
    int32_t bit, length; /* from the start of frame (0), stuff bits count */
    int32_t node, level; /* -1: the bus, for all; LEVEL_ */
    int32_t reserved;
} bus_script_t;

/* All bits that begin in [from, to). */
typedef struct {
    int64_t from, to;
    int32_t node, level;
} bus_interruption_t;

/* Inverted bits at random while the bus is busy: `length` in a row each time. */
typedef struct {
    double rate; /* probability for each bit */
    int32_t length, node;
} bus_rate_t;

typedef struct {
    int64_t bit, data_bit; /* ps */
    uint64_t seed;
    const bus_node_settings_t *nodes;
    const bus_filter_t *filters;
    const bus_script_t *scripts;
    const bus_interruption_t *interruptions; /* by begin */
    const bus_rate_t *rates;
    int32_t n_nodes, n_filters, n_scripts, n_interruptions, n_rates;
    uint32_t record; /* kinds of events that are written: 1 << EVENT_ */
} bus_settings_t;

typedef struct {
    bus_event_t *events;
    can_frame_t *frames;
    int64_t n_events, n_frames; /* room at the call; written at the return */
} bus_output_t;

typedef struct {
    int64_t time, request;
    can_frame_t frame;
} bus_received_t;

typedef struct {
    int32_t tec, rec, state, pending; /* STATE_; frames in the transmit queue */
} bus_node_state_t;

typedef struct bus bus_t;

/* Bytes of memory that a bus needs. */
BUS_API size_t bus_size(const bus_settings_t *settings);
/* Make a bus in `memory`, 16-byte aligned. The settings are copied. */
BUS_API bus_t *bus_create(void *memory, const bus_settings_t *settings);
/* Accepts requests and returns their number. It stops at the first request that cannot be accepted (inbox
 * full, or time earlier than now or than the node's last request). Numbers are given in order, from 0. */
BUS_API int64_t bus_request(bus_t *bus, const bus_request_t *requests, int64_t count);
/* 1: the request was pending and is dropped, or will not be repeated if it is being sent just now;
 * 0: there is none. */
BUS_API int32_t bus_abort(bus_t *bus, int32_t node, int64_t request);
/* Simulates to `until`, including events at `until`; a frame that could start at `until` does so in the
 * next call. Returns 1 if the buffer of events or frames was full before: call again. */
BUS_API int32_t bus_advance(bus_t *bus, int64_t until, bus_output_t *output);
/* No frame is received before this time, ps, if nothing more is requested: the end of the undisturbed
 * frame that is being sent, otherwise a lower bound after now; INT64_MAX: no frame waits. */
BUS_API int64_t bus_next(const bus_t *bus);
/* Restart a controller: drop what is pending, counters 0, wait for 11 recessive bits (after bus-off
 * 128 times 11). The drops are in the output of the next bus_advance. */
BUS_API void bus_reset(bus_t *bus, int32_t node);
BUS_API void bus_state(const bus_t *bus, int32_t node, bus_node_state_t *state);
/* Take the oldest frames from a receive FIFO; returns how many. */
BUS_API int64_t bus_receive(bus_t *bus, int32_t node, bus_received_t *frames, int64_t room);
/* How many transmissions were computed in closed form so far, not bit by bit. */
BUS_API int64_t bus_whole_frames(const bus_t *bus);
/* The length of a frame, for tests. */
BUS_API void bus_frame_bits(const can_frame_t *frame, bits_t *bits);

#endif
