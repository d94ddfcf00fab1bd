/* outlet.c: outputs of a component: torques guarded, values encoded and sent; see outlet.h. */
#include "outlet.h"

#include <string.h>

#include "emulated.h"
#include "forward.h"
#include "send.h"

static void guarded(outlet_t *o, const double *signals)
{
    node_t *n = o->node;
    double out[SAFETY_JOINTS];
    guard_apply(o->guard, o->values + o->guarded, o->q < 0 ? 0 : signals + o->q,
                o->dq < 0 ? 0 : signals + o->dq, n->life.scale, out);
    memcpy(o->values + o->guarded, out, (size_t)o->joints * sizeof *out);
    n->life.now |= guard_why(o->guard);
}

static uint32_t status(const node_t *n, const outlet_t *o)
{
    /* from its start on, it sends samples, also after a stop */
    const int32_t idle = n->begun && n->life.state == LIFE_INACTIVE;
    uint32_t s = (uint32_t)(idle ? LIFE_STOPPING : n->life.state) & STATUS_LIFE;
    if (n->life.armed) s |= STATUS_DEADMAN;
    if (n->life.reasons & WHY_ESTOP) s |= STATUS_ESTOP;
    if (o->guard && o->guard->bits) s |= STATUS_SATURATED;
    if (n->life.reasons & WHY_STALE) s |= STATUS_STALE;
    return n->simulated ? s | STATUS_SIMULATED : s;
}

/* As the drive's encoders see it; of what the message does not carry there is nothing to see. */
static void measured(outlet_t *o)
{
    double none[SAFETY_JOINTS] = {0};
    double *q = o->measured_q < 0 ? none : o->values + o->measured_q;
    double *dq = o->measured_dq < 0 ? none : o->values + o->measured_dq;
    drive_measure(o->drive, q, dq, q, dq);
}

/* Whether its drive, if it commands one, is given torques. */
static int32_t serves(const outlet_t *o) { return !o->commanded || o->commanded->phase == DRIVE_SERVING; }

/* Whether this node was stopped because a drive of our own protocol, which takes its torque, is off. */
static int32_t drive_is_off(const outlet_t *o) { return !o->commanded && o->node->life.reasons & WHY_DRIVE; }

static void gather(outlet_t *o, const double *signals)
{
    for (int32_t k = 0; k < o->width; k++) o->values[k] = signals[o->sources[k]];
    if (o->drive) measured(o);
    if (o->guard && !serves(o)) guard_forget(o->guard);
    if (o->guard) guarded(o, signals);
    if (o->guard && drive_is_off(o)) memset(o->values + o->guarded, 0, (size_t)o->joints * sizeof *o->values);
    if (!serves(o)) memset(o->values, 0, (size_t)o->width * sizeof *o->values);
}

/* What was sent, as its receivers see it. */
static void remember(outlet_t *o, const frame_t *frame, int64_t sequence)
{
    history_t *h = o->history;
    header_t header;
    const int64_t i = sequence - h->first;
    if (i < 0 || i >= h->capacity) return;
    if (message_decode(o->message, frame, h->values + i * h->width, &header) != DECODE_OK) return;
    h->there[i] = SAMPLE_THERE;
    for (int64_t k = 0; k < o->n_forwards; k++) forward_remember(o->forwards + k, i);
}

void outlet_send_sample(outlet_t *o, int64_t sequence, int64_t now_ns)
{
    node_t *n = o->node;
    frame_t frame;
    header_t header;
    if (!serves(o)) return; /* some would take a torque for a request to be enabled */
    if (o->motor && !emulated_owes(o)) return;
    memset(&frame, 0, sizeof frame);
    memset(&header, 0, sizeof header);
    header.counter = (uint32_t)sequence;
    header.status = status(n, o);
    header.t_us = (uint32_t)((sequence * o->every * o->hit_ticks * n->h_ns + n->phase_ns) / 1000);
    message_encode(o->message, o->values, &header, &frame);
    o->sent++;
    o->saturated += header.saturated != 0;
    if (o->history) remember(o, &frame, sequence);
    if (n->clock == CLOCK_WALL && n->start_ns) frame.t_ns = n->start_ns + now_ns;
    if (n->clock == CLOCK_REPLAY) return;
    if (o->motor) emulated_say(o, &frame, now_ns);
    else node_send(n, o->bus, &frame, now_ns);
}

void outlet_tell(outlet_t *o, int64_t now_ns)
{
    for (int32_t k = 0; k < o->width; k++) o->values[k] = o->node->signals[o->sources[k]];
    if (o->guard) memset(o->values + o->guarded, 0, (size_t)o->joints * sizeof(double));
    outlet_send_sample(o, 0, now_ns);
    o->sent = 0;
}

API int32_t outlet_pass(void *context, int64_t tick, double *signals)
{
    outlet_t *o = context;
    node_t *n = o->node;
    const int64_t hit = n->slot / o->hit_ticks;
    (void)tick;

    gather(o, signals);
    if (hit % o->every) return 0;
    const int64_t began = n->clock == CLOCK_WALL ? pace_now() : 0;
    outlet_send_sample(o, hit / o->every,
                       n->clock == CLOCK_WALL ? began - n->start_ns : n->now_ns + n->phase_ns);
    if (n->clock == CLOCK_WALL) n->send_ns += pace_now() - began;
    return 0;
}

API int32_t inside_pass(void *context, int64_t tick, double *signals)
{
    const inside_t *x = context;
    node_t *n = x->node;
    double out[SAFETY_JOINTS];
    (void)tick;
    guard_apply(x->guard, signals + x->tau, x->q < 0 ? 0 : signals + x->q, x->dq < 0 ? 0 : signals + x->dq,
                n->life.scale, out);
    memcpy(signals + x->tau, out, (size_t)x->guard->joints * sizeof *out);
    n->life.now |= guard_why(x->guard);
    return 0;
}
