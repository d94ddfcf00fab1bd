/* node_core.c - slots of a node at the times of its Tx_Clocks, and its buses; see core.h. */
#include <string.h>

#include "core.h"
#include "slot.h"

static const int64_t PS = 1000; /* in a ns */

/* --- in place of the parts of a node that know sockets and wall clocks ------------------------ */

int32_t bus_receive(bus_t *bus, frame_t *frame)
{
    ring_t *r = bus->rx;
    if (r->head == r->tail) return 0;
    *frame = r->frames[r->tail++ & (WAITING - 1)];
    bus->received++;
    return 1;
}

int32_t bus_send(bus_t *bus, frame_t *frame)
{
    ring_t *r = bus->tx;
    if (r->head - r->tail == WAITING) {
        bus->send_failed++;
        return 1;
    }
    r->frames[r->head++ & (WAITING - 1)] = *frame;
    bus->sent++;
    return 0;
}

int64_t pace_now(void) { return 0; }
int64_t pace_wait(int64_t deadline_ns, int64_t spin_ns, const volatile int32_t *stop)
{
    (void)spin_ns, (void)stop;
    return deadline_ns;
}
int64_t pace_date(void) { return 0; }

/* --- start ----------------------------------------------------------------------------------- */

size_t core_room(void) { return 0; }

/* A node with empty queues to and from its terminals. */
static void attach(fmu_t *x)
{
    portable_reset(&x->node);
    memset(x->received, 0, sizeof x->received);
    memset(x->sent, 0, sizeof x->sent);
    for (int32_t b = 0; b < N_BUSES; b++) {
        x->received[b].frames = x->received_frames[b], x->sent[b].frames = x->sent_frames[b];
        x->node.buses[b].rx = &x->received[b], x->node.buses[b].tx = &x->sent[b];
    }
}

fmi3Status core_begin(fmu_t *x)
{
    fmi3Status status = fmi3OK;
    attach(x);
    x->node.why = plan_begin(&x->node);
    if (x->node.why) return lsbus_refuse(x, "%s, at the start: %s", x->node.who, x->node.why);
    for (int32_t b = 0; b < N_BUSES && status == fmi3OK; b++) status = operation_rates(x, b);
    return status;
}

/* --- slots ----------------------------------------------------------------------------------- */

static int64_t deadline_ps(const node_t *n) { return (n->slot * n->h_ns + n->phase_ns) * PS; }

/* What the slot has sent on a bus, as operations. */
static fmi3Status hand_over(fmu_t *x, int32_t b, int64_t at)
{
    ring_t *r = &x->sent[b];
    fmi3Status status = fmi3OK;
    if (x->node.buses[b].send_failed)
        return lsbus_refuse(x, "t = %.12g s: found more than %d frames in one slot, expected fewer",
                            (double)at * 1e-9, (int)WAITING);
    for (; r->tail != r->head && status == fmi3OK; r->tail++)
        status = operation_send(x, b, &r->frames[r->tail & (WAITING - 1)]);
    return status;
}

static fmi3Status slot(fmu_t *x)
{
    node_t *n = &x->node.memory.node;
    const int64_t at = n->slot * n->h_ns + n->phase_ns;
    fmi3Status status = fmi3OK;
    if (node_slot(n, at, at, 0))
        return lsbus_refuse(x, "%s, t = %.12g s: %s", x->node.who, (double)at * 1e-9, x->node.why);
    for (int32_t b = 0; b < N_BUSES && status == fmi3OK; b++) status = hand_over(x, b, at);
    return status;
}

fmi3Status core_tick(fmu_t *x)
{
    while (deadline_ps(&x->node.memory.node) <= x->now) {
        const fmi3Status status = slot(x);
        if (status != fmi3OK) return status;
    }
    return fmi3OK;
}

/* A slot at `until` is executed when its clock ticks: a frame may arrive at this very time. */
fmi3Status core_go(fmu_t *x, int64_t until)
{
    while (deadline_ps(&x->node.memory.node) < until) {
        const fmi3Status status = slot(x);
        if (status != fmi3OK) return status;
    }
    x->now = until;
    return fmi3OK;
}

static fmi3Status take(fmu_t *x, int32_t b)
{
    port_t *p = &x->ports[b];
    const size_t n = p->n_rx;
    fmi3Status status = fmi3OK;
    p->n_rx = 0;
    for (size_t at = 0; at < n && status == fmi3OK;) {
        const size_t rest = n - at, said = rest < 8 ? 0 : number(p->rx + at + 4, 4);
        const size_t length = said >= 8 && said <= rest ? said : rest;
        status = operation_take(x, b, p->rx + at, length, (x->now + PS / 2) / PS);
        at += length;
    }
    return status;
}

fmi3Status core_settle(fmu_t *x)
{
    fmi3Status status = fmi3OK;
    for (int32_t b = 0; b < N_BUSES && status == fmi3OK; b++) status = take(x, b);
    return status;
}

void core_schedule(fmu_t *x)
{
    const int64_t next = deadline_ps(&x->node.memory.node);
    for (int32_t b = 0; b < N_BUSES; b++) {
        port_t *p = &x->ports[b];
        const int64_t tick = p->n_tx || next < x->now ? x->now : next;
        if (tick == p->tick) continue;
        p->tick = tick, p->changed = true;
    }
}

/* --- values ---------------------------------------------------------------------------------- */

size_t core_float64(fmu_t *x, fmi3ValueReference vr, const double **values)
{
    const fmi3ValueReference first = 4 * N_PORTS + 2;
    if (vr < first || vr >= first + N_OUTPUTS) return 0;
    *values = x->node.memory.seen + node_outputs[vr - first].from;
    return (size_t)node_outputs[vr - first].count;
}

bool core_boolean(fmu_t *x, fmi3ValueReference vr, fmi3Boolean *value)
{
    (void)x, (void)vr, (void)value;
    return false;
}
