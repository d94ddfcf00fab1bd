/* service.c: previews, heartbeats, SYNC and ESTOP of a node; see service.h. */
#include "service.h"

#include <string.h>

#include "outlet.h"
#include "send.h"

enum { BOOTS = 4096 /* what a heartbeat can count to */, PASSED_ON = 10, ALARM_NS = 10000000 };

/* Before the start: previews of this node's first messages for other nodes. */
void node_preview(node_t *n, int64_t now_ns)
{
    for (int32_t i = 0; i < n->n_outlets; i++) {
        outlet_t *o = n->outlets + i;
        if (tells_life(o->message)) outlet_tell(o, now_ns);
    }
}

void node_heartbeat(node_t *n, int64_t now_ns)
{
    const double v[HEARTBEAT_VALUES] = {n->life.state, n->life.reasons, n->boots % BOOTS, n->life.armed};
    header_t header = {n->beats++, n->simulated ? STATUS_SIMULATED : 0, 0, 0};
    if (n->life.reasons & WHY_ESTOP) header.status |= STATUS_ESTOP;
    if (n->life.reasons & WHY_STALE) header.status |= STATUS_STALE;
    for (int32_t b = 0; b < n->n_buses; b++) node_service(n, b, n->services[b].heartbeat, v, header, now_ns);
}

/* UNCONFIGURED: boot-up; INACTIVE: pre-operational; ACTIVE, STOPPING: operational; else: stopped. */
static double canopen_state(int32_t life)
{
    switch (life) {
    case LIFE_UNCONFIGURED: return 0x00;
    case LIFE_INACTIVE: return 0x7F;
    case LIFE_ACTIVE:
    case LIFE_STOPPING: return 0x05;
    default: return 0x04;
    }
}

API void node_host(node_t *n, int64_t now_ns)
{
    const double state = canopen_state(n->life.state);
    const header_t header = {0, 0, 0, 0};
    if (n->host_ns <= 0 || now_ns < n->host_due_ns) return;
    n->host_due_ns += n->host_ns;
    if (n->host_due_ns <= now_ns) n->host_due_ns = now_ns + n->host_ns;
    for (int32_t b = 0; b < n->n_buses; b++)
        node_service(n, b, n->services[b].host_heartbeat, &state, header, now_ns);
}

static void send_host_sync(node_t *n, int32_t bus, int64_t now_ns)
{
    const double nothing = 0.0;
    const header_t header = {0, 0, 0, 0};
    node_service(n, bus, n->services[bus].host_sync, &nothing, header, now_ns);
}

void node_host_sync(node_t *n, int64_t now_ns)
{
    for (int32_t b = 0; b < n->n_buses; b++)
        if (n->services[b].host_sync && n->slot % n->services[b].host_sync_slots == 0)
            send_host_sync(n, b, now_ns);
}

API void node_host_sync_early(node_t *n, int64_t now_ns)
{
    for (int32_t b = 0; b < n->n_buses; b++) {
        const services_t *s = n->services + b;
        const int64_t period_ns = s->host_sync_slots * n->h_ns;
        if (!s->host_sync || now_ns / period_ns == n->host_sync_ns / period_ns) continue;
        send_host_sync(n, b, now_ns);
    }
    n->host_sync_ns = now_ns;
}

void node_sync(node_t *n, int64_t now_ns)
{
    const double counter = 1.0 + n->sync_count++ % 240;
    const header_t header = {0, 0, 0, 0};
    for (int32_t b = 0; b < n->n_buses; b++)
        node_service(n, b, n->services[b].sync, &counter, header, now_ns);
}

void node_estop(node_t *n, int64_t now_ns)
{
    const double by[ESTOP_VALUES] = {n->number, n->life.reasons | WHY_ESTOP};
    const header_t header = {0, 0, 0, 0};
    for (int32_t b = 0; b < n->n_buses; b++) node_service(n, b, n->services[b].estop, by, header, now_ns);
}

void node_alarm(node_t *n, int64_t now_ns)
{
    if (!(n->life.reasons & WHY_ESTOP)) {
        n->alarms = -1;                                    /* none received: the next one is new */
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
