/* message.h: numbers to bytes and back, from a table made of a DBC file; end-to-end protection.
 *
 * Fields are as in a DBC file: start bit, length, byte order, sign, scale, offset. An integer field
 * saturates, never wraps; rounds to nearest (halves to even); encodes what is not finite as its
 * `invalid` code if it has one, else as what is nearest to 0 (counted as saturated). A float field
 * saturates too; its invalid code is a NaN, sent only if has_invalid. Headers: E2E Profile 2 (8-bit
 * CRC, 4-bit counter, classic CAN), Profile 5 (16-bit CRC, 8-bit counter, CAN FD), and for byte
 * streams Profile 4 (32-bit CRC, 16-bit counter, length). Nothing here allocates, keeps a state
 * outside its arguments or reads a clock. Fields must lie inside the message: whoever makes a table
 * checks that (bridge/can/codec.py).
 */
#ifndef BRIDGE_MESSAGE_H
#define BRIDGE_MESSAGE_H

#include <stddef.h>

#include "frame.h"

enum { FIELD_UNSIGNED, FIELD_SIGNED, FIELD_FLOAT };     /* FLOAT: 32 or 64 bits, IEEE 754 */
enum { E2E_NONE = 0, E2E_P02 = 2, E2E_P04 = 4, E2E_P05 = 5 };
enum { MESSAGE_FIELDS = 256 };      /* the most values a message may have */

typedef struct {
    uint16_t start;         /* as in a DBC file: of the least (Intel), most (Motorola) significant bit */
    uint8_t length;         /* bits */
    uint8_t motorola;
    uint8_t kind;
    uint8_t has_invalid;
    uint16_t reserved;
    double scale, offset;   /* value = scale * raw + offset */
    int64_t low, high;      /* raw: saturation; the invalid code lies outside. FLOAT: the bits of the
                             * two limits as doubles */
    int64_t invalid;        /* raw; FLOAT: not used */
} field_t;                  /* raw is an int64_t: an unsigned field of 64 bits ends at 2^63 - 1 */

typedef struct {
    uint32_t id;
    uint16_t length;        /* bytes */
    uint8_t flags;          /* FRAME_FD | FRAME_BRS | FRAME_EXTENDED */
    uint8_t e2e;
    uint8_t data_ids[16];   /* little endian. P02: one a counter value; P05: 16 bits; P04: 32 bits */
    int32_t n_fields;       /* of values, in the order of the values */
    int32_t status, time;   /* numbers of header fields in `header`, or -1 */
    int32_t exact;          /* 1: a frame that message_encode would not have written is INVALID: commands
                             * of foreign protocols, whose other bits ask for something else */
    field_t *fields;
    field_t *header;        /* fields that are no values: status (8 bit), time (us); raw is the integer
                             * part of value / scale, its low bits: a status of 4 bits with scale 16
                             * carries bits 4 to 7 */
    uint8_t fill[64];       /* constant bytes under the fields: command codes of foreign protocols */
} message_t;

typedef struct {
    uint32_t counter;       /* as many bits as the profile has */
    uint32_t status;
    uint32_t t_us;          /* as many bits as the field has */
    uint32_t saturated;     /* encode: values that did not fit */
} header_t;

enum { DECODE_OK, DECODE_LENGTH, DECODE_CRC, DECODE_INVALID, DECODE_RANGE };

/* Fills id, flags, length and data of the frame; header->counter, status, t_us go in, truncated. */
API void message_encode(const message_t *m, const double *values, header_t *header, frame_t *frame);
/* Whether a frame is this message, by identifier and format (FRAME_FORMAT): a remote frame, a frame
 * with an identifier of the other size, and a CAN FD frame in place of a classic one (or the other
 * way round) are not. Length and protection are checked by message_decode. */
static inline int32_t message_is(const message_t *m, const frame_t *frame)
{
    const accept_t wanted = {m->id, UINT32_MAX, (uint32_t)(m->flags & FRAME_FORMAT), FRAME_FORMAT};
    return frame_accepted(&wanted, frame);
}

/* DECODE_OK and the values, or why not: then values are untouched. header is filled unless the
 * length or the CRC is wrong (a wrong data ID is a wrong CRC). INVALID: some value is the invalid
 * code or not finite, or the message is `exact` and other bits are set; RANGE: some raw value is outside low..high. */
API int32_t message_decode(const message_t *m, const frame_t *frame, double *values, header_t *header);

/* The protection alone, for bytes that are not made of fields: `data` has room for the header of the
 * profile (P02: 2, P05: 3, P04: 12 bytes) at its start. */
API void e2e_protect(int32_t profile, const uint8_t *data_ids, uint32_t counter, uint8_t *data,
                     int32_t length);
/* DECODE_OK and the counter, DECODE_LENGTH (too short; P04: another length inside) or DECODE_CRC. */
API int32_t e2e_check(int32_t profile, const uint8_t *data_ids, const uint8_t *data, int32_t length,
                      uint32_t *counter);

/* What became of the frames of one message, as its receiver saw it. period_ns > 0. */
typedef struct {
    int64_t ok, lost, repeated, reordered, wrong_sequence;      /* lost: by gaps of the counter */
    int64_t crc, length, invalid, range, simulated, stale;
    int64_t rate;           /* faster changes than there may be */
    int64_t resyncs;        /* the counter was believed anew */
    int64_t sequence;       /* of the last accepted sample, -1: none: the counter, unwrapped */
    int64_t arrival_ns;     /* of the last accepted */
    int64_t period_ns;      /* nominal, of the sender */
    int64_t offset_ns;      /* nominal time of sample j: j * period + offset */
    int32_t counter_bits;   /* 0: no counter */
    int32_t time_bits;      /* of the time stamp, us; 0: none */
    int64_t sampled_ns;     /* of the last accepted: by its stamp, else the nominal time of its number */
    int64_t lead_ns;        /* nominal time less arrival, of the fastest frame */
    int64_t older;          /* the number of the last frame that was repeated or older */
    uint64_t seen;          /* bit i: sequence - i was accepted */
    int64_t shift;          /* added to the counter, since it has begun anew */
    int64_t trial, trial_first, trial_ns;   /* number of the last of the frames that were refused and */
    int32_t tried;          /* follow each other; of the first, its arrival; how many */
    int32_t unturned;       /* frames in a row whose stamps agree with the counter only if shift is 0 */
} receiver_t;

/* How far ahead of its time a sample is believed, if its period is less; turns of a short time stamp
 * among which the counter decides. */
enum { RECEIVE_EARLY_NS = 2000000, RECEIVE_TURNS = 64 };
enum { RECEIVE_REPEATED = -1, RECEIVE_OLDER = -2, RECEIVE_WRONG = -3 };

/* The number of the sample in a frame that arrived at t_ns; M = 2^counter_bits.
 *
 * With a time stamp (the nominal time of the sample, modulo 2^time_bits us) stamp and counter give
 * it, however late the frame is; a stamp of 16 bits is searched for 64 of its turns, 4.2 s. Without
 * a stamp it is, of the numbers that fit the counter, the greatest that can have been sent by then:
 * right as long as no frame is later than 3/4 M periods. Without a counter the arrival counts.
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
 * What is refused is believed after all when 3 such frames follow each other, over two periods, with
 * none accepted between them (as the state machine of AUTOSAR E2E needs a window of valid samples):
 * `resyncs`. So a forged frame shuts nobody out, and a sender that counts anew is heard with its
 * third frame. What a stamp says is older than what was accepted is never believed. To start over, set
 * sequence = -1. */
API int64_t receiver_accept(receiver_t *r, const header_t *header, int64_t t_ns);

/* What a received value may be, in the unit of the value. */
typedef struct {
    double low, high;       /* +-infinity: not limited */
    double rate;            /* unit/s; infinity: not limited */
    int64_t falls;          /* 1: torque; it may go to 0 at any rate, as guards and ramps take it away */
} limit_t;

/* Whether all values are within their ranges; limits NULL: yes. */
API int32_t limits_range(const limit_t *limits, int32_t n, const double *values);
/* Whether none has changed faster than it may since `last`, so many seconds ago. */
API int32_t limits_rate(const limit_t *limits, int32_t n, const double *values, const double *last,
                        double seconds);

#endif
