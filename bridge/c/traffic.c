/* traffic.c: counters of the traffic on a bus; see traffic.h */
#include "traffic.h"

/* Bits of a classic frame with 3 bits of inter-frame space: 47 + 8 n, or 67 + 8 n extended, of which
 * 34 + 8 n, or 54 + 8 n, are stuffed. CAN FD (ISO 11898-1:2015): 17 or 36 bits to BRS, stuffed, and
 * 12 from the acknowledgement on; between them the data phase: ESI, DLC and data, stuffed, stuff
 * count, CRC with its fixed stuff bits, delimiter. */
static void frame_bits(const frame_t *f, double *bits, double *data_bits)
{
    int extended = (f->flags & FRAME_EXTENDED) != 0;
    int n = f->flags & FRAME_REMOTE ? 0 : 8 * f->length;
    double phase;

    *data_bits = 0;
    if (!(f->flags & FRAME_FD)) {
        *bits = (extended ? 67 : 47) + n + (extended ? 54 + n : 34 + n) / 30.0;
        return;
    }
    *bits = (extended ? 36 : 17) * (31.0 / 30.0) + 12;
    phase = (5 + n) * (31.0 / 30.0) + (f->length <= 16 ? 4 + 17 + 6 : 4 + 21 + 7) + 1;
    if (f->flags & FRAME_BRS) *data_bits = phase;
    else *bits += phase;
}

void traffic_add(traffic_t *traffic, const frame_t *frame)
{
    int64_t number = frame->t_ns / TRAFFIC_SLOT_NS;
    int64_t slot = number & (TRAFFIC_SLOTS - 1);
    double bits, data_bits;

    if (frame->flags & FRAME_ERROR) {
        traffic->error_frames++;
        return;
    }
    frame_bits(frame, &bits, &data_bits);
    if (traffic->number[slot] != number) {
        if (number < traffic->number[slot]) return; /* older than what the table holds */
        traffic->slot_frames[slot] = 0;
        traffic->slot_bits[slot] = traffic->slot_data_bits[slot] = 0;
        traffic->number[slot] = number;
    }
    traffic->frames++;
    traffic->bits += bits;
    traffic->data_bits += data_bits;
    traffic->slot_frames[slot]++;
    traffic->slot_bits[slot] += bits;
    traffic->slot_data_bits[slot] += data_bits;
}
