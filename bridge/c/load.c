/* load.c: see load.h */
#include "load.h"

#include <string.h>

typedef struct {
    uint32_t crc;           /* CRC-15 of what was sent, stuff bits apart */
    uint32_t state;         /* 5 * last bit + how often it was sent in a row - 1 */
    int32_t count;          /* bits sent, stuff bits included */
} wire_t;

/* Four bits further: stuff bits << 4 | next state, from state and value (stuffing.py: table(4)). A
 * stuff bit counts with the bit after it. */
static const uint8_t STUFFED[10][16] = {
    { 0x04, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x08 },
    { 0x10, 0x16, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x08 },
    { 0x11, 0x15, 0x10, 0x17, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x08 },
    { 0x12, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x18, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x08 },
    { 0x13, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x17, 0x12, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x19 },
    { 0x03, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x09 },
    { 0x03, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x01, 0x05, 0x11, 0x15 },
    { 0x03, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x02, 0x05, 0x00, 0x06, 0x12, 0x15, 0x10, 0x16 },
    { 0x03, 0x05, 0x00, 0x06, 0x01, 0x05, 0x00, 0x07, 0x13, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x17 },
    { 0x14, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x17, 0x12, 0x15, 0x10, 0x16, 0x11, 0x15, 0x10, 0x18 },
};
static const uint16_t CRC15[16] = {     /* of four bits, polynomial 0x4599 */
    0x0000, 0x4599, 0x4EAB, 0x0B32, 0x58CF, 0x1D56, 0x1664, 0x53FD,
    0x7407, 0x319E, 0x3AAC, 0x7F35, 0x2CC8, 0x6951, 0x6263, 0x27FA
};

/* `width` lowest bits of a value, most significant first. */
static void wire_send(wire_t *w, uint32_t value, int32_t width)
{
    for (int32_t i = width - 1; i >= 0; i--) {
        uint32_t bit = value >> i & 1u, last = w->state / 5, run = w->state % 5 + 1;
        if (run == 5) {
            last = !last;
            run = 1;
            w->count++;
        }
        w->state = 5 * bit + (bit == last ? run : 0);
        w->crc = (w->crc << 1 & 0x7FFFu) ^ (0x4599u & (0u - (w->crc >> 14 ^ bit)));
    }
    w->count += width;
}

/* Bytes; the CRC is kept up for classic frames only: that of an FD frame has a fixed length. */
static void wire_data(wire_t *w, const uint8_t *data, int32_t bytes, int32_t classic)
{
    for (int32_t i = 0; i < 2 * bytes; i++) {
        uint32_t value = data[i / 2] >> (i & 1 ? 0 : 4) & 15u;
        uint32_t entry = STUFFED[w->state][value];
        w->state = entry & 15u;
        w->count += 4 + (int32_t)(entry >> 4);
        if (classic)
            w->crc = (w->crc << 4 & 0x7FFFu) ^ CRC15[(w->crc >> 11 ^ value) & 15u];
    }
}

/* The length on the bus, -1: no CAN frame. */
static int32_t padded(const frame_t *f)
{
    static const uint8_t lengths[] = { 12, 16, 20, 24, 32, 48, 64 };
    if ((f->flags & FRAME_ERROR) || ((f->flags & FRAME_FD) && (f->flags & FRAME_REMOTE)))
        return -1;
    if (f->length <= 8)
        return f->length;
    if (!(f->flags & FRAME_FD))
        return -1;
    for (size_t i = 0; i < sizeof lengths; i++)
        if (f->length <= lengths[i])
            return lengths[i];
    return -1;
}

static uint32_t code(int32_t length)
{
    if (length <= 8)
        return (uint32_t)length;
    return length <= 24 ? 6u + (uint32_t)length / 4 : 11u + (uint32_t)length / 16;
}

/* Start of frame to the bit before the DLC; of FD frames to BRS. */
static void send_header(wire_t *w, const frame_t *f)
{
    uint32_t remote = (f->flags & FRAME_REMOTE) != 0;
    wire_send(w, 0, 1);
    if (f->flags & FRAME_EXTENDED) {
        wire_send(w, f->id >> 18 & 0x7FFu, 11);
        wire_send(w, 3, 2);
        wire_send(w, f->id & 0x3FFFFu, 18);
        wire_send(w, remote, 1);
    } else {
        wire_send(w, f->id & 0x7FFu, 11);
        wire_send(w, remote << 1, 2);
    }
    if (f->flags & FRAME_FD)
        wire_send(w, 4u | ((f->flags & FRAME_BRS) != 0), 3);
    else
        wire_send(w, 0, f->flags & FRAME_EXTENDED ? 2 : 1);
}

void frame_bits_exact(const frame_t *f, bits_t *bits)
{
    int32_t length = padded(f), fd = f->flags & FRAME_FD, early;
    wire_t w = { 0, 5, 0 };
    static const uint8_t zeros[64];
    bits->nominal = bits->data = 0;
    if (length < 0)
        return;
    send_header(&w, f);
    early = w.count;
    if (fd)
        wire_send(&w, (f->flags & FRAME_ESI) != 0, 1);
    wire_send(&w, code(length), 4);
    if (!(f->flags & FRAME_REMOTE)) {
        wire_data(&w, f->data, f->length, !fd);
        wire_data(&w, zeros, length - f->length, !fd);
    }
    if (!fd) {
        wire_send(&w, w.crc, 15);
        bits->nominal = w.count + (w.state % 5 == 4) + 13;
        return;
    }
    bits->data = w.count - early + (length <= 16 ? 27 : 32) + 1;
    bits->nominal = early + 12;
    if (!(f->flags & FRAME_BRS)) {
        bits->nominal += bits->data;
        bits->data = 0;
    }
}

int64_t frame_time_ns(const frame_t *frame, double bitrate, double data_bitrate)
{
    bits_t bits;
    double rate = data_bitrate > 0.0 ? data_bitrate : bitrate;
    frame_bits_exact(frame, &bits);
    if (bits.nominal == 0)
        return 0;
    return (int64_t)(bits.nominal * 1e9 / bitrate + bits.data * 1e9 / rate + 0.5);
}
