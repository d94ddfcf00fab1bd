/* bus.c: see bus.h. Memory, requests, and the loop over simulated time. */
#include "internal.h"

/* The next `size` bytes, or, without memory, how far they reach. */
static void *take(char *memory, size_t *used, size_t count, size_t size)
{
    void *place = memory ? memory + *used : NULL;
    *used += (count * size + 15) / 16 * 16;
    return place;
}

static void lay_out_node(node_t *n, const bus_node_settings_t *set, char *memory, size_t *used)
{
    size_t length = (size_t)set->queue_length;
    n->set = *set;
    n->slots = take(memory, used, length, sizeof *n->slots);
    n->order = n->order_room = take(memory, used, 2 * length, sizeof *n->order);
    n->spare = take(memory, used, length, sizeof *n->spare);
    n->inbox = take(memory, used, (size_t)set->inbox, sizeof *n->inbox);
    n->fifo = take(memory, used, (size_t)set->receive_length, sizeof *n->fifo);
}

static least_t lay_out_least(char *memory, size_t *used, int32_t nodes)
{
    least_t l;
    l.leaves = least_leaves(nodes);
    l.rows = take(memory, used, 2 * (size_t)l.leaves, sizeof *l.rows);
    for (int32_t k = 0; memory && k < 2 * l.leaves; k++) l.rows[k] = NEVER;
    return l;
}

/* Where everything lies in memory; without memory, only its size. */
static size_t lay_out(char *memory, const bus_settings_t *set)
{
    size_t used = 0, nodes = (size_t)set->n_nodes;
    bus_t scratch, *b = take(memory, &used, 1, sizeof *b);
    node_t node;
    if (!b) b = &scratch;
    b->nodes = take(memory, &used, nodes, sizeof *b->nodes);
    b->filters = take(memory, &used, (size_t)set->n_filters, sizeof *b->filters);
    b->scripts = take(memory, &used, (size_t)set->n_scripts, sizeof *b->scripts);
    b->interruptions = take(memory, &used, (size_t)set->n_interruptions, sizeof *b->interruptions);
    b->rates = take(memory, &used, (size_t)set->n_rates, sizeof *b->rates);
    b->ready = take(memory, &used, nodes, sizeof *b->ready);
    b->next_at = lay_out_least(memory, &used, set->n_nodes);
    b->waiting = lay_out_least(memory, &used, set->n_nodes);
    b->contending = lay_out_least(memory, &used, set->n_nodes);
    b->lost = take(memory, &used, nodes, sizeof *b->lost);
    for (int32_t i = 0; i < set->n_nodes; i++)
        lay_out_node(memory ? &b->nodes[i] : &node, &set->nodes[i], memory, &used);
    return used;
}

size_t bus_size(const bus_settings_t *set) { return lay_out(NULL, set); }

/* Initial error counters of the nodes; the resulting states are not reported as events. */
static void count_at_start(bus_t *b)
{
    uint32_t record = b->set.record;
    b->set.record = 0;
    for (int32_t i = 0; i < b->n; i++) {
        node_t *n = &b->nodes[i];
        n->tec = n->set.tec;
        count_received(b, n, n->set.rec);
        node_confine(b, i);
    }
    b->set.record = record;
}

bus_t *bus_create(void *memory, const bus_settings_t *set)
{
    bus_t *b = memory;
    memset(memory, 0, bus_size(set));
    lay_out(memory, set);
    b->set = *set;
    b->n = set->n_nodes;
    b->next_request = NEVER;
    b->deaf = !(set->record >> EVENT_RECEIVED & 1u);
    b->follow = (set->record & (1u << EVENT_STARTED | 1u << EVENT_LOST)) != 0;
    for (int32_t i = 0; i < set->n_filters; i++) b->filters[i] = set->filters[i];
    for (int32_t i = 0; i < set->n_scripts; i++) b->scripts[i].set = set->scripts[i];
    for (int32_t i = 0; i < set->n_interruptions; i++) b->interruptions[i] = set->interruptions[i];
    for (int32_t i = 0; i < set->n_rates; i++) b->rates[i].set = set->rates[i];
    for (int32_t i = 0; i < b->n; i++) {
        node_t *n = &b->nodes[i];
        n->slot = NO_SLOT;
        b->deaf &= n->set.receive_length == 0;
        b->follow |= n->set.one_shot || n->set.queue == QUEUE_MAILBOXES;
        for (int32_t j = 0; j < n->set.queue_length; j++)
            n->spare[j] = (uint16_t)(n->set.queue_length - 1 - j);
        b->ready[i] = NEVER;
    }
    line_create(b);
    clock_create(b);
    count_at_start(b);
    return b;
}

int64_t bus_request(bus_t *b, const bus_request_t *requests, int64_t count)
{
    int64_t i;
    for (i = 0; i < count; i++) {
        const bus_request_t *r = &requests[i];
        int32_t length = can_padded(r->frame.flags, r->frame.length), place;
        node_t *n;
        slot_t *s;
        if (r->node < 0 || r->node >= b->n || length < 0) break;
        n = &b->nodes[r->node];
        if (r->at < b->now || r->at < n->inbox_last || n->inbox_count == n->set.inbox) break;
        place = n->inbox_head + n->inbox_count++;
        s = &n->inbox[place < n->set.inbox ? place : place - n->set.inbox];
        s->frame = r->frame;
        s->frame.length = (uint8_t)length;
        s->frame.reserved = 0;
        length = r->frame.flags & CAN_REMOTE ? 0 : r->frame.length;
        memset(s->frame.data + length, 0, sizeof s->frame.data - (size_t)length);
        s->at = n->inbox_last = r->at;
        s->request = b->numbers++;
        s->aborted = 0;
        if (n->inbox_count == 1) next_inbox(b, r->node);
        if (r->at < b->next_request) b->next_request = r->at;
    }
    return i;
}

int32_t bus_abort(bus_t *b, int32_t node, int64_t request)
{
    node_t *n = &b->nodes[node];
    for (int32_t i = 0; i < n->pending; i++) {
        slot_t *s = &n->slots[n->order[i]];
        if (s->request == request) {
            b->asked = s->aborted = 1;
            return 1;
        }
    }
    for (int32_t i = 0; i < n->inbox_count; i++) {
        slot_t *s = &n->inbox[(n->inbox_head + i) % n->set.inbox];
        if (s->request == request) {
            s->aborted = 1;
            return 1;
        }
    }
    return 0;
}

void bus_reset(bus_t *b, int32_t node)
{
    b->nodes[node].reset = 1;
    b->asked = 1;
}

static int32_t restart(bus_t *b, int32_t node)
{
    node_t *n = &b->nodes[node];
    if (b->in_flight) unfold(b);
    b->stamp = b->now;
    while (n->pending) {
        if (!has_room(b)) return 0;
        drop(b, node, n->order[0], DROP_RESET);
    }
    b->off += n->phase != PHASE_OFF;
    b->counting -= n->phase != PHASE_OFF && n->rec > 0;
    n->needed = n->state == STATE_OFF ? 128 : 1;
    n->phase = PHASE_OFF;
    n->state = STATE_INTEGRATING;
    n->tec = n->rec = n->run = n->sender = n->reset = 0;
    n->quiet_from = b->now;
    refresh(b, node);
    event(b, node, EVENT_STATE, STATE_INTEGRATING, -1, -1, 0);
    return 1;
}

/* What the host asked for since the last call: aborts and resets. 0: the output is full. */
static int32_t obey(bus_t *b)
{
    if (b->in_flight && !b->followed) follow_losers(b);
    for (int32_t i = 0; i < b->n; i++) {
        node_t *n = &b->nodes[i];
        if (!has_room(b) || (n->reset && !restart(b, i))) return 0;
        for (int32_t j = n->pending - 1; j >= 0; j--) {
            int32_t slot = n->order[j];
            if (!n->slots[slot].aborted || slot == n->slot) continue;
            if (!has_room(b)) return 0;
            b->stamp = b->now;
            drop(b, i, slot, DROP_ABORTED);
        }
    }
    b->asked = 0;
    return 1;
}

int32_t bus_advance(bus_t *b, int64_t until, bus_output_t *output)
{
    b->out = output;
    b->n_events = b->n_frames = 0;
    b->full = 0;
    if (!b->asked || obey(b))
        while (b->bitwise ? wire_step(b, until) : clean_step(b, until));
    if (!b->full) drain(b, until - 1);
    if (!b->full) b->now = until;
    output->n_events = b->n_events;
    output->n_frames = b->n_frames;
    return b->full;
}

int64_t bus_next(const bus_t *b)
{
    int64_t first;
    if (b->bitwise) return b->sampling ? b->t_end : b->t + 1;
    if (b->in_flight) return b->end;
    first = next_start(b);
    first = b->next_request < first ? b->next_request : first;
    if (first == NEVER) return NEVER;
    return (first > b->now ? first : b->now) + 1;
}

void bus_state(const bus_t *b, int32_t node, bus_node_state_t *state)
{
    const node_t *n = &b->nodes[node];
    state->tec = n->tec;
    state->rec = n->rec;
    state->state = n->state;
    state->pending = n->pending;
}

int64_t bus_receive(bus_t *b, int32_t node, bus_received_t *frames, int64_t room)
{
    node_t *n = &b->nodes[node];
    int64_t i;
    for (i = 0; i < room && n->fifo_count; i++) {
        frames[i] = n->fifo[n->fifo_head];
        n->fifo_head = (n->fifo_head + 1) % n->set.receive_length;
        n->fifo_count--;
    }
    return i;
}

int64_t bus_whole_frames(const bus_t *b) { return b->whole_frames; }

void bus_frame_bits(const can_frame_t *f, bits_t *bits)
{
    *bits = can_bits(f->id, f->flags, f->length, f->data);
}
