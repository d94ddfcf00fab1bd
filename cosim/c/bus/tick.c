/* tick.c: see tick.h. */
#include "tick.h"

#include <math.h>
#include <string.h>

/* The nearest integer of a type with this greatest value; beyond it, the greatest or the least. */
static int32_t whole(double value, double scale, double most)
{
    double found = nearbyint(value / scale);
    if (!(found > -most - 1.0)) found = -most - 1.0;
    return (int32_t)(found < most ? found : most);
}

static size_t store(const tick_frame_t *f, double value, uint8_t *data)
{
    uint64_t bits = 0;
    uint32_t small;
    float single = (float)value;
    size_t size = f->encoding == ENCODING_FLOAT64 ? 8 : f->encoding == ENCODING_INT16 ? 2 : 4;
    if (f->encoding == ENCODING_FLOAT64) {
        memcpy(&bits, &value, sizeof bits);
    } else if (f->encoding == ENCODING_FLOAT32) {
        memcpy(&small, &single, sizeof small);
        bits = small;
    } else {
        bits = (uint32_t)whole(value, f->scale, size == 2 ? 32767.0 : 2147483647.0);
    }
    for (size_t i = 0; i < size; i++) data[i] = (uint8_t)(bits >> 8 * i);
    return size;
}

int32_t bus_tick_send(void *context, int64_t tick, const double *signals)
{
    const tick_gate_t *gate = context;
    const tick_bus_t *b = gate->bus;
    tick_frame_t *f = &b->frames[gate->index];
    bus_request_t *r;
    size_t used = 0;
    if (f->count == f->room) return 1;
    r = &f->pending[(f->head + f->count++) % f->room];
    *r = *f->request;
    r->at = tick * b->step + f->offset;
    for (int32_t i = 0; i < f->n_places; i++) used += store(f, signals[f->places[i]], r->frame.data + used);
    return 0;
}

/* Receptions up to `until`. */
static void go_on(tick_bus_t *b, int64_t until)
{
    int32_t more = 1;
    while (more) {
        b->output.n_events = b->output.n_frames = b->room_events;
        more = bus_advance(b->bus, until, &b->output);
        for (int64_t i = 0; i < b->output.n_events; i++) {
            const bus_event_t *e = &b->output.events[i];
            if (e->request < 0) continue;
            for (int32_t j = 0; j < b->n_receivers; j++) {
                tick_receiver_t *r = &b->receivers[j];
                if (r->node == e->node && r->frame == b->frame_of[e->request] &&
                    b->sample_of[e->request] > r->held)
                    r->held = b->sample_of[e->request];
            }
        }
    }
}

/* The next request before `until`; of several at one time that of the first frame. NULL: none. */
static const bus_request_t *next(const tick_bus_t *b, int64_t until, int32_t *frame)
{
    const bus_request_t *found = NULL;
    if (b->next_known < b->n_known && b->known[b->next_known].at < until) {
        found = &b->known[b->next_known];
        *frame = b->owners[b->next_known];
    }
    for (int32_t i = 0; i < b->n_frames; i++) {
        const tick_frame_t *f = &b->frames[i];
        const bus_request_t *r = &f->pending[f->head];
        if (f->count && r->at < until &&
            (!found || r->at < found->at || (r->at == found->at && i < *frame))) {
            found = r;
            *frame = i;
        }
    }
    return found;
}

static int32_t give(tick_bus_t *b, const bus_request_t *r, int32_t frame)
{
    tick_frame_t *f = frame < b->n_frames ? &b->frames[frame] : NULL;
    if (b->n_requests == b->room) return 1;
    if (bus_request(b->bus, r, 1) == 0) { /* its node's inbox is full */
        go_on(b, r->at);
        if (bus_request(b->bus, r, 1) == 0) return 1;
    }
    b->frame_of[b->n_requests] = f ? frame : -1;
    b->sample_of[b->n_requests++] = f ? (int32_t)f->requested++ : -1;
    if (f && f->encoding != ENCODING_NONE) {
        f->head = f->head + 1 == f->room ? 0 : f->head + 1;
        f->count--;
    } else {
        b->next_known++;
    }
    return 0;
}

int32_t bus_tick_receive(void *context, int64_t tick, const double *signals)
{
    const tick_gate_t *gate = context;
    tick_bus_t *b = gate->bus;
    tick_receiver_t *receiver = &b->receivers[gate->index];
    const bus_request_t *request;
    int64_t until = tick * b->step;
    int32_t frame = 0;
    (void)signals;
    while ((request = next(b, until, &frame)))
        if (give(b, request, frame)) return 1;
    go_on(b, until);
    receiver->table[receiver->row++] = receiver->held;
    return 0;
}
