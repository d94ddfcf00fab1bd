/* bus_socket.c: frames to and from a raw AF_CAN socket; see bus.h */
#define _GNU_SOURCE
#include <errno.h>
#include <string.h>

#include "bus_socket.h"
#include "pace.h"

#ifdef __linux__
#include <linux/can.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <time.h>

#ifndef SO_RXQ_OVFL
#define SO_RXQ_OVFL 40
#endif

enum { SECOND = 1000000000, STEP = 1000000, TIGHT = 200000, TRIES = 3 };

int32_t bus_prepare(int32_t fd)
{
    const int on = 1;

    if (setsockopt(fd, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on) < 0 ||
        setsockopt(fd, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on) < 0)
        return errno;
    return 0;
}

/* Wall time, and CLOCK_MONOTONIC on both sides of it: `within` is what lay between. */
typedef struct {
    int64_t wall, middle, after, within;
} reading_t;

static reading_t read_clocks(void)
{
    struct timespec wall;
    const int64_t before = pace_now();
    reading_t r;

    clock_gettime(CLOCK_REALTIME, &wall);
    r.after = pace_now();
    r.wall = (int64_t)wall.tv_sec * SECOND + wall.tv_nsec;
    r.within = r.after - before;
    r.middle = before + r.within / 2;
    return r;
}

/* The tightest of a few readings: a stall between two clocks would look like a step of one. */
static reading_t compare_clocks(void)
{
    reading_t best = read_clocks(), r;
    int i;

    for (i = 1; i < TRIES && best.within > TIGHT; i++)
        if ((r = read_clocks()).within < best.within) best = r;
    return best;
}

/* Where wall time stands, once a second of stamps: right to half of TIGHT, and kept where the
 * machine stands still too often to tell. `stamp_ns`: of the first frame, 0: it has none. */
static void begin_drain(bus_t *bus, int64_t stamp_ns)
{
    reading_t now;
    int64_t offset, change;

    bus->draining = 1;
    if (bus->wall_ns && !bus->stepped && stamp_ns >= bus->wall_ns && stamp_ns - bus->wall_ns < SECOND) return;
    now = compare_clocks();
    bus->began_ns = now.after;
    if (bus->wall_ns && now.within > TIGHT) return;
    offset = now.middle - now.wall;
    change = offset - bus->offset_ns;
    if (bus->wall_ns && (change >= STEP || change <= -STEP)) {
        bus->clock_steps++;
        bus->stepped = 2;      /* frames stamped before the step may come in this drain only; */
    } else if (bus->stepped) { /* one more, because it may have begun just before the step */
        bus->stepped--;
    }
    bus->offset_ns = offset;
    bus->wall_ns = now.within > TIGHT ? 0 : now.wall;
}

static int64_t arrival(bus_t *bus, int64_t wall_ns)
{
    int64_t t = wall_ns + bus->offset_ns;
    int64_t now;

    if (!wall_ns) return pace_now();
    if (bus->stepped) {
        now = pace_now();
        t = t < bus->empty_ns ? bus->empty_ns : t > now ? now : t;
    }
    return t;
}

/* The control messages: stamp in wall time (0: none), and the count of lost frames. */
static int64_t read_control(bus_t *bus, struct msghdr *message)
{
    int64_t wall_ns = 0;
    struct cmsghdr *c;
    struct timespec stamp;
    uint32_t lost;

    for (c = CMSG_FIRSTHDR(message); c; c = CMSG_NXTHDR(message, c)) {
        if (c->cmsg_level != SOL_SOCKET) continue;
        if (c->cmsg_type == SO_TIMESTAMPNS) {
            memcpy(&stamp, CMSG_DATA(c), sizeof stamp);
            wall_ns = (int64_t)stamp.tv_sec * SECOND + stamp.tv_nsec;
        } else if (c->cmsg_type == SO_RXQ_OVFL) {
            memcpy(&lost, CMSG_DATA(c), sizeof lost);
            bus->overruns += (uint32_t)(lost - bus->overflow);
            bus->overflow = lost;
        }
    }
    return wall_ns;
}

static void unpack(frame_t *frame, const struct canfd_frame *raw, int fd)
{
    uint32_t mask = raw->can_id & CAN_EFF_FLAG ? CAN_EFF_MASK : CAN_SFF_MASK;

    memset(frame, 0, sizeof *frame);
    if (raw->can_id & CAN_ERR_FLAG) mask = CAN_ERR_MASK;
    frame->id = raw->can_id & mask;
    if (raw->can_id & CAN_ERR_FLAG) frame->flags = FRAME_ERROR;
    else
        frame->flags = (uint8_t)((raw->can_id & CAN_EFF_FLAG ? FRAME_EXTENDED : 0) |
                                 (raw->can_id & CAN_RTR_FLAG ? FRAME_REMOTE : 0));
    if (fd)
        frame->flags |= (uint8_t)(FRAME_FD | (raw->flags & CANFD_BRS ? FRAME_BRS : 0) |
                                  (raw->flags & CANFD_ESI ? FRAME_ESI : 0));
    frame->length = raw->len <= CANFD_MAX_DLEN ? raw->len : CANFD_MAX_DLEN;
    if (!(frame->flags & FRAME_REMOTE)) memcpy(frame->data, raw->data, frame->length);
}

/* Nothing is left in the queue. */
static void drained(bus_t *bus)
{
    if (bus->draining) bus->empty_ns = bus->began_ns;
    bus->draining = 0;
}

/* recvmmsg() failed with errno: 1: try again, 0: no frame available. */
static int error_action(bus_t *bus)
{
    if (errno == EINTR) return 1;
    if (errno == EAGAIN || errno == EWOULDBLOCK) {
        drained(bus);
        return 0;
    }
    bus->last_errno = errno;
    if (errno == ENETDOWN || errno == ENODEV || errno == ENXIO) bus->state = BUS_DOWN;
    return 1; /* the socket reports an error once; frames may follow it */
}

typedef union {
    char bytes[128];
    struct cmsghdr align;
} control_t;

static void take(bus_t *bus, struct mmsghdr *message, const struct canfd_frame *raw)
{
    frame_t *frame = bus->batch + bus->batched;
    int64_t stamp_ns;

    if (message->msg_len != CAN_MTU && message->msg_len != CANFD_MTU) return;
    stamp_ns = read_control(bus, &message->msg_hdr);
    if (!bus->draining) begin_drain(bus, stamp_ns);
    unpack(frame, raw, message->msg_len == CANFD_MTU);
    frame->t_ns = arrival(bus, stamp_ns);
    bus->batched++;
}

/* What has arrived, in one call: 1: something, or try again; 0: nothing. */
static int fill(bus_t *bus)
{
    struct canfd_frame raw[BUS_BATCH];
    control_t control[BUS_BATCH];
    struct iovec parts[BUS_BATCH];
    struct mmsghdr messages[BUS_BATCH];
    int i, n;

    memset(messages, 0, sizeof messages);
    for (i = 0; i < BUS_BATCH; i++) {
        parts[i] = (struct iovec){raw + i, sizeof raw[i]};
        messages[i].msg_hdr.msg_iov = parts + i;
        messages[i].msg_hdr.msg_iovlen = 1;
        messages[i].msg_hdr.msg_control = control[i].bytes;
        messages[i].msg_hdr.msg_controllen = sizeof control[i].bytes;
    }
    n = recvmmsg(bus->fd, messages, BUS_BATCH, MSG_DONTWAIT, NULL);
    if (n < 0) return error_action(bus);
    for (i = 0; i < n; i++) take(bus, messages + i, raw + i);
    bus->emptied = n < BUS_BATCH;
    if (bus->emptied) drained(bus);
    return 1;
}

int socket_next(bus_t *bus, frame_t *frame)
{
    int tries = 4;

    if (bus->given == bus->batched) {
        const int asked = bus->emptied;
        bus->batched = bus->given = bus->emptied = 0;
        if (asked) return 0;
        while (!bus->batched && !bus->emptied && tries-- > 0)
            if (!fill(bus)) return 0;
        if (!bus->batched) return bus->emptied = 0;
    }
    *frame = bus->batch[bus->given++];
    return 1;
}

/* Lengths that a frame can have: 0 to 8, and for CAN FD 12, 16, 20, 24, 32, 48, 64. */
static int possible(const frame_t *frame)
{
    uint16_t n = frame->length;

    if (n <= 8) return 1;
    if (!(frame->flags & FRAME_FD) || n > 64) return 0;
    return n <= 24 ? n % 4 == 0 : n == 32 || n == 48 || n == 64;
}

int32_t socket_send(const bus_t *bus, const frame_t *frame)
{
    struct canfd_frame raw;
    int fd = (frame->flags & FRAME_FD) != 0;

    if (!possible(frame)) return EINVAL;
    memset(&raw, 0, sizeof raw);
    raw.can_id = frame->id | (frame->flags & FRAME_EXTENDED ? CAN_EFF_FLAG : 0) |
                 (frame->flags & FRAME_REMOTE && !fd ? CAN_RTR_FLAG : 0) |
                 (frame->flags & FRAME_ERROR ? CAN_ERR_FLAG : 0);
    raw.len = (uint8_t)frame->length;
    if (fd)
        raw.flags = (uint8_t)((frame->flags & FRAME_BRS ? CANFD_BRS : 0) |
                              (frame->flags & FRAME_ESI ? CANFD_ESI : 0));
    memcpy(raw.data, frame->data, frame->length);
    while (send(bus->fd, &raw, fd ? CANFD_MTU : CAN_MTU, MSG_DONTWAIT) < 0)
        if (errno != EINTR) return errno;
    return 0;
}

#else

int32_t bus_prepare(int32_t fd)
{
    (void)fd;
    return ENOSYS;
}

int socket_next(bus_t *bus, frame_t *frame)
{
    (void)frame;
    bus->last_errno = ENOSYS;
    return 0;
}

int32_t socket_send(const bus_t *bus, const frame_t *frame)
{
    (void)bus;
    (void)frame;
    return ENOSYS;
}

#endif
