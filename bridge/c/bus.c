/* bus.c: see bus.h; the socket's side is bus_socket.c */
#define _GNU_SOURCE
#include <errno.h>
#include <string.h>
#include <unistd.h>

#include "bus.h"
#include "bus_socket.h"
#include "pace.h"

/* linux/can/error.h; error frames look the same whatever brought them */
enum { CLASS_CONTROLLER = 0x04, CLASS_BUSOFF = 0x40, CLASS_RESTARTED = 0x100, CLASS_COUNTERS = 0x200 };
enum { CONTROLLER_WARNING = 0x04 | 0x08, CONTROLLER_PASSIVE = 0x10 | 0x20, CONTROLLER_ACTIVE = 0x40 };

static void write_row(bus_t *bus, const frame_t *frame, uint8_t sent)
{
    size_t size;
    frame_t *row;

    if (bus->traffic) traffic_add(bus->traffic, frame);
    if (!bus->log || !(row = journal_next(bus->log))) return;
    size = bus->log->row_size < sizeof(frame_t) ? bus->log->row_size : sizeof(frame_t);
    memcpy(row, frame, size);
    row->flags |= sent;
    row->sequence = (uint32_t)bus->log->rows;
    journal_commit(bus->log);
}

static void error_frame(bus_t *bus, const frame_t *frame)
{
    uint8_t controller = frame->data[1];

    bus->error_frames++;
    if (frame->id & CLASS_COUNTERS) {
        bus->tx_errors = frame->data[6];
        bus->rx_errors = frame->data[7];
    }
    if (frame->id & CLASS_CONTROLLER) {
        if (controller & CONTROLLER_PASSIVE) bus->state = BUS_PASSIVE;
        else if (controller & CONTROLLER_WARNING) bus->state = BUS_WARNING;
        else if (controller & CONTROLLER_ACTIVE) bus->state = BUS_ACTIVE;
    }
    if (frame->id & CLASS_BUSOFF) bus->state = BUS_OFF;
    if (frame->id & CLASS_RESTARTED) {
        bus->state = BUS_ACTIVE;
        bus->restarts++;
    }
}

/* A frame went through: whatever was off or down is not any more. */
static void alive(bus_t *bus)
{
    if (bus->state == BUS_OFF || bus->state == BUS_DOWN) {
        bus->state = BUS_ACTIVE;
        bus->restarts++;
    }
}

static int accepted(const bus_t *bus, const frame_t *frame)
{
    int64_t i;

    for (i = 0; bus->accepts && i < bus->n_accepts; i++)
        if (frame_accepted(bus->accepts + i, frame)) return 1;
    return !bus->accepts;
}

/* 1: a frame; 0: none */
static int ring_next(bus_t *bus, frame_t *frame)
{
    bus->overruns = (int64_t)__atomic_load_n(&bus->rx->dropped, __ATOMIC_RELAXED);
    return ring_get(bus->rx, frame);
}

int32_t bus_receive(bus_t *bus, frame_t *frame)
{
    while (bus->kind == BUS_SOCKET ? socket_next(bus, frame) : ring_next(bus, frame)) {
        frame->bus = (uint8_t)bus->number;
        frame->flags &= (uint8_t)~FRAME_SENT;
        write_row(bus, frame, 0);
        if (frame->flags & FRAME_ERROR) {
            error_frame(bus, frame);
            continue;
        }
        alive(bus);
        bus->received++;
        if (accepted(bus, frame)) return 1;
        bus->foreign++;
    }
    return 0;
}

/* An eventfd takes 8 bytes; that it is full means the thread is awake. */
void bus_wake(const bus_t *bus)
{
    const uint64_t one = 1;

    if (bus->kind == BUS_RING && bus->fd >= 0 && write(bus->fd, &one, sizeof one) < 0) return;
}

int32_t bus_send(bus_t *bus, frame_t *frame)
{
    const int32_t error = bus_queue(bus, frame);
    if (!error) bus_wake(bus);
    return error;
}

int32_t bus_queue(bus_t *bus, frame_t *frame)
{
    int32_t error = 0;

    frame->bus = (uint8_t)bus->number;
    if (bus->kind != BUS_MEMORY && !frame->t_ns) frame->t_ns = pace_now();
    if (bus->kind == BUS_SOCKET) error = socket_send(bus, frame);
    else if (!ring_put(bus->tx, frame)) error = ENOBUFS;
    if (error) {
        bus->send_failed++;
        bus->last_errno = error;
        if (error == ENETDOWN || error == ENODEV || error == ENXIO) bus->state = BUS_DOWN;
        return error;
    }
    if (bus->state == BUS_DOWN && bus->kind == BUS_SOCKET) alive(bus);
    bus->sent++;
    write_row(bus, frame, FRAME_SENT);
    return 0;
}
