/* internal.h: the state of a simulated bus; the files of this folder share it. */
#ifndef CAN_BUS_INTERNAL_H
#define CAN_BUS_INTERNAL_H

#include <string.h>

#include "bus.h"

#define NEVER INT64_MAX
enum { WIRE_BITS = 800, NO_SLOT = -1 };

/* A bit that a transmitter sends: its value, and what it is. */
enum { WIRE_VALUE = 1, WIRE_STUFF = 2, WIRE_ARBITRATION = 4, WIRE_DATA_RATE = 8, WIRE_ACK = 16 };

/* What a node does with the bus. */
enum {
    PHASE_IDLE,
    PHASE_FRAME,
    PHASE_ACTIVE_FLAG,
    PHASE_PASSIVE_FLAG,
    PHASE_OVERLOAD_FLAG,
    PHASE_WAIT,
    PHASE_DELIMITER,
    PHASE_INTERMISSION,
    PHASE_OFF
};

enum {
    FIELD_BASE,
    FIELD_RTR,
    FIELD_IDE,
    FIELD_EXTENSION,
    FIELD_EXTENDED_RTR,
    FIELD_FDF,
    FIELD_R0,
    FIELD_RES,
    FIELD_BRS,
    FIELD_ESI,
    FIELD_DLC,
    FIELD_DATA,
    FIELD_CRC,
    FIELD_FD_CRC,
    FIELD_DELIMITER,
    FIELD_ACK,
    FIELD_ACK_DELIMITER,
    FIELD_EOF
};
/* What parser_feed returns besides 0 and ERROR_: the frame ended, and with a dominant last bit. */
enum { PARSED_FRAME = 100, PARSED_OVERLOAD };

typedef struct {
    int32_t field, left; /* left: bits of the field still to come */
    int32_t last, run;   /* the last bit in the stuffed area, how often in a row */
    int32_t stuffed;     /* dynamic stuff bits so far */
    int32_t crc_ok, dlc, got;
    uint32_t crc15, crc17, crc21, value;
    can_frame_t frame;
} parser_t;

typedef struct {
    can_frame_t frame;
    int64_t at, request;
    uint32_t rank;
    bits_t bits;
    int32_t aborted;
} slot_t;

typedef struct {
    bus_node_settings_t set;
    slot_t *slots;           /* queue_length */
    uint16_t *order, *spare; /* pending slots, first to send first; and free ones */
    uint16_t *order_room;    /* `order` begins in it: 2 * queue_length */
    int32_t pending;
    slot_t *inbox; /* a ring of future requests; only frame, at, request, aborted */
    int32_t inbox_head, inbox_count;
    int64_t inbox_last;
    bus_received_t *fifo; /* a ring */
    int32_t fifo_head, fifo_count;
    int32_t tec, rec, state;
    int32_t phase, sender;    /* sender: transmitter of this frame or of the last */
    int32_t slot;             /* being sent, or NO_SLOT */
    int32_t count, last;      /* bits of the phase so far; the last bit of a passive flag */
    int32_t after_error;      /* the flag was an error flag, not an overload flag */
    int32_t ack_pending;      /* passive transmitter, ACK error: TEC counts with a dominant bit */
    int32_t needed, run;      /* while off: sequences of 11 recessive bits; this one so far */
    int32_t reset;            /* asked for */
    int64_t quiet_from;       /* while off, on the clean path: where the sequence began */
    int64_t earliest;         /* may not start before (suspend transmission) */
    int64_t bit, data_bit;    /* ps, of its own clock */
    int64_t late;             /* how much later than nominal it samples, ps */
    int32_t seen;             /* the level before, for edges */
    int32_t flagging;         /* sends an active error flag in this bit */
    int32_t position, n_wire; /* of the bits below */
    uint8_t wire[WIRE_BITS];
    parser_t parser;
} node_t;

typedef struct {
    bus_script_t set;
    int32_t count, active; /* attempts so far; in this one */
} script_t;

typedef struct {
    bus_rate_t set;
    uint64_t random, chance[48]; /* chance of each binary digit of a distance, times 2^64 */
    int64_t distance;            /* undisturbed bits to come */
    int32_t left, hit;           /* bits of the burst to come; disturbs this bit */
} rate_t;

typedef struct {
    int64_t time;
    int32_t node, bit;
} lost_t;

/* The least of the numbers of all nodes (NEVER: none), in a tree: row k is the lesser of rows 2k and 2k + 1,
 * the number of node i is in row `leaves` + i. */
typedef struct {
    int64_t *rows; /* 2 * leaves */
    int32_t leaves;
} least_t;

struct bus {
    bus_settings_t set;
    node_t *nodes;
    bus_filter_t *filters;
    script_t *scripts;
    bus_interruption_t *interruptions;
    rate_t *rates;
    int64_t *ready;     /* per node: when its first frame could start */
    least_t next_at;    /* of each node: the first of its inbox */
    least_t waiting;    /* when the first frame could start, of nodes that are not among `contending` */
    least_t contending; /* rank and number of the nodes whose first frame could start when the bus is free */
    lost_t *lost;       /* of the transmission in flight, by time */
    int32_t n_lost, lost_done;
    int32_t follow;              /* every loss of arbitration has to be followed */
    int32_t followed;            /* in the transmission in flight, they are */
    int32_t n, off, counting;    /* nodes; of them off; with REC > 0 and on the bus */
    int32_t over;                /* so many interruptions, the first ones, are over */
    int32_t deaf;                /* no events of received frames are recorded for it */
    int32_t drifting;            /* not all clocks are equal */
    int64_t bit_ps, data_bit_ps; /* of the node that began the last transmission */
    int32_t asked;               /* an abort or a reset waits for the next advance */
    int64_t now, free, next_request, numbers;
    /* clean path: the transmission in flight */
    int32_t in_flight, winner;
    int64_t sof, end, next;
    bits_t bits;
    /* bit path */
    int32_t bitwise, sampling, level, known_attempt, flags, joined, fast;
    int32_t troubled;         /* an error or overload flag since all nodes were idle */
    int32_t bit;              /* since the last start of frame */
    int64_t t, t_end, on_air; /* this bit; the request that is being sent */
    int64_t muted_until;      /* events before were written already */
    /* output */
    bus_output_t *out;
    int64_t n_events, n_frames, stamp, frame_stamp;
    int32_t full;
    int64_t whole_frames; /* transmissions in closed form so far */
};

/* frame_bits.c: all bits from SOF to EOF as WIRE_; returns how many. */
int32_t wire_bits(const can_frame_t *frame, uint8_t *bits);

/* parser.c */
void parser_begin(parser_t *p);
int32_t parser_feed(parser_t *p, int32_t bit);

/* report.c */
int32_t has_room(bus_t *b);
void event(bus_t *b, int32_t node, int32_t kind, int32_t code, int64_t request, int32_t frame, int32_t role);
void event_at_bit(bus_t *b, int32_t node, int32_t kind, int32_t code, int64_t request, int32_t role,
                  int32_t bit);
int32_t keep_frame(bus_t *b, const can_frame_t *frame);
void deliver(bus_t *b, int32_t node, const can_frame_t *frame, int64_t request);

/* least.c */
int32_t least_leaves(int32_t nodes); /* a power of two */
void least_set(least_t *l, int32_t node, int64_t number);
int64_t least_of(const least_t *l);
int32_t least_node(const least_t *l); /* the first that has the least */
/* The least of the other nodes; *before: it is that of a node before this one. */
int64_t least_other(const least_t *l, int32_t node, int32_t *before);

/* queue.c */
uint32_t frame_rank(const can_frame_t *frame);
void refresh(bus_t *b, int32_t node);
/* Its first frame can start when the bus is free. */
void contend(bus_t *b, int32_t node);
void drop(bus_t *b, int32_t node, int32_t slot, int32_t cause);
void release(bus_t *b, int32_t node, int32_t slot);
/* Requests up to and with `until` go from the inboxes to the queues; 0: the output has no room for a step. */
int32_t drain(bus_t *b, int64_t until);
void next_inbox(bus_t *b, int32_t node);
/* The slot of the first frame in a node's queue that was requested up to `t`, or NO_SLOT. */
int32_t requested(const node_t *node, int64_t t);

/* line.c */
void line_create(bus_t *b);
int32_t line_attempt(bus_t *b, const can_frame_t *frame); /* 1: a script is active */
int32_t line_calm(bus_t *b, int64_t from, int64_t to, int32_t bits);
void line_pass(bus_t *b, int32_t bits);
int32_t line_busy(const bus_t *b);
int64_t line_glitch(const bus_t *b);
int32_t line_connected(const bus_t *b, int32_t node);
void line_draw(bus_t *b);
int32_t line_bus(const bus_t *b, int32_t level);
int32_t line_node(const bus_t *b, int32_t node, int32_t level);

/* confine.c */
int32_t node_passive(const node_t *node);
void node_confine(bus_t *b, int32_t node);
void node_sent(bus_t *b, int32_t node, int32_t slot);
void node_failed(bus_t *b, int32_t node);
void count_received(bus_t *b, node_t *node, int32_t rec);
void recover(bus_t *b, int32_t node);
can_frame_t node_frame(const node_t *node, int32_t slot); /* as sent: with its ESI */

/* node.c */
void node_begin(bus_t *b, int32_t node, int32_t after_start);
int32_t node_drive(bus_t *b, int32_t node);
void node_sample(bus_t *b, int32_t node, int32_t bit);

/* clock.c: nodes whose clocks differ */
void clock_create(bus_t *b);
void clock_lead(bus_t *b, int32_t node); /* the node's clock times the bus from here on */
int32_t clock_in_step(const bus_t *b, int32_t sender, const can_frame_t *frame);
void clock_align(node_t *node);
int32_t clock_samples(bus_t *b, int32_t node, int32_t level); /* how many in this bit: 0 to 2 */

/* clean.c, wire.c: go on a little; 0: nothing more to do until `until` (or the output is full). */
int32_t clean_step(bus_t *b, int64_t until);
/* When the first of the queued frames can start; NEVER: none is queued. */
int64_t next_start(const bus_t *b);
/* From now on the losses of the transmission in flight are followed, even where `follow` is 0. */
void follow_losers(bus_t *b);
/* Make the transmission in flight one that is simulated bit by bit, up to now. */
void unfold(bus_t *b);
void wire_enter(bus_t *b, int64_t t);
int32_t wire_step(bus_t *b, int64_t until);

#endif
