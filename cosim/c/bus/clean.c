/* clean.c: the bus between disturbances: a transmission is computed as a whole. */
#include "internal.h"

/* When a node that is off has seen the sequences of 11 recessive bits that it needs. */
static int64_t recovery(const bus_t *b, const node_t *n)
{
    return n->quiet_from + 11 * (int64_t)n->needed * b->set.bit;
}

static int32_t next_recovery(const bus_t *b, int64_t *at)
{
    int32_t node = -1;
    *at = NEVER;
    for (int32_t i = 0; b->off && i < b->n; i++) {
        const node_t *n = &b->nodes[i];
        if (n->phase == PHASE_OFF && n->needed > 0 && recovery(b, n) < *at) {
            *at = recovery(b, n);
            node = i;
        }
    }
    return node;
}

int64_t next_start(const bus_t *b)
{
    int64_t first = least_of(&b->waiting);
    return first <= b->free || least_of(&b->contending) != NEVER ? b->free : first;
}

/* Bits on the wire before each bit that arbitrates: 32 of them, from the first of the identifier. */
static void stuffed_before(uint32_t rank, uint8_t at[32], int32_t most)
{
    uint32_t last = 0, run = 1;
    int32_t stuffed = 0;
    for (int32_t i = 0; i <= most; i++) {
        uint32_t bit = rank >> (31 - i) & 1u;
        if (run == 5) {
            stuffed++;
            last = !last;
            run = 1;
        }
        at[i] = (uint8_t)(1 + i + stuffed);
        run = bit == last ? run + 1 : 1;
        last = bit;
    }
}

static int32_t first_bit(uint32_t x)
{
    int32_t i = 0;
    if (!(x & 0xFFFF0000u)) {
        i += 16;
        x <<= 16;
    }
    if (!(x & 0xFF000000u)) {
        i += 8;
        x <<= 8;
    }
    if (!(x & 0xF0000000u)) {
        i += 4;
        x <<= 4;
    }
    if (!(x & 0xC0000000u)) {
        i += 2;
        x <<= 2;
    }
    return i + !(x & 0x80000000u);
}

/* The slots with which the nodes take part in arbitration at t. */
static void find_contenders(bus_t *b, int64_t t)
{
    for (int32_t i = 0; i < b->n; i++) {
        node_t *n = &b->nodes[i];
        n->slot = n->phase == PHASE_OFF || n->earliest > t ? NO_SLOT : requested(n, t);
    }
}

/* The nodes that lose arbitration, in the order in which they lose it. */
static void find_losers(bus_t *b, int64_t t)
{
    const node_t *winner = &b->nodes[b->winner];
    uint32_t best = winner->slots[winner->slot].rank;
    uint8_t at[32];
    int32_t most = 0;
    for (int32_t i = 0; i < b->n; i++) {
        const node_t *n = &b->nodes[i];
        int32_t bit, j;
        if (n->slot == NO_SLOT || n == winner) continue;
        bit = first_bit(best ^ n->slots[n->slot].rank);
        most = bit > most ? bit : most;
        for (j = b->n_lost++; j > 0 && b->lost[j - 1].bit > bit; j--) b->lost[j] = b->lost[j - 1];
        b->lost[j].node = i;
        b->lost[j].bit = bit;
    }
    if (b->n_lost) stuffed_before(best, at, most);
    for (int32_t i = 0; i < b->n_lost; i++) {
        b->lost[i].bit = at[b->lost[i].bit];
        b->lost[i].time = t + (b->lost[i].bit + 1) * b->bit_ps;
    }
}

void follow_losers(bus_t *b)
{
    b->followed = 1;
    find_contenders(b, b->sof);
    find_losers(b, b->sof);
    for (; b->lost_done < b->n_lost && b->lost[b->lost_done].time <= b->now; b->lost_done++)
        b->nodes[b->lost[b->lost_done].node].slot = NO_SLOT;
}

/* The winner at t; *tie: another has the same bits. */
static int32_t arbitrate(bus_t *b, int64_t t, int32_t *tie)
{
    int32_t winner, before;
    int64_t best;
    while (least_of(&b->waiting) <= t) contend(b, least_node(&b->waiting));
    best = least_of(&b->contending);
    winner = (int32_t)(best & 0xFFFF);
    *tie = best >> 16 == least_other(&b->contending, winner, &before) >> 16;
    return winner;
}

/* The transmission of the winner at t will be undisturbed. (A node that suspends its transmission
 * meanwhile need not be told: its eight bits are over before the frame is.) */
static void launch(bus_t *b, int64_t t)
{
    b->in_flight = 1;
    b->sof = t;
    b->end = b->next - 3 * b->bit_ps;
    b->stamp = t;
    b->whole_frames++;
    b->n_lost = b->lost_done = 0;
    b->followed = b->follow;
    if (!b->follow) {
        b->nodes[b->winner].slot = b->nodes[b->winner].order[0];
        return;
    }
    find_contenders(b, t);
    find_losers(b, t);
    for (int32_t i = 0; i < b->n; i++) {
        const node_t *n = &b->nodes[i];
        if (n->slot != NO_SLOT) event_at_bit(b, i, EVENT_STARTED, 0, n->slots[n->slot].request, 0, 0);
    }
}

/* A start of frame at t: closed form, or bit by bit. */
static void start(bus_t *b, int64_t t)
{
    int32_t tie, winner = arbitrate(b, t, &tie);
    node_t *n = &b->nodes[winner];
    const slot_t *slot = &n->slots[n->order[0]];
    int32_t scripted = line_attempt(b, &slot->frame);
    b->bits = slot->bits;
    if (node_passive(n)) { /* says so in FD frames */
        can_frame_t f = node_frame(n, n->order[0]);
        b->bits = can_bits(f.id, f.flags, f.length, f.data);
    }
    clock_lead(b, winner);
    b->next = t + b->bits.nominal * b->bit_ps + b->bits.data * b->data_bit_ps;
    if (tie || scripted || b->counting || b->n - b->off < 2 || !clock_in_step(b, winner, &slot->frame) ||
        !line_calm(b, t, b->next, b->bits.nominal + b->bits.data)) {
        b->known_attempt = 1;
        wire_enter(b, t);
        return;
    }
    b->winner = winner;
    launch(b, t);
}

/* Nothing is being sent. */
static int32_t idle_step(bus_t *b, int64_t until)
{
    int64_t first = next_start(b), back, glitch = line_glitch(b), limit;
    int32_t node = next_recovery(b, &back);
    int64_t t = back < first ? back : first;
    t = glitch < t ? glitch : t;
    if (b->next_request <= t) {
        if (b->next_request >= until) return 0;
        limit = b->next_request > b->free ? b->next_request : b->free;
        limit = t < limit ? t : limit;
        return drain(b, limit < until ? limit : until - 1);
    }
    if (t > until || !has_room(b)) return 0;
    if (back == t) {
        b->stamp = t;
        recover(b, node);
        return 1;
    }
    if (t == until) return 0;
    if (first == t) start(b, t);
    else wire_enter(b, t);
    return 1;
}

static void lose(bus_t *b, const lost_t *lost)
{
    node_t *n = &b->nodes[lost->node];
    b->stamp = lost->time;
    event_at_bit(b, lost->node, EVENT_LOST, 0, n->slots[n->slot].request, 0, lost->bit);
    node_failed(b, lost->node);
}

static void finish_sent(bus_t *b)
{
    node_t *n = &b->nodes[b->winner];
    n->earliest = 0;
    node_sent(b, b->winner, n->slot);
    n->sender = 1;
    if (node_passive(n)) {
        n->earliest = b->next + 8 * b->set.bit;
        refresh(b, b->winner);
    }
}

/* The others have the frame, or, while off, saw the bus busy. */
static void finish_others(bus_t *b, const can_frame_t *frame, int64_t request, int32_t from, int32_t to)
{
    for (int32_t i = from; i < to; i++) {
        node_t *n = &b->nodes[i];
        if (n->phase == PHASE_OFF) {
            if (n->needed > 0) n->needed -= (int32_t)((b->sof - n->quiet_from) / b->set.bit / 11);
            n->quiet_from = b->next - 11 * b->set.bit;
        } else if (!b->deaf) {
            deliver(b, i, frame, request);
        }
    }
}

/* The end of EOF: all nodes have the frame. */
static void finish(bus_t *b)
{
    const node_t *winner = &b->nodes[b->winner];
    int64_t request = winner->slots[winner->slot].request;
    b->stamp = b->end;
    b->in_flight = 0;
    b->free = b->next;
    line_pass(b, b->bits.nominal + b->bits.data);
    if (b->deaf && !b->off) {
        finish_sent(b);
    } else {
        can_frame_t frame = node_frame(winner, winner->slot);
        finish_others(b, &frame, request, 0, b->winner);
        finish_sent(b);
        finish_others(b, &frame, request, b->winner + 1, b->n);
    }
}

static int32_t flight_step(bus_t *b, int64_t until)
{
    int32_t losing = b->lost_done < b->n_lost;
    int64_t t = losing ? b->lost[b->lost_done].time : b->end;
    if (t > until || !drain(b, t - 1)) return 0;
    if (!losing) {
        finish(b);
        return 1;
    }
    do {
        lose(b, &b->lost[b->lost_done++]);
        if (b->lost_done == b->n_lost) break;
        t = b->lost[b->lost_done].time;
    } while (t <= until && t <= b->next_request);
    return 1;
}

int32_t clean_step(bus_t *b, int64_t until)
{
    return b->in_flight ? flight_step(b, until) : idle_step(b, until);
}
