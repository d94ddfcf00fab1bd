/* shutdown.c: how a node ends on the wall clock, with no torque left on the bus; see shutdown.h. */
#include "shutdown.h"

#include "bringup.h"
#include "dispatch.h"
#include "outlet.h"
#include "idle.h"
#include "service.h"

/* The message after the last one of the slots done. */
static int64_t next_of(const outlet_t *o)
{
    const int64_t slot = o->node->slot, apart = o->hit_ticks * o->every;
    return slot > 0 ? (slot - 1) / apart + 1 : 0;
}

/* Torques of an outlet, as they were sent last, times a factor. */
static void scale_torques(outlet_t *o, double factor)
{
    for (int32_t k = 0; k < o->joints; k++) {
        double *tau = o->values + o->guarded + k;
        *tau = factor > 0.0 ? *tau * factor : 0.0;
    }
}

void node_send_final(node_t *n)
{
    const int64_t now = pace_now() - n->start_ns;
    const int32_t at_once = n->life.state == LIFE_ACTIVE || n->life.state == LIFE_STOPPING;
    n->life.armed = 0;
    n->life.scale = 0.0;
    if (at_once) n->life.state = LIFE_STOPPING; /* in this state the drives take it */
    for (int32_t i = 0; i < n->n_outlets; i++) {
        if (!n->outlets[i].guard) continue;
        scale_torques(n->outlets + i, 0.0);
        outlet_send_sample(n->outlets + i, next_of(n->outlets + i), now);
    }
    if (n->n_commanded > 0) bringup_rest(n, now + n->start_ns);
    if (at_once) {
        n->life.state = LIFE_FAULT;
        n->life.reasons |= WHY_COMMAND;
    }
    node_heartbeat(n, now);
    n->host_due_ns = now;
    node_host(n, now);
}

static void send_scaled_torques(node_t *n, double factor)
{
    for (int32_t i = 0; i < n->n_outlets; i++) {
        outlet_t *o = n->outlets + i;
        if (!o->guard) continue;
        scale_torques(o, factor);
        if (n->slot % (o->hit_ticks * o->every) == 0)
            outlet_send_sample(o, n->slot / o->hit_ticks / o->every, pace_now() - n->start_ns);
    }
}

void node_ramp_down(node_t *n)
{
    n->life.now |= WHY_COMPONENT;
    do {
        const int64_t deadline = n->start_ns + n->phase_ns + n->slot * n->h_ns;
        const double before = n->life.scale;
        if (pace_now() < deadline) pace_wait(deadline, 0, &n->quit);
        if (n->n_commanded > 0) {
            node_hear(n, pace_now() - n->start_ns);
            bringup_watch(n, pace_now());
        }
        life_step(&n->life);
        send_scaled_torques(n, before > 0.0 ? n->life.scale / before : 0.0);
        if (n->heartbeat_slots > 0 && n->slot % n->heartbeat_slots == 0)
            node_heartbeat(n, pace_now() - n->start_ns);
        node_host(n, pace_now() - n->start_ns);
        n->slot++;
    } while (n->life.state == LIFE_STOPPING && !*(volatile int32_t *)&n->quit);
    node_send_final(n);
}

/* The last torque has held for as long as any other: then zero. */
static void hold_last(node_t *n)
{
    const int64_t end = n->start_ns + n->phase_ns + n->slots * n->h_ns;
    if (pace_now() < end) node_idle(n, end);
}

int32_t node_end(node_t *n)
{
    const int32_t done = n->slot >= n->slots;
    const int32_t well = n->life.state == LIFE_ACTIVE || (n->ending && n->life.state == LIFE_INACTIVE);
    if (done && well) {
        if (!n->ending) hold_last(n);
        n->life.state = LIFE_FINISHED;
    }
    node_send_final(n);
    if (!done) return LIVE_STOPPED;
    return well ? LIVE_FINISHED : LIVE_FAULT;
}
