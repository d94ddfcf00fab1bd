/* confine.c: fault confinement: the error counters, what state they give, and what ends a request.
 *
 * Rules 1 to 12 are those of Bosch, CAN 2.0 B, section 8 (ISO 11898-1).
 */
#include "internal.h"

enum { LIMIT_WARNING = 96, LIMIT_PASSIVE = 128, LIMIT_OFF = 256, REC_MOST = 255 };

int32_t node_passive(const node_t *n) { return n->tec >= LIMIT_PASSIVE || n->rec >= LIMIT_PASSIVE; }

can_frame_t node_frame(const node_t *n, int32_t slot)
{
    can_frame_t f = n->slots[slot].frame;
    if ((f.flags & CAN_FD) && node_passive(n)) f.flags |= CAN_ESI;
    return f;
}

/* The attempt to send has failed: with one-shot, or after an abort, there is no other. */
void node_failed(bus_t *b, int32_t node)
{
    node_t *n = &b->nodes[node];
    int32_t slot = n->slot;
    n->slot = NO_SLOT;
    if (slot == NO_SLOT) return;
    if (n->slots[slot].aborted) drop(b, node, slot, DROP_ABORTED);
    else if (n->set.one_shot) drop(b, node, slot, DROP_ONE_SHOT);
}

/* Rules 9 to 11: the state that the counters give. */
void node_confine(bus_t *b, int32_t node)
{
    node_t *n = &b->nodes[node];
    int32_t most = n->tec > n->rec ? n->tec : n->rec, state = STATE_ACTIVE;
    if (n->phase == PHASE_OFF) return;
    if (n->tec >= LIMIT_OFF) state = STATE_OFF;
    else if (most >= LIMIT_PASSIVE) state = STATE_PASSIVE;
    else if (most >= LIMIT_WARNING) state = STATE_WARNING;
    if (state == n->state) return;
    n->state = state;
    event(b, node, EVENT_STATE, state, -1, -1, 0);
    if (state == STATE_OFF) {
        b->counting -= n->rec > 0;
        b->off++;
        n->phase = PHASE_OFF;
        n->sender = 0;
        n->run = 0;
        n->needed = n->set.recovers ? 128 : 0;
        refresh(b, node);
    }
}

void count_received(bus_t *b, node_t *n, int32_t rec)
{
    b->counting += (rec > 0) - (n->rec > 0);
    n->rec = rec > REC_MOST ? REC_MOST : rec;
}

/* Rule 7, at the end of EOF. */
void node_sent(bus_t *b, int32_t node, int32_t slot)
{
    node_t *n = &b->nodes[node];
    int64_t request = n->slots[slot].request;
    int32_t row = -1;
    if (b->set.record >> EVENT_SENT & 1u) {
        can_frame_t f = node_frame(n, slot);
        row = keep_frame(b, &f);
    }
    if (n->tec > 0) n->tec--;
    release(b, node, slot);
    event(b, node, EVENT_SENT, 0, request, row, 0);
    node_confine(b, node);
}

/* Rule 12: back on the bus, error active, counters 0. The time is b->stamp. */
void recover(bus_t *b, int32_t node)
{
    node_t *n = &b->nodes[node];
    b->off--;
    n->tec = n->rec = 0;
    n->phase = PHASE_IDLE;
    n->state = STATE_ACTIVE;
    n->sender = 0;
    n->needed = 0;
    n->earliest = b->stamp;
    refresh(b, node);
    event(b, node, EVENT_RECOVERED, 0, -1, -1, 0);
}
