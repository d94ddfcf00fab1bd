/* queue.c: what a node has to send: its inbox of future requests, and its transmit queue. */
#include "internal.h"

/* The bits that arbitrate, the smallest wins (cosim/bus/arbitration.py: rank). */
uint32_t frame_rank(const can_frame_t *f)
{
    uint32_t remote = (f->flags & CAN_REMOTE) != 0;
    if (f->flags & CAN_EXTENDED) return (f->id >> 18) << 21 | 3u << 19 | (f->id & 0x3FFFFu) << 1 | remote;
    return f->id << 21 | remote << 20;
}

/* What arbitration has to know of a node, after a change of its queue or its state. */
void refresh(bus_t *b, int32_t node)
{
    const node_t *n = &b->nodes[node];
    int64_t ready = NEVER;
    if (n->pending > 0 && n->phase != PHASE_OFF) {
        ready = n->slots[n->order[0]].at;
        if (ready < n->earliest) ready = n->earliest;
    }
    b->ready[node] = ready;
    if (ready <= b->free) {
        contend(b, node);
    } else {
        least_set(&b->contending, node, NEVER);
        least_set(&b->waiting, node, ready);
    }
}

void contend(bus_t *b, int32_t node)
{
    const node_t *n = &b->nodes[node];
    least_set(&b->waiting, node, NEVER);
    least_set(&b->contending, node, (int64_t)n->slots[n->order[0]].rank << 16 | node);
}

/* Give a slot back; most often it is the first of the order. */
void release(bus_t *b, int32_t node, int32_t slot)
{
    node_t *n = &b->nodes[node];
    int32_t i = 0;
    while (n->order[i] != slot) i++;
    n->pending--;
    if (i == 0) n->order++;
    else memmove(&n->order[i], &n->order[i + 1], (size_t)(n->pending - i) * sizeof *n->order);
    n->spare[n->set.queue_length - n->pending - 1] = (uint16_t)slot;
    if (n->slot == slot) n->slot = NO_SLOT;
    refresh(b, node);
}

void drop(bus_t *b, int32_t node, int32_t slot, int32_t cause)
{
    event(b, node, EVENT_DROPPED, cause, b->nodes[node].slots[slot].request, -1, 0);
    release(b, node, slot);
}

void next_inbox(bus_t *b, int32_t node)
{
    const node_t *n = &b->nodes[node];
    least_set(&b->next_at, node, n->inbox_count ? n->inbox[n->inbox_head].at : NEVER);
}

/* Where a frame goes in the order: behind all that go before it. */
static int32_t place(const node_t *n, uint32_t rank)
{
    int32_t low = 0, high = n->pending;
    if (n->set.queue == QUEUE_FIFO) return high;
    while (low < high) {
        int32_t middle = (low + high) / 2;
        if (n->slots[n->order[middle]].rank <= rank) low = middle + 1;
        else high = middle;
    }
    return low;
}

/* In mailboxes: the slot of the same identifier, unless it is being sent. */
static int32_t same(const node_t *n, uint32_t rank)
{
    for (int32_t i = 0; i < n->pending; i++)
        if (n->slots[n->order[i]].rank == rank && n->order[i] != n->slot) return n->order[i];
    return NO_SLOT;
}

int32_t requested(const node_t *n, int64_t t)
{
    for (int32_t i = 0; i < n->pending; i++)
        if (n->slots[n->order[i]].at <= t) return n->order[i];
    return NO_SLOT;
}

/* Put a slot at a place of the order. */
static void insert(node_t *n, int32_t at, int32_t slot)
{
    if (at == 0 && n->order > n->order_room) {
        n->order--;
    } else {
        if (n->order + n->pending == n->order_room + 2 * n->set.queue_length) {
            memmove(n->order_room, n->order, (size_t)n->pending * sizeof *n->order);
            n->order = n->order_room;
        }
        memmove(&n->order[at + 1], &n->order[at], (size_t)(n->pending - at) * sizeof *n->order);
    }
    n->order[at] = (uint16_t)slot;
    n->pending++;
}

static void enqueue(bus_t *b, int32_t node, const slot_t *in)
{
    node_t *n = &b->nodes[node];
    uint32_t rank = frame_rank(&in->frame);
    int32_t at, slot;
    b->stamp = in->at > b->now ? in->at : b->now;
    if (in->aborted) {
        event(b, node, EVENT_DROPPED, DROP_ABORTED, in->request, -1, 0);
        return;
    }
    if (n->set.queue == QUEUE_MAILBOXES && (slot = same(n, rank)) != NO_SLOT)
        drop(b, node, slot, DROP_REPLACED);
    if (n->pending == n->set.queue_length) {
        event(b, node, EVENT_DROPPED, DROP_OVERFLOW, in->request, -1, 0);
        return;
    }
    at = place(n, rank);
    slot = n->spare[n->set.queue_length - n->pending - 1];
    insert(n, at, slot);
    n->slots[slot] = *in;
    n->slots[slot].rank = rank;
    n->slots[slot].bits = can_bits(in->frame.id, in->frame.flags, in->frame.length, in->frame.data);
    if (at == 0) refresh(b, node);
}

int32_t drain(bus_t *b, int64_t until)
{
    while (b->next_request <= until) {
        int32_t node = least_node(&b->next_at), before;
        node_t *n = &b->nodes[node];
        int64_t others = least_other(&b->next_at, node, &before), at = least_of(&b->next_at);
        int64_t limit = others - before; /* at the time of the others, a node before this one is first */
        for (limit = limit < until ? limit : until; at <= limit;) {
            if (!has_room(b)) return 0;
            enqueue(b, node, &n->inbox[n->inbox_head]);
            n->inbox_head = n->inbox_head + 1 == n->set.inbox ? 0 : n->inbox_head + 1;
            n->inbox_count--;
            at = n->inbox_count ? n->inbox[n->inbox_head].at : NEVER;
            least_set(&b->next_at, node, at);
        }
        b->next_request = at < others ? at : others;
    }
    return has_room(b);
}
