/* reception.c: decodes and checks a frame of a received message and puts it into delay lines; see
 * reception.h. */
#include "reception.h"

#include <string.h>

#include "forward.h"
#include "sample_journal.h"

/* Nominal time of sending of sample j: slots are kept, so this is when it was sampled. */
static int64_t sampled(const reception_t *r, int64_t j) { return j * r->period_ns + r->offset_ns; }

/* Whether this signal is an encoder of a guard, and has moved further than it can. */
static int32_t jumped(const node_t *n, int64_t signal, double moved)
{
    for (int32_t i = 0; i < n->n_outlets; i++) {
        const outlet_t *o = n->outlets + i;
        const int64_t k = signal - o->q;
        if (!o->guard || !o->guard->q_jump || o->q < 0 || k < 0 || k >= o->joints) continue;
        if (!(moved <= o->guard->q_jump[k] && moved >= -o->guard->q_jump[k])) return 1;
    }
    return 0;
}

/* Values of a sender that does not run yet. Real arms start from them; a rehearsal starts from the
 * scenario's values, like its twin. Encoder values that jump between two previews are rejected. */
static void preview(node_t *n, reception_t *r)
{
    for (int32_t i = 0; i < n->n_inlets; i++) {
        inlet_t *in = n->inlets + i;
        if (in->reception != r || in->drive) continue;
        for (int32_t k = 0; k < in->count; k++) {
            const double x = in->gain * r->values[in->first + k] + in->offset;
            if (r->previewed_ns >= 0 && jumped(n, in->target + k, x - in->initial[k]))
                n->life.now |= WHY_JUMP;
            in->initial[k] = x;
            if (!n->simulated) n->signals[in->target + k] = x;
        }
    }
}

/* Whether it is a sample of the run: by the state of its sender, or else what comes from t = 0 on. */
static int32_t is_of_run(const node_t *n, const reception_t *r, const header_t *header, int64_t t)
{
    if (!tells_life(r->message)) return node_started(n) && t >= 0;
    const int32_t life = (int32_t)(header->status & STATUS_LIFE);
    return life != LIFE_UNCONFIGURED && life != LIFE_INACTIVE;
}

/* Out of range is counted apart before the start: drives with their own protocols answer in frames of the
 * same identifier then, when they are configured. */
static void out_of_range(const node_t *n, reception_t *r)
{
    ++*(n->begun ? &r->receiver->range : &r->early_range);
}

static int32_t refuse_frame(const node_t *n, reception_t *r, const frame_t *frame, header_t *header,
                            double *values)
{
    const int32_t result = message_decode(r->message, frame, values, header);
    switch (result) {
    case DECODE_OK: break;
    case DECODE_LENGTH: r->receiver->length++; return 1;
    case DECODE_CRC: r->receiver->crc++; return 1;
    case DECODE_INVALID: r->receiver->invalid++; return 1;
    default: out_of_range(n, r); return 1;
    }
    if (r->message->status >= 0 && header->status & STATUS_SIMULATED && !r->accept_simulated) {
        r->receiver->simulated++;
        return 1;
    }
    if (limits_range(r->limits, r->width, values)) return 0;
    out_of_range(n, r);
    return 1;
}

/* Whether it is further from the last sample than it can come in the time since, or in a period. */
static int32_t too_fast(const reception_t *r, const double *values, int64_t t)
{
    const int64_t since = t - r->arrival_ns < r->period_ns ? r->period_ns : t - r->arrival_ns;
    return r->newest >= 0 && !limits_rate(r->limits, r->width, values, r->values, (double)since * 1e-9);
}

static void keep_values(reception_t *r, const double *values)
{
    memcpy(r->values, values, (size_t)r->width * sizeof *values);
}

/* Torque of a node in FAULT is 0 and does not reset the watchdog: a drive that receives nothing else
 * brakes. */
static int32_t torque_of_fault(const node_t *n, const reception_t *r, const header_t *header)
{
    if (r->message->status < 0 || (header->status & STATUS_LIFE) != LIFE_FAULT) return 0;
    for (int32_t i = 0; i < n->n_inlets; i++)
        if (n->inlets[i].reception == r && n->inlets[i].drive) return 1;
    return 0;
}

/* A sample tells the state of its sender sooner than its heartbeat. */
static void take_fault(node_t *n, const reception_t *r, const header_t *header)
{
    if (!tells_life(r->message) || (header->status & STATUS_LIFE) != LIFE_FAULT) return;
    for (int32_t i = 0; i < n->n_peers; i++)
        if ((int32_t)n->peers[i].number == r->sender) n->peers[i].state = LIFE_FAULT;
}

void reception_take(node_t *n, reception_t *r, const frame_t *frame)
{
    header_t header;
    double values[MESSAGE_FIELDS];
    memset(&header, 0, sizeof header);
    if (refuse_frame(n, r, frame, &header, values)) return;
    const int64_t t = frame->t_ns - n->start_ns;
    if (!is_of_run(n, r, &header, t)) {
        keep_values(r, values);
        if (!n->begun) preview(n, r);
        r->previewed_ns = frame->t_ns;
        if (tells_life(r->message)) node_forward(n, r, &header, frame);
        return;
    }
    if (!node_started(n)) {
        r->early++;
        r->early_life = (int32_t)(header.status & STATUS_LIFE);
        r->early_ns = frame->t_ns - (int64_t)header.t_us * 1000;
        return;
    }
    if (too_fast(r, values, t)) {
        r->receiver->rate++;
        return;
    }
    const int64_t j = receiver_accept(r->receiver, &header, t);
    if (j < 0) return;
    take_fault(n, r, &header);
    r->transit_ns = t - r->receiver->sampled_ns;
    if (r->max_age_ns > 0 && r->transit_ns > r->max_age_ns) {
        r->receiver->stale++;
        return;
    }
    keep_values(r, values);
    if (j > r->newest && r->n_forwards > 0) {
        header.counter = (uint32_t)j;
        header.t_us = (uint32_t)(r->receiver->sampled_ns / 1000);
        node_forward(n, r, &header, frame);
    }
    if (torque_of_fault(n, r, &header)) {
        r->of_fault = 1;
    } else if (j > r->newest) {
        r->newest = j;
        r->arrival_ns = t;
    }
    node_heard(n, r, j, t, header.status);
    for (int32_t i = 0; i < n->n_inlets; i++)
        if (n->inlets[i].reception == r)
            delay_put(n->inlets[i].delay, j, sampled(r, j), t, r->values + n->inlets[i].first);
}
