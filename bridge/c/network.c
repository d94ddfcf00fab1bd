/* network.c: see network.h */
#include "network.h"

#include <string.h>

#include "bus/bus.h"

enum { PS = 1000 }; /* in a ns */
enum { CAN_FLAGS = CAN_FD | CAN_BRS | CAN_ESI | CAN_REMOTE | CAN_EXTENDED };

static void deliver(const network_t *w, int32_t from, const frame_t *frame)
{
    for (int32_t i = 0; i < w->n_nodes; i++)
        if (i != from) ring_put(w->rx[i], frame);
}

void network_send(network_t *w, int32_t node, const frame_t *frame)
{
    bus_request_t r;
    if (!w->bus) {
        deliver(w, node, frame);
        return;
    }
    memset(&r, 0, sizeof r);
    r.at = frame->t_ns * PS > w->now_ps ? frame->t_ns * PS : w->now_ps;
    r.node = node;
    r.frame.id = frame->id;
    r.frame.flags = frame->flags & CAN_FLAGS;
    if (frame->length <= sizeof r.frame.data) {
        r.frame.length = (uint8_t)frame->length;
        memcpy(r.frame.data, frame->data, frame->length);
        if (w->request(w->bus, &r, 1)) return;
    }
    ++*w->refused[node];
}

/* An event of the bus: a frame that a node has received, or that a transmit queue has dropped. */
static void take(const network_t *w, const bus_event_t *e, const can_frame_t *frames)
{
    frame_t frame;
    if (e->kind == EVENT_DROPPED) ++*w->refused[e->node];
    if (e->kind != EVENT_RECEIVED) return;
    const can_frame_t *f = frames + e->frame;
    memset(&frame, 0, sizeof frame);
    frame.t_ns = (e->time + PS / 2) / PS;
    frame.id = f->id;
    frame.flags = f->flags;
    frame.length = f->length;
    memcpy(frame.data, f->data, sizeof f->data);
    ring_put(w->rx[e->node], &frame);
}

void network_advance(network_t *w, int64_t until_ns)
{
    bus_output_t *out = w->output;
    int32_t more = 1;
    if (!w->bus || until_ns * PS <= w->now_ps) return;
    while (more) {
        out->n_events = out->n_frames = w->room;
        more = w->advance(w->bus, until_ns * PS, out);
        for (int64_t i = 0; i < out->n_events; i++) take(w, out->events + i, out->frames);
    }
    w->now_ps = until_ns * PS;
}

int64_t network_next(const network_t *w)
{
    const int64_t next = w->bus ? w->next(w->bus) : INT64_MAX;
    return next == INT64_MAX ? next : (next + PS - 1) / PS;
}
