/* length.c: see length.h */
#include "length.h"

typedef struct {
    uint32_t crc;   /* CRC-15 of what was sent, stuff bits apart */
    uint32_t state; /* 5 * last bit + how often it was sent in a row - 1 */
    int32_t count;  /* bits sent, stuff bits included */
} wire_t;

/* Four bits further: stuff bits << 4 | next state, from state and value (stuffing.py: table(4)). A
 * stuff bit counts with the bit after it. */
static const uint8_t STUFFED[10][16] = {
    {0x04, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x08},
    {0x10, 0x16, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x08},
    {0x11, 0x15, 0x10, 0x17, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x08},
    {0x12, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x18, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x08},
    {0x13, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x17, 0x12, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x19},
    {0x03, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x09},
    {0x03, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x11, 0x15},
    {0x03, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x12, 0x15, 0x10, 0x16},
    {0x03, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x13, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x17},
    {0x14, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x17, 0x12, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x18},
};
static const uint16_t CRC15[16] = {/* of four bits, polynomial 0x4599 */
                                   0x0000, 0x4599, 0x4EAB, 0x0B32, 0x58CF, 0x1D56, 0x1664, 0x53FD,
                                   0x7407, 0x319E, 0x3AAC, 0x7F35, 0x2CC8, 0x6951, 0x6263, 0x27FA};

static void send_bit(wire_t *w, uint32_t bit)
{
    uint32_t last = w->state / 5, run = w->state % 5 + 1;
    if (run == 5) {
        last = !last;
        run = 1;
        w->count++;
    }
    w->state = 5 * bit + (bit == last ? run : 0);
    w->crc = (w->crc << 1 & 0x7FFFu) ^ (0x4599u & (0u - (w->crc >> 14 ^ bit)));
    w->count++;
}

static void send_four(wire_t *w, uint32_t value)
{
    uint32_t entry = STUFFED[w->state][value];
    w->state = entry & 15u;
    w->count += 4 + (int32_t)(entry >> 4);
    w->crc = (w->crc << 4 & 0x7FFFu) ^ CRC15[(w->crc >> 11 ^ value) & 15u];
}

/* `width` lowest bits of a value, most significant first. */
static void send(wire_t *w, uint32_t value, int32_t width)
{
    for (; width & 3; width--) send_bit(w, value >> (width - 1) & 1u);
    for (; width; width -= 4) send_four(w, value >> (width - 4) & 15u);
}

int32_t can_padded(uint32_t flags, int32_t length)
{
    static const uint8_t lengths[] = {12, 16, 20, 24, 32, 48, 64};
    if (length < 0 || ((flags & CAN_FD) && (flags & CAN_REMOTE))) return -1;
    if (length <= 8) return length;
    if (!(flags & CAN_FD)) return -1;
    for (int32_t i = 0; i < (int32_t)sizeof lengths; i++)
        if (length <= lengths[i]) return lengths[i];
    return -1;
}

uint32_t can_code(int32_t length)
{
    if (length <= 8) return (uint32_t)length;
    return length <= 24 ? 6u + (uint32_t)length / 4 : 11u + (uint32_t)length / 16;
}

/* A classic frame from the start of frame to the end of the intermission. The recessive bit before it
 * and the CRC delimiter are sent, too: then all fields together are a multiple of four bits. The CRC
 * begins so that it is 0 behind that first bit; a stuff bit due behind the CRC comes before the
 * delimiter. */
static int32_t classic(uint32_t id, uint32_t flags, int32_t length, const uint8_t *data)
{
    wire_t w = {0x4000u, 0, -1};
    uint64_t remote = (flags & CAN_REMOTE) != 0, extended = (flags & CAN_EXTENDED) != 0;
    uint64_t last = remote << 6 | can_code(length), header;
    if (extended)
        header = 1ull << 39 | (uint64_t)(id >> 18 & 0x7FFu) << 27 | 3ull << 25 |
                 (uint64_t)(id & 0x3FFFFu) << 7 | last;
    else header = 1ull << 19 | (uint64_t)(id & 0x7FFu) << 7 | last;
    for (int32_t bits = extended ? 36 : 16; bits >= 0; bits -= 4)
        send_four(&w, (uint32_t)(header >> bits) & 15u);
    for (int32_t i = 0; !remote && i < length; i++) {
        send_four(&w, data[i] >> 4);
        send_four(&w, data[i] & 15u);
    }
    header = w.crc << 1 | 1u;
    for (int32_t bits = 12; bits >= 0; bits -= 4) send_four(&w, (uint32_t)(header >> bits) & 15u);
    return w.count + 12;
}

/* An FD frame from the start of frame to BRS. */
static void send_fd_header(wire_t *w, uint32_t id, uint32_t flags)
{
    if (flags & CAN_EXTENDED) {
        send(w, id >> 18 & 0x7FFu, 12); /* the start of frame is the zero before */
        send(w, 3, 2);
        send(w, id & 0x3FFFFu, 18);
        send(w, 0, 1);
    } else {
        send(w, id & 0x7FFu, 12);
        send(w, 0, 2);
    }
    send(w, 4u | ((flags & CAN_BRS) != 0), 3);
}

bits_t can_bits(uint32_t id, uint32_t flags, int32_t given, const uint8_t *data)
{
    int32_t length = can_padded(flags, given), early;
    wire_t w = {0, 5, 0};
    bits_t bits = {0, 0};
    if (length < 0) return bits;
    if (!(flags & CAN_FD)) {
        bits.nominal = classic(id, flags, length, data);
        return bits;
    }
    send_fd_header(&w, id, flags);
    early = w.count;
    send(&w, (flags & CAN_ESI) != 0, 1);
    send(&w, can_code(length), 4);
    for (int32_t i = 0; i < length; i++) {
        uint32_t byte = i < given ? data[i] : 0;
        send_four(&w, byte >> 4);
        send_four(&w, byte & 15u);
    }
    bits.data = w.count - early + (length <= 16 ? 27 : 32) + 1;
    bits.nominal = early + 12;
    if (!(flags & CAN_BRS)) {
        bits.nominal += bits.data;
        bits.data = 0;
    }
    return bits;
}
