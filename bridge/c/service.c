/* service.c: what a node says besides its outlets: previews, heartbeats, SYNC, ESTOP; see node.h. */
#include "node.h"

#include <string.h>

enum { BOOTS = 4096 /* what a heartbeat can count to */, PASSED_ON = 10, ALARM_NS = 10000000 };

/* Before the start: what this node would send first, so that others can look at it. */
void node_preview(node_t *n, int64_t now_ns)
{
    for (int32_t i = 0; i < n->n_outlets; i++) {
        outlet_t *o = n->outlets + i;
        if (!tells_life(o->message)) continue;
        for (int32_t k = 0; k < o->width; k++) o->values[k] = n->signals[o->sources[k]];
        if (o->guard) memset(o->values + o->guarded, 0, (size_t)o->joints * sizeof(double));
        node_say(o, 0, now_ns);
        o->sent = 0;
    }
}

void node_heartbeat(node_t *n, int64_t now_ns)
{
    if (!n->heartbeat) return;
    const double v[HEARTBEAT_VALUES] = {n->life.state, n->life.reasons, n->boots % BOOTS, n->life.armed};
    for (int32_t b = 0; b < n->n_buses; b++) {
        frame_t frame;
        header_t header;
        memset(&frame, 0, sizeof frame);
        memset(&header, 0, sizeof header);
        header.counter = n->beats;
        header.status = n->simulated ? STATUS_SIMULATED : 0;
        if (n->life.reasons & WHY_ESTOP) header.status |= STATUS_ESTOP;
        if (n->life.reasons & WHY_STALE) header.status |= STATUS_STALE;
        message_encode(n->heartbeat, v, &header, &frame);
        node_send(n, b, &frame, now_ns);
    }
    n->beats++;
}

void node_sync(node_t *n, int64_t now_ns)
{
    const double counter = 1.0 + n->sync_count++ % 240;
    for (int32_t b = 0; b < n->n_buses; b++) {
        frame_t frame;
        header_t header;
        memset(&frame, 0, sizeof frame);
        memset(&header, 0, sizeof header);
        message_encode(n->sync, &counter, &header, &frame);
        node_send(n, b, &frame, now_ns);
    }
}

void node_estop(node_t *n, int64_t now_ns)
{
    for (int32_t b = 0; b < n->n_buses; b++) {
        frame_t frame;
        header_t header;
        const double by[2] = {n->number, n->life.reasons | WHY_ESTOP};
        memset(&frame, 0, sizeof frame);
        memset(&header, 0, sizeof header);
        message_encode(n->estop, by, &header, &frame);
        node_send(n, b, &frame, now_ns);
    }
}

void node_alarm(node_t *n, int64_t now_ns)
{
    if (!n->estop) return;
    if (!(n->life.reasons & WHY_ESTOP)) {
        n->alarms = -1;     /* none heard: the next is news */
        if (n->alarm == ALARM_OURS) n->alarm = ALARM_NONE; /* after RESET */
        return;
    }
    if (n->alarms < 0) {
        n->alarms = PASSED_ON;
        n->alarm_ns = now_ns;
    }
    if ((n->alarms > 0 || n->alarm == ALARM_OURS) && now_ns >= n->alarm_ns) {
        node_estop(n, now_ns);
        n->alarms -= n->alarms > 0;
        n->alarm_ns = now_ns + ALARM_NS;
    }
}
