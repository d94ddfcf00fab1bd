/* report.c: events and received frames. */
#include "internal.h"

/* Whether all events of one more step fit: at most 6 per node. */
int32_t has_room(bus_t *b)
{
    int64_t margin = 6 * (int64_t)b->n + 8;
    if (b->n_events + margin <= b->out->n_events && b->n_frames + margin <= b->out->n_frames) return 1;
    b->full = 1;
    return 0;
}

static void write(bus_t *b, int32_t node, int32_t kind, int32_t code, int64_t request, int32_t frame,
                  int32_t role, int32_t bit)
{
    const node_t *n = node < 0 ? NULL : &b->nodes[node];
    bus_event_t *e;
    if (!(b->set.record >> kind & 1u) || b->stamp < b->muted_until) return;
    e = &b->out->events[b->n_events++];
    e->time = b->stamp;
    e->request = request;
    e->frame = frame;
    e->bit = (int16_t)(bit > INT16_MAX ? INT16_MAX : bit);
    e->node = (int16_t)node;
    e->tec = n ? (int16_t)n->tec : 0;
    e->rec = n ? (int16_t)n->rec : 0;
    e->kind = (uint8_t)kind;
    e->code = (uint8_t)code;
    e->role = (uint8_t)role;
    e->reserved = 0;
}

void event(bus_t *b, int32_t node, int32_t kind, int32_t code, int64_t request, int32_t frame, int32_t role)
{
    write(b, node, kind, code, request, frame, role, -1);
}

void event_at_bit(bus_t *b, int32_t node, int32_t kind, int32_t code, int64_t request, int32_t role,
                  int32_t bit)
{
    write(b, node, kind, code, request, -1, role, bit);
}

/* A row in the output's frames; equal frames at one time share it. */
int32_t keep_frame(bus_t *b, const can_frame_t *frame)
{
    if (b->frame_stamp == b->stamp && b->n_frames &&
        !memcmp(&b->out->frames[b->n_frames - 1], frame, sizeof *frame))
        return (int32_t)(b->n_frames - 1);
    b->frame_stamp = b->stamp;
    b->out->frames[b->n_frames] = *frame;
    return (int32_t)b->n_frames++;
}

static int32_t accepted(const bus_t *b, const node_t *n, const can_frame_t *frame)
{
    const bus_filter_t *f = b->filters + n->set.first_filter;
    if (n->set.n_filters == 0) return 1;
    for (int32_t i = 0; i < n->set.n_filters; i++)
        if (!((frame->id ^ f[i].id) & f[i].mask) && !((frame->flags ^ f[i].flags) & f[i].flag_mask)) return 1;
    return 0;
}

/* A valid frame at the end of its EOF, at a node that did not send it. */
void deliver(bus_t *b, int32_t node, const can_frame_t *frame, int64_t request)
{
    node_t *n = &b->nodes[node];
    int32_t row;
    if (!accepted(b, n, frame)) return;
    row = b->set.record >> EVENT_RECEIVED & 1u ? keep_frame(b, frame) : -1;
    event(b, node, EVENT_RECEIVED, 0, request, row, 0);
    if (n->set.receive_length == 0) return;
    if (n->fifo_count == n->set.receive_length) {
        event(b, node, EVENT_DROPPED, DROP_RECEIVE_OVERFLOW, request, row, 0);
        return;
    }
    bus_received_t *r = &n->fifo[(n->fifo_head + n->fifo_count++) % n->set.receive_length];
    r->time = b->stamp;
    r->request = request;
    r->frame = *frame;
}
