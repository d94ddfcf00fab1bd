/* faults.h: fault injection into received frames, before any check.
 *
 * A rule acts from t0 to t1 (ns since the start, t1 not included) on the frames that it accepts, by
 * their time of arrival. Rules are applied in order, each to the result of the previous one. Every rule
 * has its own seeded generator (SplitMix64), from which it draws once per matching frame, independently
 * of other rules; all other random values for that frame (duration, bits) are derived from that number.
 * Before the start no frame is changed.
 *
 * FORGE, REPLAY, ABSURD and FLOOD model a hostile peer that knows the format, the CRC and the data ID of
 * a message: they need `message`. Frames that they add arrive before the original frame.
 *
 * Every changed frame is a row of `journal`, with its original content: the ground truth for the
 * evaluation of a receiver's checks.
 */
#ifndef BRIDGE_FAULTS_H
#define BRIDGE_FAULTS_H

#include <stddef.h>

#include "frame.h"
#include "journal.h"
#include "message.h"

enum {
    FAULT_DROP,
    FAULT_BURST /* drop `count` in a row */,
    FAULT_DELAY /* by `a` to `b` s; the order is kept if possible */,
    FAULT_JITTER /* by `a` to `b` s, may overtake */,
    FAULT_DUPLICATE /* `count` more, each `a` to `b` s after the first */,
    FAULT_REORDER /* after the next that fits; after `b` s if none comes */,
    FAULT_CORRUPT /* flip `count` different bits of the data */,
    FAULT_FORGE /* one more: a..b added to every value, the counter `count` steps ahead */,
    FAULT_REPLAY /* one more: of the last `count` frames before t0, one after the other */,
    FAULT_ABSURD /* every value becomes a..b, in turn positive and negative */,
    FAULT_FLOOD /* valid frames, `a` s apart, with continuing counters, until the next frame */
};
/* The most frames a flood adds to one. */
enum { FAULT_MOST = 512 };

typedef struct {
    int32_t kind, count;
    int64_t t0_ns, t1_ns;
    accept_t accept;       /* which frames, by identifier and format */
    int32_t bus, reserved; /* -1: every bus */
    double probability, a, b;
    uint64_t random;          /* state of the generator */
    int64_t left;             /* of a burst */
    int64_t last_ns;          /* DELAY: when the last one gets through; FLOOD: when the last one came */
    int64_t asked;            /* frames that fit */
    int64_t hits;             /* frames it did something to */
    const message_t *message; /* of hostile peers: what they send; else NULL */
    double *values;           /* room for the message's values */
    frame_t *store;           /* REPLAY: `count` frames, a circle; else NULL */
    int64_t stored, taken;    /* frames recorded, and sent again */
} fault_t;

typedef struct {
    int64_t t_ns;          /* arrival, since the start */
    int64_t through_ns;    /* when it gets through; REORDER: at the latest; dropped: -1 */
    uint32_t id, sequence; /* of the frame; in its ring or log */
    uint32_t crc;          /* CRC-32 of the data as it was */
    uint32_t crc_after;    /* as it went on; dropped: 0 */
    int32_t rule;          /* the first that did something */
    uint32_t kinds;        /* bits 1 << FAULT_... of all that did */
    uint16_t length;
    uint8_t flags, bus;
    int32_t copies;   /* that went on, with those a hostile peer added; 0: dropped */
    uint8_t data[64]; /* as it was, the first 64 bytes */
} injected_t;

typedef struct {
    fault_t *rules;
    int64_t n_rules;
    frame_t *waiting;                   /* a circle of `capacity`, sorted by t_ns (when they get through) */
    int64_t first, n_waiting, capacity; /* capacity: a power of two */
    journal_t *journal;                 /* of injected_t; or NULL */
    int64_t frames;                     /* put in */
    int64_t injected;                   /* changed in any way */
    int64_t dropped, corrupted;
    int64_t overflow; /* lost because too many frames were delayed (unintended) */
} faults_t;

/* Takes a frame in; what comes out (none, one, more) waits inside. t_ns is the arrival; `started`:
 * the run has a start, start_ns. */
API void faults_put(faults_t *f, const frame_t *frame, int64_t start_ns, int32_t started);
/* The next that gets through by now: 1 and *frame with its new t_ns, or 0. */
API int32_t faults_get(faults_t *f, frame_t *frame, int64_t now_ns);

#endif
