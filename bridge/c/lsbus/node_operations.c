/* node_operations.c - frames of a node as operations of FMI-LS-BUS 1.0, in and out; see core.h. */
#include <string.h>

#include "core.h"

/* The header of an operation. */
static fmi3Status head(fmu_t *x, int32_t bus, uint32_t code, size_t length)
{
    if (!put_head(&x->ports[bus], code, length))
        return lsbus_refuse(x,
                            "t = %.12g s: found more operations to be sent than fit, expected"
                            " Tx_Clock to tick when it said",
                            (double)x->now * 1e-12);
    return fmi3OK;
}

static fmi3Status rate(fmu_t *x, int32_t bus, uint8_t parameter, uint32_t bits)
{
    const fmi3Status status = head(x, bus, OP_CONFIGURATION, 13);
    if (status == fmi3OK) put(&x->ports[bus], parameter, 1), put(&x->ports[bus], bits, 4);
    return status;
}

fmi3Status operation_rates(fmu_t *x, int32_t bus)
{
    const rates_t *r = &node_rates[bus];
    const fmi3Status status = rate(x, bus, CAN_BAUDRATE, r->nominal);
    return status == fmi3OK && r->data ? rate(x, bus, CAN_FD_BAUDRATE, r->data) : status;
}

fmi3Status operation_send(fmu_t *x, int32_t bus, const frame_t *frame)
{
    const bool fd = frame->flags & FRAME_FD;
    port_t *p = &x->ports[bus];
    const fmi3Status status =
        head(x, bus, fd ? OP_FD_TRANSMIT : OP_TRANSMIT, (fd ? 17u : 16u) + frame->length);
    if (status != fmi3OK) return status;
    put(p, frame->id, 4), put(p, !!(frame->flags & FRAME_EXTENDED), 1);
    if (fd) put(p, !!(frame->flags & FRAME_BRS), 1), put(p, !!(frame->flags & FRAME_ESI), 1);
    else put(p, !!(frame->flags & FRAME_REMOTE), 1);
    put(p, frame->length, 2);
    memcpy(p->tx + p->n_tx, frame->data, frame->length);
    p->n_tx += frame->length;
    return fmi3OK;
}

/* The frame of a transmit operation; false: these bytes are none. */
static bool frame_of(const uint8_t *raw, size_t n, bool fd, frame_t *f)
{
    transmit_t of;
    if (!transmit_of(raw, n, fd, &of)) return false;
    memset(f, 0, sizeof *f);
    f->id = of.id, f->length = (uint16_t)of.length;
    f->flags = (uint8_t)((fd ? FRAME_FD : 0) | (of.extended ? FRAME_EXTENDED : 0) | (of.esi ? FRAME_ESI : 0));
    if (of.second) f->flags |= fd ? FRAME_BRS : FRAME_REMOTE;
    memcpy(f->data, raw + of.first, of.length);
    return true;
}

static fmi3Status receive(fmu_t *x, int32_t bus, const frame_t *frame)
{
    ring_t *r = &x->received[bus];
    if (r->head - r->tail == WAITING)
        return lsbus_refuse(x,
                            "t = %.12g s: found more than %d frames since the last slot, expected"
                            " fewer",
                            (double)x->now * 1e-12, (int)WAITING);
    r->frames[r->head++ & (WAITING - 1)] = *frame;
    return fmi3OK;
}

static fmi3Status send_back(fmu_t *x, int32_t bus, const uint8_t *raw, size_t n)
{
    const size_t length = n > 0xffff ? 0xffff : n;
    const fmi3Status status = head(x, bus, OP_FORMAT_ERROR, 10 + length);
    if (status != fmi3OK) return status;
    port_t *p = &x->ports[bus];
    put(p, (uint32_t)length, 2);
    memcpy(p->tx + p->n_tx, raw, length);
    p->n_tx += length;
    return fmi3OK;
}

/* Notifications are ignored, as the standard demands of a node without BusNotifications. */
fmi3Status operation_take(fmu_t *x, int32_t bus, const uint8_t *raw, size_t n, int64_t at_ns)
{
    const uint32_t code = n < 8 || number(raw + 4, 4) != n ? 0 : number(raw, 4);
    frame_t frame;
    switch (code) {
    case OP_TRANSMIT:
    case OP_FD_TRANSMIT:
        if (!frame_of(raw, n, code == OP_FD_TRANSMIT, &frame)) break;
        frame.t_ns = at_ns;
        return receive(x, bus, &frame);
    case OP_FORMAT_ERROR:
    case OP_CONFIRM:
    case OP_LOST:
    case OP_BUS_ERROR:
    case OP_CONFIGURATION:
    case OP_STATUS:
    case OP_WAKEUP: return fmi3OK;
    default: break;
    }
    return send_back(x, bus, raw, n);
}
