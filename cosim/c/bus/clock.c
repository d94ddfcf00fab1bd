/* clock.c: nodes whose clocks run faster or slower than nominal.
 *
 * The node that transmits times the bus. A receiver samples by its own clock: it is aligned to the
 * start of frame, moves away from the bus bit by bit, and is corrected by at most `sjw` at each
 * edge from recessive to dominant (ISO 11898-1, resynchronisation). When its sample would lie behind
 * the end of the bit, it misses that bit; when before its begin, it samples the bit before twice. Its
 * frame then has a bit too few or too many, which it finds as an error.
 */
#include "internal.h"

/* Most bits of a frame between two edges that correct, and from the last one to the end of frame. */
enum { BETWEEN_EDGES = 10, AFTER_EDGES = 13 };

static int64_t own(int64_t bit, int32_t ppb) { return (int64_t)((double)bit / (1.0 + ppb * 1e-9) + 0.5); }

void clock_create(bus_t *b)
{
    b->bit_ps = b->set.bit;
    b->data_bit_ps = b->set.data_bit;
    for (int32_t i = 0; i < b->n; i++) {
        node_t *n = &b->nodes[i];
        n->bit = own(b->set.bit, n->set.clock_ppb);
        n->data_bit = own(b->set.data_bit, n->set.clock_ppb);
        b->drifting |= n->set.clock_ppb != 0;
    }
}

void clock_lead(bus_t *b, int32_t node)
{
    b->bit_ps = b->nodes[node].bit;
    b->data_bit_ps = b->nodes[node].data_bit;
}

/* Whether all receivers follow the sender through the whole frame, with each edge correcting fully. */
int32_t clock_in_step(const bus_t *b, int32_t sender, const can_frame_t *frame)
{
    if (!b->drifting) return 1;
    for (int32_t i = 0; i < b->n; i++) {
        const node_t *n = &b->nodes[i];
        int64_t apart = n->bit - b->nodes[sender].bit;
        int64_t bit = frame->flags & CAN_BRS ? n->data_bit : n->bit;
        int32_t margin = n->set.sample_point < 500 ? n->set.sample_point : 1000 - n->set.sample_point;
        apart = apart < 0 ? -apart : apart;
        if (BETWEEN_EDGES * apart > bit * n->set.sjw / 1000 || AFTER_EDGES * apart > bit * margin / 1000)
            return 0;
    }
    return 1;
}

void clock_align(node_t *n)
{
    n->late = 0;
    n->seen = 0;
}

int32_t clock_samples(bus_t *b, int32_t node, int32_t level)
{
    node_t *n = &b->nodes[node];
    int64_t bit = b->fast ? n->data_bit : n->bit, most = bit * n->set.sjw / 1000;
    int32_t edge = n->seen && !level;
    if (!b->drifting) return 1;
    n->seen = level;
    if (n->phase == PHASE_IDLE || n->phase == PHASE_OFF || (n->phase == PHASE_FRAME && n->sender)) {
        n->late = 0;
        return 1;
    }
    n->late += bit - (b->t_end - b->t);
    if (edge) n->late -= n->late > most ? most : n->late < -most ? -most : n->late;
    if (n->late > bit * (1000 - n->set.sample_point) / 1000) {
        n->late -= bit;
        return 0;
    }
    if (n->late < -bit * n->set.sample_point / 1000) {
        n->late += bit;
        return 2;
    }
    return 1;
}
