/* receiver.h: sequence number of a frame: its counter unwrapped, by its time stamp if it has one. */
#ifndef BRIDGE_RECEIVER_H
#define BRIDGE_RECEIVER_H

#include <stdint.h>

#include "message.h"

/* Results and counters of the receiver of one message. period_ns > 0. */
typedef struct {
    int64_t ok, lost, repeated, reordered, wrong_sequence; /* lost: by gaps of the counter */
    int64_t crc, length, invalid, range, simulated, stale;
    int64_t rate;         /* faster changes than there may be */
    int64_t resyncs;      /* the counter was resynchronized */
    int64_t sequence;     /* of the last accepted sample, -1: none: the counter, unwrapped */
    int64_t arrival_ns;   /* of the last accepted */
    int64_t period_ns;    /* nominal, of the sender */
    int64_t offset_ns;    /* nominal time of sample j: j * period + offset */
    int32_t counter_bits; /* 0: no counter */
    int32_t time_bits;    /* of the time stamp, us; 0: none */
    int64_t sampled_ns;   /* of the last accepted: by its stamp, else the nominal time of its number */
    int64_t lead_ns;      /* nominal time less arrival, of the fastest frame */
    int64_t older;        /* the number of the last frame that was repeated or older */
    uint64_t seen;        /* bit i: sequence - i was accepted */
    int64_t shift;        /* added to the counter, since it has begun anew */
    int64_t trial, trial_first, trial_ns; /* number of the last of the frames that were refused and */
    int32_t tried;                        /* follow each other; of the first, its arrival; how many */
    int32_t unturned; /* frames in a row whose stamps agree with the counter only if shift is 0 */
    int32_t ahead;    /* frames in a row that were numbered ahead of their arrival, without a counter */
} receiver_t;

/* Maximum time by which a sample is accepted early, if its period is less; number of wraps of a short time
 * stamp among which the counter decides. */
enum { RECEIVE_EARLY_NS = 2000000, RECEIVE_TURNS = 64 };
enum rejection { RECEIVE_REPEATED = -1, RECEIVE_OLDER = -2, RECEIVE_WRONG = -3 };

/* The number of the sample in a frame that arrived at t_ns; M = 2^counter_bits.
 *
 * With a time stamp (the nominal time of the sample, modulo 2^time_bits us) stamp and counter give
 * it, however late the frame is; a stamp of 16 bits is searched for 64 of its turns, 4.2 s. Without
 * a stamp it is, of the numbers that fit the counter, the greatest that can have been sent by then:
 * right as long as no frame is later than 3/4 M periods. Without a counter the arrival counts: a frame that is
 * later than a period makes the numbers one too great, for 65 frames at most.
 *
 * No number is accepted that its sender cannot have sent: its nominal time lies at most a period
 * (RECEIVE_EARLY_NS, if that is more) after t_ns + L, L being by how much the sender's clock is ahead:
 * 0 at first, then learned from the fastest frame, at most 488 ppm of the time passed.
 *
 * Returns the number, which is above the last one, and counts it ok, the numbers between lost; or
 * RECEIVE_REPEATED; RECEIVE_OLDER than the last (counted reordered; its number is `older`); or
 * RECEIVE_WRONG: ahead of its time, or (without a stamp) after so long a silence that a turn of the
 * counter may have gone by.
 *
 * Refused frames are accepted when 3 of them follow each other, over two periods, with no accepted frame
 * between them (as the state machine of AUTOSAR E2E needs a window of valid samples): `resyncs`. So a
 * forged frame cannot block the true sender, and a sender that restarts its counter is accepted with its
 * third frame. A sample with a stamp older than the accepted one is never accepted. To start over, set
 * sequence = -1. */
API int64_t receiver_accept(receiver_t *r, const header_t *header, int64_t t_ns);

#endif
