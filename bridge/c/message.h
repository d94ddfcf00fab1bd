/* message.h: numbers to bytes and back, from a table made of a DBC file; end-to-end protection.
 *
 * Fields are as in a DBC file: start bit, length, byte order, sign, scale, offset. An integer field
 * saturates, never wraps; rounds to nearest (halves to even); encodes what is not finite as its
 * `invalid` code if it has one. Headers: E2E Profile 2 (8-bit CRC, 4-bit counter, classic CAN),
 * Profile 5 (16-bit CRC, 8-bit counter, CAN FD), and for byte streams of any length Profile 4
 * (32-bit CRC, 16-bit counter).
 */
#ifndef BRIDGE_MESSAGE_H
#define BRIDGE_MESSAGE_H

#include "frame.h"

enum { FIELD_UNSIGNED, FIELD_SIGNED, FIELD_FLOAT };     /* FLOAT: 32 or 64 bits, IEEE 754 */
enum { E2E_NONE = 0, E2E_P02 = 2, E2E_P04 = 4, E2E_P05 = 5 };

typedef struct {
    uint16_t start;         /* as in a DBC file: of the least (Intel), most (Motorola) significant bit */
    uint8_t length;         /* bits */
    uint8_t motorola;
    uint8_t kind;
    uint8_t has_invalid;
    uint16_t reserved;
    double scale, offset;   /* value = scale * raw + offset */
    int64_t low, high;      /* raw: saturation; the invalid code lies outside */
    int64_t invalid;        /* raw */
} field_t;

typedef struct {
    uint32_t id;
    uint16_t length;        /* bytes */
    uint8_t flags;          /* FRAME_FD | FRAME_BRS | FRAME_EXTENDED */
    uint8_t e2e;
    uint8_t data_ids[16];   /* P02: one a counter value; else the 16-bit data ID in the first two, little endian */
    int32_t n_fields;       /* of values, in the order of the values */
    int32_t status, time;   /* numbers of header fields in `header`, or -1 */
    field_t *fields;
    field_t *header;        /* fields that are no values: status (8 bit), time (us) */
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
/* DECODE_OK and the values, or why not: then values are untouched. header is filled unless the
 * length or the CRC is wrong. */
API int32_t message_decode(const message_t *m, const frame_t *frame, double *values, header_t *header);

/* What became of the frames of one message, as its receiver saw it. */
typedef struct {
    int64_t ok, lost, repeated, reordered, wrong_sequence;      /* lost: by gaps of the counter */
    int64_t crc, length, invalid, range, simulated, stale;
    int64_t sequence;       /* of the last accepted sample, -1: none: the counter, unwrapped */
    int64_t arrival_ns;     /* of the last accepted */
    int64_t period_ns;      /* nominal, of the sender */
    int32_t counter_bits, maximum_gap;  /* largest step of the counter that is accepted; else resync */
} receiver_t;

/* Unwraps the counter of a frame that arrived at t_ns: the nearest to what the time since the last
 * accepted one lets expect. Returns the sequence number and counts it ok/lost; -1: repeated, -2:
 * older than the last (the caller drops it unless its link wants reordered samples). `expected`:
 * the sequence number that was nominally sent at t_ns, used for the first and after a silence. */
API int64_t receiver_accept(receiver_t *r, const header_t *header, int64_t t_ns, int64_t expected);

#endif
