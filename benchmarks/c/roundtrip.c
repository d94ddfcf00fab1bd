/* roundtrip.c: a frame there and back over a CAN interface, through a raw socket and through bus.h.
 *
 * ping sends a frame and waits for the answer, n times; echo answers n times. `fd` is a raw CAN
 * socket with a filter for what it is to receive, and a receive time-out. Linked against the bridge's
 * library.
 *
 * raw      blocking read, write: the least there is
 * stamped  what a loop at a fixed rate does: reads with the kernel's time stamp until there is no more
 * bridge   bus.h, as a tick uses it; what is sent is encoded and protected, what comes in is decoded
 */
#define _GNU_SOURCE
#include <errno.h>
#include <linux/can.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <unistd.h>

#include "bus.h"
#include "message.h"
#include "pace.h"

enum { PING = 0x101, ECHO = 0x102, VALUES = 14, PATIENCE_MS = 1000 };

/* ---- raw and stamped ---- */

typedef int32_t (*receive_t)(int32_t fd, struct canfd_frame *frame, size_t size);

static int32_t failed(void) { return errno ? errno : EIO; }

static int32_t raw_send(int32_t fd, const struct canfd_frame *frame, size_t size)
{
    return write(fd, frame, size) == (ssize_t)size ? 0 : failed();
}

static int32_t raw_receive(int32_t fd, struct canfd_frame *frame, size_t size)
{
    return read(fd, frame, sizeof *frame) == (ssize_t)size ? 0 : failed();
}

static ssize_t stamped_next(int32_t fd, struct canfd_frame *frame)
{
    union {
        char bytes[128];
        struct cmsghdr align;
    } control;
    struct iovec part = {frame, sizeof *frame};
    struct msghdr message = {.msg_iov = &part,
                             .msg_iovlen = 1,
                             .msg_control = control.bytes,
                             .msg_controllen = sizeof control.bytes};
    return recvmsg(fd, &message, MSG_DONTWAIT);
}

static int32_t patient(int32_t fd)
{
    struct pollfd ready = {.fd = fd, .events = POLLIN};
    return poll(&ready, 1, PATIENCE_MS) > 0 ? 0 : ETIMEDOUT;
}

static int32_t stamped_receive(int32_t fd, struct canfd_frame *frame, size_t size)
{
    struct canfd_frame more;
    int32_t error = patient(fd);
    if (error) return error;
    if (stamped_next(fd, frame) != (ssize_t)size) return failed();
    while (stamped_next(fd, &more) > 0);
    return 0;
}

static int32_t ping(receive_t receive, int32_t fd, int32_t bytes, int64_t n, int64_t *taken_ns)
{
    const size_t size = bytes > 8 ? CANFD_MTU : CAN_MTU;
    struct canfd_frame out = {.can_id = PING, .len = (uint8_t)bytes}, in;
    for (int64_t k = 0; k < n; k++) {
        memcpy(out.data, &k, 8);
        int64_t start = pace_now();
        int32_t error = raw_send(fd, &out, size);
        if (error || (error = receive(fd, &in, size))) return error;
        taken_ns[k] = pace_now() - start;
        if (memcmp(in.data, out.data, (size_t)bytes)) return EBADMSG;
    }
    return 0;
}

static int32_t echo(receive_t receive, int32_t fd, int32_t bytes, int64_t n)
{
    const size_t size = bytes > 8 ? CANFD_MTU : CAN_MTU;
    struct canfd_frame frame;
    for (int64_t k = 0; k < n; k++) {
        int32_t error = receive(fd, &frame, size);
        frame.can_id = ECHO;
        if (error || (error = raw_send(fd, &frame, size))) return error;
    }
    return 0;
}

API int32_t raw_ping(int32_t fd, int32_t bytes, int64_t n, int64_t *taken_ns)
{
    return ping(raw_receive, fd, bytes, n, taken_ns);
}

API int32_t raw_echo(int32_t fd, int32_t bytes, int64_t n) { return echo(raw_receive, fd, bytes, n); }

API int32_t stamped_ping(int32_t fd, int32_t bytes, int64_t n, int64_t *taken_ns)
{
    const int32_t error = bus_prepare(fd);
    return error ? error : ping(stamped_receive, fd, bytes, n, taken_ns);
}

API int32_t stamped_echo(int32_t fd, int32_t bytes, int64_t n)
{
    const int32_t error = bus_prepare(fd);
    return error ? error : echo(stamped_receive, fd, bytes, n);
}

/* ---- through the bus ---- */

typedef struct {
    field_t fields[VALUES], header[2];
    message_t message;
} table_t;

/* 64 bytes: P05, status, time, 14 values of 32 bits; 8 bytes: P02, status, 3 values of 16 bits. */
static void describe(table_t *t, uint32_t id, int32_t bytes)
{
    const int wide = bytes > 8, bits = wide ? 32 : 16;
    memset(t, 0, sizeof *t);
    t->message = (message_t){.id = id,
                             .length = (uint16_t)bytes,
                             .e2e = wide ? E2E_P05 : E2E_P02,
                             .flags = wide ? FRAME_FD | FRAME_BRS : 0,
                             .data_ids = {1, 2, 3},
                             .n_fields = wide ? VALUES : 3,
                             .status = 0,
                             .time = wide ? 1 : -1,
                             .fields = t->fields,
                             .header = t->header};
    t->header[0] =
        (field_t){.start = wide ? 24 : 12, .length = wide ? 8 : 4, .scale = 1, .high = wide ? 255 : 15};
    t->header[1] = (field_t){.start = 32, .length = 32, .scale = 1, .high = UINT32_MAX};
    for (int32_t i = 0; i < t->message.n_fields; i++)
        t->fields[i] = (field_t){.start = (uint16_t)((wide ? 64 : 16) + bits * i),
                                 .length = (uint8_t)bits,
                                 .kind = FIELD_SIGNED,
                                 .scale = 1.0 / 1024,
                                 .low = -(1LL << (bits - 1)) + 1,
                                 .high = (1LL << (bits - 1)) - 1};
}

/* One end: its bus, and the messages that go there and come back. */
typedef struct {
    bus_t bus;
    table_t there, back;
} end_t;

static int32_t open_end(end_t *e, int32_t fd, int32_t bytes)
{
    memset(e, 0, sizeof *e);
    e->bus.kind = BUS_SOCKET;
    e->bus.fd = fd;
    describe(&e->there, PING, bytes);
    describe(&e->back, ECHO, bytes);
    return bus_prepare(fd);
}

/* Waits for a frame; takes all there is, as a tick does, and the values of the last. */
static int32_t await(bus_t *bus, const message_t *m, double *values, header_t *header)
{
    frame_t frame;
    int32_t error = patient(bus->fd);
    if (error) return error;
    while (bus_receive(bus, &frame)) error = message_decode(m, &frame, values, header);
    return error == DECODE_OK ? 0 : EBADMSG;
}

/* t_ns: when, if the caller has just read the clock, as a node has; else 0. */
static int32_t hand_over(bus_t *bus, const message_t *m, const double *values, header_t *header, int64_t t_ns)
{
    frame_t frame;
    message_encode(m, values, header, &frame);
    frame.t_ns = t_ns;
    return bus_send(bus, &frame);
}

API int32_t bridge_ping(int32_t fd, int32_t bytes, int64_t n, int64_t *taken_ns)
{
    double out[VALUES] = {0}, in[VALUES] = {0};
    header_t header = {0};
    end_t e;
    int32_t error = open_end(&e, fd, bytes);
    for (int64_t k = 0; k < n && !error; k++) {
        out[k % e.there.message.n_fields] = (double)(k % 30000) / 1024;
        header = (header_t){.counter = (uint32_t)k, .t_us = (uint32_t)k};
        int64_t start = pace_now();
        if ((error = hand_over(&e.bus, &e.there.message, out, &header, start)) ||
            (error = await(&e.bus, &e.back.message, in, &header)))
            break;
        taken_ns[k] = pace_now() - start;
        if (memcmp(in, out, sizeof in)) error = EBADMSG;
    }
    return error;
}

API int32_t bridge_echo(int32_t fd, int32_t bytes, int64_t n)
{
    double values[VALUES] = {0};
    header_t header = {0};
    end_t e;
    int32_t error = open_end(&e, fd, bytes);
    for (int64_t k = 0; k < n && !error; k++) {
        error = await(&e.bus, &e.there.message, values, &header);
        if (!error) error = hand_over(&e.bus, &e.back.message, values, &header, 0);
    }
    return error;
}
