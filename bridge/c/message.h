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
 * code or not finite; RANGE: some raw value is outside low..high. */
API int32_t message_decode(const message_t *m, const frame_t *frame, double *values, header_t *header);

/* The protection alone, for bytes that are not made of fields: `data` has room for the header of the
 * profile (P02: 2, P05: 3, P04: 12 bytes) at its start. */
API void e2e_protect(int32_t profile, const uint8_t *data_ids, uint32_t counter, uint8_t *data,
                     int32_t length);
/* DECODE_OK and the counter, DECODE_LENGTH (too short; P04: another length inside) or DECODE_CRC. */
API int32_t e2e_check(int32_t profile, const uint8_t *data_ids, const uint8_t *data, int32_t length,
                      uint32_t *counter);

/* What became of the frames of one message, as its receiver saw it. */
typedef struct {
    int64_t ok, lost, repeated, reordered, wrong_sequence;      /* lost: by gaps of the counter */
    int64_t crc, length, invalid, range, simulated, stale;
    int64_t sequence;       /* of the last accepted sample, -1: none: the counter, unwrapped */
    int64_t arrival_ns;     /* of the last accepted */
    int64_t period_ns;      /* nominal, of the sender */
    int32_t counter_bits, maximum_gap;  /* largest step of the counter that is accepted, 0: any; a
                                         * larger one: resync */
    int64_t origin_ns;      /* when sample 0 would have arrived on the fastest way seen */
    int64_t older;          /* the number of the last frame that was repeated or older */
} receiver_t;

enum { RECEIVE_REPEATED = -1, RECEIVE_OLDER = -2, RECEIVE_WRONG = -3 };

/* Unwraps the counter of a frame that arrived at t_ns, with the receiver's M = 2^counter_bits.
 *
 * A frame may be late, but hardly early. So of the sequence numbers that fit the counter it is the
 * one that lies in (p - 3/4 M, p + 1/4 M], where p is the number the time lets expect:
 * (t_ns - origin_ns) / period_ns, i.e. as fast as the fastest frame so far (forgotten by 244 ppm,
 * more than clocks differ by). For the first frame, and after a silence of more than maximum_gap
 * periods (M if that is 0), p = `expected`: the sequence number that was nominally sent at t_ns.
 * Right as long as no frame is later than 3/4 M periods and clocks agree within 1/4 M periods.
 *
 * Returns the sequence number, which is above the last one, and counts it ok, the numbers between
 * lost; RECEIVE_REPEATED; RECEIVE_OLDER than the last (counted reordered: the caller drops it unless
 * its link wants reordered samples; its number is `older`); or RECEIVE_WRONG: a step of more than
 * maximum_gap in less time than that (counted wrong_sequence, to be dropped). A sender that counts
 * anew is therefore accepted again after a silence of its own or maximum_gap periods of being wrong.
 * To start over, set sequence = -1. */
API int64_t receiver_accept(receiver_t *r, const header_t *header, int64_t t_ns, int64_t expected);

/* sizeof: field_t, message_t, header_t, receiver_t for which = 0..3; else 0. */
API size_t message_sizes(int32_t which);

#endif
