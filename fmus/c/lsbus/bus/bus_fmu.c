/* bus_fmu.c - what the bus does with operations, and what it tells the nodes. */
#include "core.h"

#include <string.h>

enum { RETRANSMIT = 1, DISCARD = 2, BUS_OFF = 3 };
/* Something that waits is sent or fails within this time; idle buses are simulated no longer. */
static const int64_t HORIZON = 1000000000000;
static const int64_t SECOND = 1000000000000;

static fmi3Status refuse_node(fmu_t *x, int32_t node, const char *why)
{
    return lsbus_refuse(x, "Node%d, t = %.12g s: %s", (int)node + 1, (double)x->now / (double)SECOND, why);
}

/* --- operations as bytes --------------------------------------------------------------------- */

/* The header of an operation for a node; false: no room. */
static bool head(fmu_t *x, int32_t node, uint32_t code, size_t length)
{
    return put_head(&x->ports[node], code, length);
}

static fmi3Status append(fmu_t *x, int32_t node, const uint8_t *bytes, size_t n)
{
    port_t *p = &x->ports[node];
    memcpy(p->tx + p->n_tx, bytes, n);
    p->n_tx += n;
    return fmi3OK;
}

static fmi3Status full(fmu_t *x, int32_t node)
{
    return refuse_node(x, node,
                       "found more operations for it than fit, expected its Tx_Clock to"
                       " tick when it said");
}

static fmi3Status tell(fmu_t *x, int32_t node, uint32_t code, uint32_t id)
{
    if (!head(x, node, code, 12)) return full(x, node);
    put(&x->ports[node], id, 4);
    return fmi3OK;
}

static fmi3Status tell_frame(fmu_t *x, int32_t node, const can_frame_t *f)
{
    const bool fd = f->flags & CAN_FD;
    const size_t n = (size_t)f->length;
    port_t *p = &x->ports[node];
    uint8_t data[64] = {0};
    if (!head(x, node, fd ? OP_FD_TRANSMIT : OP_TRANSMIT, (fd ? 17u : 16u) + n)) return full(x, node);
    put(p, f->id, 4), put(p, !!(f->flags & CAN_EXTENDED), 1);
    if (fd) put(p, !!(f->flags & CAN_BRS), 1), put(p, !!(f->flags & CAN_ESI), 1);
    else put(p, !!(f->flags & CAN_REMOTE), 1);
    put(p, (uint32_t)n, 2);
    if (!(f->flags & CAN_REMOTE)) memcpy(data, f->data, n);
    return append(x, node, data, n);
}

static fmi3Status send_back(fmu_t *x, int32_t node, const uint8_t *raw, size_t n)
{
    if (n > 0xffff || !head(x, node, OP_FORMAT_ERROR, 10 + n)) return full(x, node);
    put(&x->ports[node], (uint32_t)n, 2);
    return append(x, node, raw, n);
}

/* --- what nodes send ------------------------------------------------------------------------- */

static void forget(fmu_t *x, int64_t request)
{
    for (int32_t i = 0; i < x->n_waiting; i++)
        if (x->waiting[i].request == request) x->waiting[i--] = x->waiting[--x->n_waiting];
}

/* The frame of a transmit operation; false: these bytes are none. */
static bool frame_of(const uint8_t *raw, size_t n, bool fd, can_frame_t *f)
{
    transmit_t of;
    if (!transmit_of(raw, n, fd, &of)) return false;
    memset(f, 0, sizeof *f);
    f->id = of.id, f->length = (uint8_t)of.length;
    f->flags = (uint8_t)((fd ? CAN_FD : 0) | (of.extended ? CAN_EXTENDED : 0) | (of.esi ? CAN_ESI : 0));
    if (of.second) f->flags |= fd ? CAN_BRS : CAN_REMOTE;
    if (!(f->flags & CAN_REMOTE)) memcpy(f->data, raw + of.first, of.length);
    return !fd || can_padded(f->flags, f->length) == (int32_t)of.length;
}

static fmi3Status transmit(fmu_t *x, int32_t node, const can_frame_t *f)
{
    bus_request_t request;
    if ((f->flags & CAN_FD) && !WITH_FD)
        return refuse_node(x, node,
                           "found CAN FD Transmit, expected CAN Transmit: the bus has no"
                           " data bit rate");
    if (x->off[node]) return refuse_node(x, node, "found a frame after the status BUS_OFF, expected none");
    if (x->n_waiting == N_NODES * QUEUE)
        return refuse_node(x, node, "found a frame more than fits, expected fewer");
    memset(&request, 0, sizeof request);
    request.at = x->now, request.node = node, request.frame = *f;
    if (bus_request(x->bus, &request, 1) != 1)
        return refuse_node(x, node, "found more frames at one time than fit, expected fewer");
    x->waiting[x->n_waiting++] = (bus_waiting_t){x->requests++, f->id, node};
    return fmi3OK;
}

/* 1: carried out; 0: these bytes are no configuration; -1: one that this bus does not have. */
static int configure(fmu_t *x, int32_t node, const uint8_t *raw, size_t n)
{
    if (n == 10 && raw[8] == LOST_BEHAVIOR && raw[9] >= RETRANSMIT && raw[9] <= DISCARD) {
        x->discards[node] = raw[9] == DISCARD;
        return 1;
    }
    if (n != 13 || raw[8] < CAN_BAUDRATE || raw[8] > CAN_XL_BAUDRATE) return 0;
    const uint32_t rate = number(raw + 9, 4);
    if (raw[8] == CAN_BAUDRATE) return rate == BITRATE ? 1 : -1;
    return WITH_FD && raw[8] == CAN_FD_BAUDRATE && rate == DATA_BITRATE ? 1 : -1;
}

static void set_status(fmu_t *x, int32_t node, uint8_t status)
{
    x->off[node] = status == BUS_OFF;
    for (int32_t i = 0; i < x->n_waiting && status == BUS_OFF; i++)
        if (x->waiting[i].node == node) bus_abort(x->bus, node, x->waiting[i].request);
}

static fmi3Status take(fmu_t *x, int32_t node, const uint8_t *raw, size_t n)
{
    const uint32_t code = number(raw, 4);
    can_frame_t frame;
    fmi3Status status = fmi3OK;
    int done;
    switch (code) {
    case OP_TRANSMIT:
    case OP_FD_TRANSMIT:
        if (!frame_of(raw, n, code == OP_FD_TRANSMIT, &frame)) break;
        return transmit(x, node, &frame);
    case OP_CONFIGURATION:
        done = configure(x, node, raw, n);
        if (done < 0)
            return refuse_node(x, node,
                               "found a Configuration with another bit rate than that of"
                               " the bus, expected the same");
        if (!done) break;
        return fmi3OK;
    case OP_STATUS:
        if (n != 9 || raw[8] < 1 || raw[8] > BUS_OFF) break;
        set_status(x, node, raw[8]);
        return fmi3OK;
    case OP_WAKEUP:
        if (n != 8) break;
        for (int32_t i = 0; i < N_NODES && status == fmi3OK; i++)
            if (i != node && !head(x, i, OP_WAKEUP, 8)) status = full(x, i);
        return status;
    case OP_FORMAT_ERROR: return fmi3OK;
    case OP_CONFIRM:
    case OP_LOST:
    case OP_BUS_ERROR: return refuse_node(x, node, "found an operation of a bus, expected one of a node");
    }
    return send_back(x, node, raw, n);
}

fmi3Status core_settle(fmu_t *x)
{
    for (int32_t node = 0; node < N_NODES; node++) {
        port_t *p = &x->ports[node];
        size_t at = 0, n = p->n_rx;
        p->n_rx = 0;
        while (at < n) {
            const size_t rest = n - at;
            const size_t said = rest < 8 ? 0 : number(p->rx + at + 4, 4);
            const bool whole = said >= 8 && said <= rest;
            const fmi3Status status =
                whole ? take(x, node, p->rx + at, said) : send_back(x, node, p->rx + at, rest);
            if (status != fmi3OK) return status;
            at += whole ? said : rest;
        }
    }
    return fmi3OK;
}

/* --- what the bus tells them ----------------------------------------------------------------- */

static fmi3Status fault(fmu_t *x, const bus_event_t *e)
{
    port_t *p = &x->ports[e->node];
    int32_t which = 0;
    if (!x->n_contenders) return fmi3OK;
    for (int32_t i = 0; i < x->n_contenders; i++)
        if (x->contenders[i].node == e->node) which = i;
    if (!head(x, e->node, OP_BUS_ERROR, 15)) return full(x, e->node);
    put(p, x->contenders[which].id, 4), put(p, e->code, 1);
    put(p, e->role & ROLE_PRIMARY ? 1 : 2, 1), put(p, !!(e->role & ROLE_SENDER), 1);
    return fmi3OK;
}

static fmi3Status lost(fmu_t *x, const bus_event_t *e, uint32_t id)
{
    int32_t n = 0;
    for (int32_t i = 0; i < x->n_contenders; i++)
        if (x->contenders[i].node != e->node) x->contenders[n++] = x->contenders[i];
    x->n_contenders = n;
    if (!x->discards[e->node] || !bus_abort(x->bus, e->node, e->request)) return fmi3OK;
    return tell(x, e->node, OP_LOST, id);
}

static fmi3Status happened(fmu_t *x, const bus_event_t *e)
{
    bus_waiting_t w = {e->request, 0, e->node};
    for (int32_t i = 0; i < x->n_waiting; i++)
        if (x->waiting[i].request == e->request) w = x->waiting[i];
    switch (e->kind) {
    case EVENT_STARTED:
        if (e->time != x->started) x->n_contenders = 0;
        x->started = e->time, x->contenders[x->n_contenders++] = w;
        return fmi3OK;
    case EVENT_SENT: forget(x, e->request); return tell(x, e->node, OP_CONFIRM, w.id);
    case EVENT_RECEIVED: return tell_frame(x, e->node, &x->frames[e->frame]);
    case EVENT_LOST: return lost(x, e, w.id);
    case EVENT_ERROR: return fault(x, e);
    case EVENT_DROPPED:
        forget(x, e->request);
        if (e->code == DROP_OVERFLOW)
            return refuse_node(x, e->node,
                               "found a frame more than its transmit queue holds,"
                               " expected fewer");
    }
    return fmi3OK;
}

static bool for_a_node(const fmu_t *x, const bus_event_t *e)
{
    return e->kind == EVENT_SENT || e->kind == EVENT_RECEIVED || e->kind == EVENT_ERROR ||
           (e->kind == EVENT_LOST && x->discards[e->node]);
}

/* When the next operation is due by `until`, if nobody sends anything; `nodes`: for whom. */
static int64_t next(fmu_t *x, int64_t until, bool nodes[N_NODES])
{
    int64_t first = NEVER;
    int more = 1;
    memcpy(x->saved, x->memory, x->size);
    while (more && first == NEVER) {
        bus_output_t out = {x->events, x->frames, EVENTS, EVENTS};
        more = bus_advance(x->bus, until, &out);
        for (int64_t i = 0; i < out.n_events; i++) {
            const bus_event_t *e = &x->events[i];
            if (!for_a_node(x, e) || e->time > first) continue;
            if (e->time < first) memset(nodes, 0, N_NODES * sizeof *nodes);
            first = e->time, nodes[e->node] = true;
        }
    }
    memcpy(x->memory, x->saved, x->size);
    return first;
}

fmi3Status core_go(fmu_t *x, int64_t until)
{
    while (x->now < until) {
        bool nodes[N_NODES] = {false};
        const int64_t due = next(x, until, nodes), part = due < until ? due : until;
        int more = 1;
        x->now = part;
        while (more) {
            bus_output_t out = {x->events, x->frames, EVENTS, EVENTS};
            more = bus_advance(x->bus, part, &out);
            for (int64_t i = 0; i < out.n_events; i++) {
                const fmi3Status status = happened(x, &x->events[i]);
                if (status != fmi3OK) return status;
            }
        }
    }
    return fmi3OK;
}

void core_schedule(fmu_t *x)
{
    bool nodes[N_NODES] = {false};
    const int64_t due = x->n_waiting ? next(x, x->now + HORIZON, nodes) : NEVER;
    for (int32_t i = 0; i < N_NODES; i++) {
        port_t *p = &x->ports[i];
        const int64_t tick = p->n_tx ? x->now : nodes[i] ? due : NEVER;
        if (tick == p->tick) continue;
        p->tick = tick, p->changed = tick != NEVER;
    }
}

fmi3Status core_tick(fmu_t *x)
{
    (void)x; /* what a node is told is there when its clock ticks */
    return fmi3OK;
}

size_t core_float64(fmu_t *x, fmi3ValueReference vr, const double **values)
{
    (void)x, (void)vr, (void)values;
    return 0;
}

bool core_boolean(fmu_t *x, fmi3ValueReference vr, fmi3Boolean *value)
{
    (void)x;
    *value = true;
    return vr == NOTIFICATIONS;
}
