/* dispatch.c: reception of frames, each dispatched to its receiver; see dispatch.h. */
#include "dispatch.h"

#include <string.h>

#include "bringup.h"
#include "emulated.h"
#include "forward.h"
#include "reception.h"
#include "run_epoch.h"
#include "service.h"

/* On a bus without protection every data frame with its identifier is an emergency stop, classic or
 * CAN FD, of any length and from any sender, because stopping is safe. A remote frame is not an emergency
 * stop, nor is a frame whose identifier has the other size. With protection, a message of another sender
 * that the network has delivered under this name is not an emergency stop. */
int32_t node_is_estop(const node_t *n, const frame_t *frame)
{
    double v[ESTOP_VALUES];
    header_t header;
    const message_t *m = n->services[frame->bus].estop;
    if (!m) return 0;
    const accept_t any = {m->id, UINT32_MAX, m->flags & FRAME_EXTENDED, FRAME_FORMAT & ~FRAME_FD};
    if (!frame_accepted(&any, frame)) return 0;
    return m->e2e == E2E_NONE || message_decode(m, frame, v, &header) == DECODE_OK;
}

/* An emergency stop. It reaches all that a gateway joins before this node has its next slot. */
static void take_estop(node_t *n, int64_t t)
{
    const int32_t news = !((n->life.now | n->life.reasons) & WHY_ESTOP);
    n->life.now |= WHY_ESTOP;
    if (news && n->gateway) node_estop(n, t);
}

static int32_t command_of(int32_t nmt)
{
    switch (nmt) {
    case NMT_START: return COMMAND_START;
    case NMT_STOP: return COMMAND_STOP;
    case NMT_ARM: return COMMAND_ARM;
    case NMT_RESET: return COMMAND_RESET;
    default: return COMMAND_NONE;
    }
}

static int32_t command_for(const node_t *n, const double *v)
{
    if (v[NMT_NODE] != 0.0 && (int32_t)v[NMT_NODE] != n->number) return COMMAND_NONE;
    return command_of((int32_t)v[NMT_COMMAND]);
}

int32_t node_told_by(const node_t *n, const frame_t *frame)
{
    double v[NMT_VALUES];
    header_t header;
    const message_t *m = n->services[frame->bus].nmt;
    if (!m || !message_is(m, frame) || message_decode(m, frame, v, &header) != DECODE_OK) return COMMAND_NONE;
    return command_for(n, v);
}

static void managed(node_t *n, const frame_t *frame)
{
    double v[NMT_VALUES];
    header_t header;
    memset(&header, 0, sizeof header);
    if (message_decode(n->services[frame->bus].nmt, frame, v, &header) != DECODE_OK) {
        n->damaged++;
        return;
    }
    if (n->gateway) node_pass(n, offsetof(services_t, nmt), v, header, frame);
    const int32_t command = command_for(n, v);
    n->late_starts += command == COMMAND_START && n->begun;
    if (command == COMMAND_START) n->nmt_ns = node_origin(n, frame->t_ns, EPOCH_LEAD_NS);
    if (command != COMMAND_NONE) n->life.commands = commands_add(n->life.commands, command);
}

/* A peer that has begun again may count anew. */
static void forget(node_t *n, const peer_t *peer)
{
    for (int32_t i = 0; i < n->n_receptions; i++)
        if (n->receptions[i].sender == (int32_t)peer->number) n->receptions[i].receiver->sequence = -1;
}

/* With real drives, a peer that is marked as simulated does not count as a peer. Before the start, its
 * time of reception on the clock is used. */
static void take_heartbeat(node_t *n, int32_t i, const frame_t *frame, int64_t t)
{
    double v[HEARTBEAT_VALUES];
    header_t header;
    peer_t *peer = n->peers + i;
    memset(&header, 0, sizeof header);
    if (message_decode(n->services[frame->bus].peers[i], frame, v, &header) != DECODE_OK) {
        n->damaged++;
        return;
    }
    peer->heard++;
    if (!n->simulated && header.status & STATUS_SIMULATED) return;
    const uint32_t boots = (uint32_t)v[HEARTBEAT_BOOTS];
    if (peer->state >= 0 && boots != peer->boots) forget(n, peer);
    n->life.now |= peer_heartbeat(peer, (int32_t)v[HEARTBEAT_LIFE], boots, t);
    n->epoch.asked |= n->begun && peer->state == LIFE_INACTIVE;
    if (!n->begun) peer->heartbeat.last_ns = frame->t_ns;
}

static int32_t heartbeat(node_t *n, const frame_t *frame, int64_t t)
{
    for (int32_t i = 0; i < n->n_peers; i++) {
        const message_t *m = n->services[frame->bus].peers[i];
        if (!m || !message_is(m, frame)) continue;
        take_heartbeat(n, i, frame, t);
        return 1;
    }
    return 0;
}

static void take_sync(node_t *n, const frame_t *frame, int64_t t)
{
    double v[1];
    header_t header;
    if (message_decode(n->services[frame->bus].sync, frame, v, &header) != DECODE_OK) {
        n->damaged++;
        return;
    }
    const int32_t counter = (int32_t)v[0];
    if (n->sync_last > 0) {
        const int32_t gap = (counter - n->sync_last + 240) % 240;
        if (gap > 1) n->syncs_lost += gap - 1;
    }
    n->sync_last = counter;
    n->syncs_received++;
    watchdog_feed(&n->sync_watchdog, t);
}

/* A frame that asks a drive for something may be a torque as well. */
static int32_t readable(const reception_t *r, const frame_t *frame)
{
    double values[MESSAGE_FIELDS];
    header_t header;
    return message_decode(r->message, frame, values, &header) == DECODE_OK;
}

/* A frame of no message; of the identifier of one, it has another format. */
static void misfit(node_t *n, const frame_t *frame)
{
    n->unknown++;
    for (int32_t i = 0; i < n->n_receptions; i++) {
        const message_t *m = n->receptions[i].message;
        const accept_t any = {m->id, UINT32_MAX, m->flags & FRAME_EXTENDED, FRAME_EXTENDED};
        if (n->receptions[i].bus == frame->bus && frame_accepted(&any, frame)) n->receptions[i].misfits++;
    }
}

static void dispatch(node_t *n, const frame_t *frame)
{
    const int64_t t = node_started(n) ? frame->t_ns - n->start_ns : 0;
    const services_t *s = n->services + frame->bus;
    const int32_t asked = emulated_hear(n, frame), told = bringup_hear(n, frame);
    if (told == HEARD_ANSWER) return; /* as a position it would be out of range */
    for (int32_t i = 0; i < n->n_receptions; i++) {
        reception_t *r = n->receptions + i;
        if (r->bus != frame->bus || !message_is(r->message, frame)) continue;
        if (!asked || readable(r, frame)) reception_take(n, r, frame);
        return;
    }
    if (asked || told) return;
    if (node_is_estop(n, frame)) take_estop(n, t);
    else if (s->nmt && message_is(s->nmt, frame)) managed(n, frame);
    else if (s->epoch && message_is(s->epoch, frame)) node_epoch_heard(n, frame);
    else if (s->sync && message_is(s->sync, frame)) take_sync(n, frame, t);
    else if (!heartbeat(n, frame, t)) misfit(n, frame);
}

void node_hear(node_t *n, int64_t limit_ns)
{
    frame_t frame;
    for (int32_t b = 0; b < n->n_buses; b++) {
        for (;;) {
            if (!n->has_pending[b]) n->has_pending[b] = bus_receive(n->buses + b, n->pending + b);
            if (!n->has_pending[b]) break;
            if (node_started(n) && n->pending[b].t_ns - n->start_ns > limit_ns) {
                bus_leave(n->buses + b);
                break;
            }
            n->has_pending[b] = 0;
            n->pending[b].bus = (uint8_t)b;
            if (n->faults) faults_put(n->faults, n->pending + b, n->start_ns, node_started(n));
            else dispatch(n, n->pending + b);
        }
    }
    while (n->faults && faults_get(n->faults, &frame, n->start_ns + limit_ns)) dispatch(n, &frame);
}
