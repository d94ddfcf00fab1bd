/* message.h: encoding and decoding of messages, by a table made from a DBC file.
 *
 * Fields are as in a DBC file: start bit, length, byte order, sign, scale, offset. An integer field
 * saturates, never wraps; rounds to nearest (ties to even); encodes a value that is not finite as its
 * `invalid` code if it has one, else as the value nearest to 0 (counted as saturated). A float field
 * saturates too; its invalid code is a NaN, sent only if has_invalid. Headers: E2E Profile 2 (8-bit
 * CRC, 4-bit counter, classic CAN), Profile 5 (16-bit CRC, 8-bit counter, CAN FD), and for byte
 * streams Profile 4 (32-bit CRC, 16-bit counter, length). Nothing here allocates, keeps a state
 * outside its arguments or reads a clock. Fields must be inside the message, which
 * bridge/can/codec.py checks when it makes a table.
 */
#ifndef BRIDGE_MESSAGE_H
#define BRIDGE_MESSAGE_H

#include <stddef.h>

#include "e2e.h"
#include "frame.h"

enum field_kind { FIELD_UNSIGNED, FIELD_SIGNED, FIELD_FLOAT }; /* FLOAT: 32 or 64 bits, IEEE 754 */

typedef struct {
    uint16_t start; /* as in a DBC file: of the least (Intel), most (Motorola) significant bit */
    uint8_t length; /* bits */
    uint8_t motorola;
    uint8_t kind;
    uint8_t has_invalid;
    uint16_t reserved;
    double scale, offset; /* value = scale * raw + offset */
    int64_t low, high;    /* raw: saturation; the invalid code lies outside. FLOAT: the bits of the
                             * two limits as doubles */
    int64_t invalid;      /* raw; FLOAT: not used */
} field_t;                /* raw is an int64_t: an unsigned field of 64 bits ends at 2^63 - 1 */

typedef struct {
    uint32_t id;
    uint16_t length; /* bytes */
    uint8_t flags;   /* FRAME_FD | FRAME_BRS | FRAME_EXTENDED */
    uint8_t e2e;
    uint8_t data_ids[16]; /* little endian. P02: one a counter value; P05: 16 bits; P04: 32 bits */
    int32_t n_fields;     /* of values, in the order of the values */
    int32_t status, time; /* numbers of header fields in `header`, or -1 */
    int32_t exact;        /* 1: a frame that message_encode would not have written is INVALID: commands
                             * of foreign protocols, whose other bits ask for something else */
    field_t *fields;
    field_t *header;  /* fields that are no values: status (8 bit), time (us); raw is the integer
                             * part of value / scale, its low bits: a status of 4 bits with scale 16
                             * carries bits 4 to 7 */
    uint8_t fill[64]; /* constant bytes under the fields: command codes of foreign protocols */
} message_t;

typedef struct {
    uint32_t counter; /* as many bits as the profile has */
    uint32_t status;
    uint32_t t_us;      /* as many bits as the field has */
    uint32_t saturated; /* encode: values that did not fit */
} header_t;

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

#endif
