/* frame_bits.c: the bits of a frame as its transmitter sends them, from SOF to the end of EOF. */
#include "internal.h"

typedef struct {
    uint8_t *bits;
    int32_t n, last, run, stuffed;
    uint32_t crc15, crc17, crc21;
} sender_t;

static uint32_t crc_step(uint32_t crc, uint32_t bit, int32_t width, uint32_t polynomial)
{
    uint32_t high = (crc >> (width - 1) ^ bit) & 1u;
    return (crc << 1 & ((1u << width) - 1u)) ^ (high ? polynomial : 0u);
}

static void plain(sender_t *s, uint32_t bit, uint32_t kind)
{
    s->bits[s->n++] = (uint8_t)(bit | kind);
    s->last = (int32_t)bit;
}

static void fd_crc(sender_t *s, uint32_t bit)
{
    s->crc17 = crc_step(s->crc17, bit, 17, 0x1685Bu);
    s->crc21 = crc_step(s->crc21, bit, 21, 0x102899u);
}

/* A stuff bit has the kind of the bit that it stands before. */
static void stuff(sender_t *s, uint32_t kind)
{
    if (s->run < 5) return;
    plain(s, !s->last, kind | WIRE_STUFF);
    fd_crc(s, (uint32_t)s->last);
    s->stuffed++;
    s->run = 1;
}

static void stuffed(sender_t *s, uint32_t value, int32_t width, uint32_t kind)
{
    for (int32_t i = width - 1; i >= 0; i--) {
        uint32_t bit = value >> i & 1u;
        stuff(s, kind);
        s->run = (int32_t)bit == s->last ? s->run + 1 : 1;
        plain(s, bit, kind);
        s->crc15 = crc_step(s->crc15, bit, 15, 0x4599u);
        fd_crc(s, bit);
    }
}

static void header(sender_t *s, const can_frame_t *f)
{
    uint32_t remote = (f->flags & CAN_REMOTE) != 0;
    stuffed(s, 0, 1, 0);
    if (f->flags & CAN_EXTENDED) {
        stuffed(s, f->id >> 18, 11, WIRE_ARBITRATION);
        stuffed(s, 3, 2, WIRE_ARBITRATION);
        stuffed(s, f->id & 0x3FFFFu, 18, WIRE_ARBITRATION);
        stuffed(s, remote, 1, WIRE_ARBITRATION);
    } else {
        stuffed(s, f->id, 11, WIRE_ARBITRATION);
        stuffed(s, remote, 1, WIRE_ARBITRATION);
        stuffed(s, 0, 1, 0);
    }
}

/* Stuff count, CRC and fixed stuff bits of an FD frame. */
static void fd_tail(sender_t *s, int32_t length, uint32_t kind)
{
    static const uint8_t gray[8] = {0, 3, 6, 5, 12, 15, 10, 9}; /* with parity */
    int32_t width = length <= 16 ? 17 : 21;
    uint32_t count = gray[s->stuffed & 7], crc;
    for (int32_t i = 3; i >= 0; i--) fd_crc(s, count >> i & 1u);
    crc = width == 17 ? s->crc17 : s->crc21;
    for (int32_t i = 0; i < 4 + width; i++) {
        if (i % 4 == 0) plain(s, !s->last, kind | WIRE_STUFF);
        plain(s, (i < 4 ? count >> (3 - i) : crc >> (width + 3 - i)) & 1u, kind);
    }
}

int32_t wire_bits(const can_frame_t *f, uint8_t *bits)
{
    sender_t s = {bits, 0, 1, 0, 0, 0, 1u << 16, 1u << 20};
    int32_t length = can_padded(f->flags, f->length);
    uint32_t late = f->flags & CAN_BRS ? WIRE_DATA_RATE : 0;
    header(&s, f);
    if (f->flags & CAN_FD) {
        stuffed(&s, 4u | ((f->flags & CAN_BRS) != 0), 3, 0);
        stuffed(&s, (f->flags & CAN_ESI) != 0, 1, late);
    } else {
        stuffed(&s, 0, f->flags & CAN_EXTENDED ? 2 : 1, 0);
    }
    stuffed(&s, can_code(length), 4, late);
    for (int32_t i = 0; !(f->flags & CAN_REMOTE) && i < length; i++)
        stuffed(&s, i < f->length ? f->data[i] : 0, 8, late);
    if (f->flags & CAN_FD) {
        fd_tail(&s, length, late);
    } else {
        stuffed(&s, s.crc15, 15, 0);
        stuff(&s, 0);
    }
    plain(&s, 1, late);
    plain(&s, 1, WIRE_ACK);
    for (int32_t i = 0; i < 8; i++) plain(&s, 1, 0);
    return s.n;
}
