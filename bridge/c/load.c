/* load.c: see load.h */
#include "load.h"

void frame_bits_exact(const frame_t *f, bits_t *bits)
{
    static const bits_t none;
    *bits = f->flags & FRAME_ERROR ? none : can_bits(f->id, f->flags, f->length, f->data);
}

int64_t frame_time_ns(const frame_t *frame, double bitrate, double data_bitrate)
{
    bits_t bits;
    double rate = data_bitrate > 0.0 ? data_bitrate : bitrate;
    frame_bits_exact(frame, &bits);
    if (bits.nominal == 0) return 0;
    return (int64_t)(bits.nominal * 1e9 / bitrate + bits.data * 1e9 / rate + 0.5);
}
