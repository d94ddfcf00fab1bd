/* node_core.c - slots of a node at the times of its Tx_Clocks, and its buses; see core.h. */
#include <string.h>

#include "core.h"
#include "delay.h"
#include "faults.h"
#include "slot.h"

static const int64_t PS = 1000; /* in a ns */

/* --- in place of the parts of a node that know sockets, wall clocks and injected faults ------- */

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
void histogram_add(histogram_t *h, int64_t ns) { (void)h, (void)ns; }
void faults_put(faults_t *f, const frame_t *frame, int64_t start_ns, int32_t started)
{
    (void)f, (void)frame, (void)start_ns, (void)started;
}
int32_t faults_get(faults_t *f, frame_t *frame, int64_t now_ns)
{
    (void)f, (void)frame, (void)now_ns;
    return 0;
}

/* --- start ----------------------------------------------------------------------------------- */

size_t core_room(void) { return 0; }

/* A copy of the node as it starts, which points into itself. */
static void copy(memory_t *m)
{
    memcpy(m, &node_first, sizeof *m);
    for (size_t i = 0; i < N_POINTERS; i++) {
        char *at = (char *)m + node_pointers[i], *pointer;
        memcpy(&pointer, at, sizeof pointer);
        pointer = (char *)m + (pointer - (const char *)&node_first);
        memcpy(at, &pointer, sizeof pointer);
    }
}

static void attach(fmu_t *x)
{
    node_t *n = &x->memory.node;
    memset(x->buses, 0, sizeof x->buses);
    memset(x->received, 0, sizeof x->received);
    memset(x->sent, 0, sizeof x->sent);
    memset(&x->none, 0, sizeof x->none);
    for (int32_t b = 0; b < N_BUSES; b++) {
        bus_t *bus = &x->buses[b];
        x->received[b].frames = x->received_frames[b], x->sent[b].frames = x->sent_frames[b];
        bus->kind = BUS_MEMORY, bus->number = (uint32_t)b;
        bus->rx = &x->received[b], bus->tx = &x->sent[b];
        x->has_pending[b] = 0;
    }
    n->buses = x->buses, n->pending = x->pending, n->has_pending = x->has_pending;
    x->record_row = 0, x->record = NULL;
    n->journal = &x->none, n->record = &x->record, n->record_row = &x->record_row;
    n->engine = x, n->run = plan_run, n->signals = x->memory.signals;
    for (int32_t i = 0; i < n->n_inlets; i++) delay_reset(n->inlets[i].delay);
}

fmi3Status core_begin(fmu_t *x)
{
    fmi3Status status = fmi3OK;
    copy(&x->memory);
    attach(x);
    x->why = plan_begin(x);
    if (x->why) return lsbus_refuse(x, "%s, at the start: %s", x->who, x->why);
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
    if (x->buses[b].send_failed)
        return lsbus_refuse(x, "t = %.12g s: found more than %d frames in one slot, expected fewer",
                            (double)at * 1e-9, (int)WAITING);
    for (; r->tail != r->head && status == fmi3OK; r->tail++)
        status = operation_send(x, b, &r->frames[r->tail & (WAITING - 1)]);
    return status;
}

static fmi3Status slot(fmu_t *x)
{
    node_t *n = &x->memory.node;
    const int64_t at = n->slot * n->h_ns + n->phase_ns;
    fmi3Status status = fmi3OK;
    if (node_slot(n, at, at, 0))
        return lsbus_refuse(x, "%s, t = %.12g s: %s", x->who, (double)at * 1e-9, x->why);
    for (int32_t b = 0; b < N_BUSES && status == fmi3OK; b++) status = hand_over(x, b, at);
    return status;
}

fmi3Status core_tick(fmu_t *x)
{
    while (deadline_ps(&x->memory.node) <= x->now) {
        const fmi3Status status = slot(x);
        if (status != fmi3OK) return status;
    }
    return fmi3OK;
}

/* A slot at `until` is executed when its clock ticks: a frame may arrive at this very time. */
fmi3Status core_go(fmu_t *x, int64_t until)
{
    while (deadline_ps(&x->memory.node) < until) {
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
    const int64_t next = deadline_ps(&x->memory.node);
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
    *values = x->memory.seen + node_outputs[vr - first].from;
    return (size_t)node_outputs[vr - first].count;
}

bool core_boolean(fmu_t *x, fmi3ValueReference vr, fmi3Boolean *value)
{
    (void)x, (void)vr, (void)value;
    return false;
}
