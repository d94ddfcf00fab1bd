/* wire.c: the bus bit by bit. A bit has two halves: all nodes drive it, all nodes sample it. */
#include "internal.h"

/* Go bit by bit from `t` on, which is the begin of a bit. All nodes are idle or off. */
void wire_enter(bus_t *b, int64_t t)
{
    b->bitwise = 1;
    b->sampling = 0;
    b->t = t;
    b->bit = 0;
    for (int32_t i = 0; i < b->n; i++) {
        node_t *n = &b->nodes[i];
        if (n->phase == PHASE_OFF) {
            int64_t bits = (t - n->quiet_from) / b->set.bit;
            n->run = (int32_t)(bits % 11);
            if (n->needed > 0) n->needed -= (int32_t)(bits / 11);
        }
    }
}

/* All nodes are idle again: the clean path continues from here. */
static void leave(bus_t *b)
{
    b->bitwise = 0;
    b->free = b->t;
    for (int32_t i = 0; i < b->n; i++)
        if (b->nodes[i].phase == PHASE_OFF) b->nodes[i].quiet_from = b->t - b->nodes[i].run * b->set.bit;
}

/* An attempt begins: of the identifier with the highest priority of those that start. */
static void attempt(bus_t *b, int32_t first)
{
    clock_lead(b, first);
    if (!b->known_attempt) {
        can_frame_t *f = &b->nodes[first].slots[b->nodes[first].slot].frame;
        line_attempt(b, f);
    }
    b->known_attempt = 0;
}

static uint32_t sent_rank(const node_t *n) { return n->slots[n->slot].rank; }

static void start(bus_t *b)
{
    int32_t first = -1;
    b->stamp = b->t;
    for (int32_t i = 0; i < b->n; i++) {
        node_t *n = &b->nodes[i];
        if (n->phase != PHASE_IDLE || (b->ready[i] > b->t && n->slot == NO_SLOT)) continue;
        b->bit = 0;
        node_begin(b, i, 0);
        if (first < 0 || sent_rank(n) < sent_rank(&b->nodes[first])) first = i;
    }
    if (first >= 0) attempt(b, first);
}

static void drive(bus_t *b)
{
    int32_t fast = 0, dominant = 0;
    start(b);
    b->level = 1;
    b->flags = 0;
    b->on_air = -1;
    for (int32_t i = 0; i < b->n; i++) {
        node_t *n = &b->nodes[i];
        if (line_connected(b, i)) b->level &= node_drive(b, i);
        n->flagging = n->phase == PHASE_ACTIVE_FLAG;
        b->flags += n->flagging;
        dominant |= n->phase == PHASE_ACTIVE_FLAG || n->phase == PHASE_OVERLOAD_FLAG;
        if (n->phase == PHASE_FRAME && n->sender) {
            fast |= n->wire[n->position] & WIRE_DATA_RATE;
            if (b->on_air < 0) b->on_air = n->slots[n->slot].request;
        }
    }
    b->fast = fast && !dominant;
    b->t_end = b->t + (b->fast ? b->data_bit_ps : b->bit_ps);
    b->sampling = 1;
}

static void join(bus_t *b)
{
    int32_t first = -1;
    for (int32_t i = 0; i < b->n; i++) {
        const node_t *n = &b->nodes[i];
        if (n->phase == PHASE_FRAME && n->sender && n->count && n->position == 1 &&
            (first < 0 || sent_rank(n) < sent_rank(&b->nodes[first])))
            first = i;
    }
    attempt(b, first);
    b->bit = 0;
    b->joined = 0;
}

static void sample(bus_t *b)
{
    int32_t level, idle = 1;
    line_draw(b);
    level = line_bus(b, b->level);
    b->stamp = b->t_end;
    for (int32_t i = 0; i < b->n; i++) {
        int32_t seen = line_node(b, i, level);
        int32_t before = b->nodes[i].seen, times = clock_samples(b, i, seen);
        if (times > 1) node_sample(b, i, before);
        if (times > 0) node_sample(b, i, seen);
        idle &= b->nodes[i].phase == PHASE_IDLE || b->nodes[i].phase == PHASE_OFF;
    }
    if (b->joined) join(b);
    b->t = b->t_end;
    b->bit++;
    b->sampling = 0;
    if (idle && b->troubled) {
        b->troubled = 0;
        event(b, -1, EVENT_FREE, 0, -1, -1, 0);
    }
    if (idle && !line_busy(b)) leave(b);
}

int32_t wire_step(bus_t *b, int64_t until)
{
    if (!b->sampling) {
        if (b->t >= until || !drain(b, b->t)) return 0;
        drive(b);
    }
    if (b->t_end > until || !drain(b, b->t_end - 1)) return 0;
    sample(b);
    return 1;
}

/* A node that takes part in a transmission of the clean path is restarted: repeat the transmission
 * bit by bit up to now, where nothing but the restart is new. Its events were written already. */
void unfold(bus_t *b)
{
    b->in_flight = 0;
    b->known_attempt = 1;
    b->muted_until = b->now + 1;
    b->whole_frames--;
    wire_enter(b, b->sof);
    while (wire_step(b, b->now));
    b->muted_until = 0;
}
