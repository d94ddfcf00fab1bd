/* rows.h: the recorded rows of a run, which a replay reads. */
#ifndef BRIDGE_ROWS_H
#define BRIDGE_ROWS_H

#include <stdint.h>

/* Bits of a row. */
enum {
    ROW_BURST = 1 /* a missed slot, done late */,
    ROW_FAILED = 2 /* a component failed in it */,
    ROW_DISABLED = 4,
    ROW_ENABLED = 8 /* the drives it commands were told to be disabled, are all ready */
};

/* Begins every row of the journal; then inlets, outlets, signals. */
typedef struct {
    int64_t slot, deadline_ns, woke_ns, received_ns, send_ns, done_ns; /* send: a duration */
    int32_t state;
    uint32_t commands; /* of this slot: received, then local; see life_cycle.h */
    uint32_t now, reasons;
    uint32_t guard, flags;
    double scale;
    uint64_t serving; /* bits of the drives it commands that were given torques */
} row_t;

typedef struct {
    int64_t held, newest, age_ns, transit_ns, requests;
} inlet_row_t;

/* Header of every row of the journal of received samples: a sample of the message with number `message`
 * among the receptions, with its receiver's number; the values follow, with space for the widest message. */
typedef struct {
    int64_t sequence, arrival_ns;
    int32_t message;
    uint32_t status;
} heard_t;

/* Of a sample in a replay: not known, or there. */
enum { SAMPLE_UNKNOWN, SAMPLE_THERE };

/* Decoded samples of one message, by sequence number: in a replay, the samples that a reception has
 * received and those that an outlet sends again. */
typedef struct {
    int64_t first, count, capacity;
    int32_t width, reserved;
    double *values; /* capacity rows */
    uint8_t *there; /* capacity, SAMPLE_... */
} history_t;

#endif
