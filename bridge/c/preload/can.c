/* can.c: raw sockets of AF_CAN on the simulated bus, also where the kernel has no CAN; files of timers.
 *
 * Such a socket is a Unix socket for packets to the process that has the bus (bridge/bus_server/
 * can_sockets.py). A packet to it begins with a letter: B (bind), O (an option: its number, its value), F (a
 * frame, struct can_frame or canfd_frame) or T (a timer: its time and its period, ns of the bus). A packet
 * from it is the time of the frame (CLOCK_REALTIME, ns), the flags of its message, and the frame; or the
 * number of expirations of a timer, in 8 bytes. */
#define _GNU_SOURCE
#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <linux/sockios.h>
#include <net/if.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/syscall.h>
#include <sys/timerfd.h>
#include <sys/un.h>
#include <unistd.h>

#include "can.h"
#include "thread.h"

enum { MOST = 4096, INDEX = 1000 /* of the only interface */, WAITING_FRAMES = 4096 /* bytes */ };
enum { CAN_SOCKET = 1, STAMP = 2, STAMP_NS = 4, STAMPING = 8, FD_FRAMES = 16, TIMER = 32 };

typedef struct {
    int64_t when;
    int32_t flags;
    unsigned char frame[CANFD_MTU];
} __attribute__((packed)) packet_t;

static unsigned char sockets[MOST];
static struct {
    int64_t due, period; /* ns of the bus; due NEVER: not set */
    clockid_t clock;
} timers[MOST];
static pid_t owner; /* the child of a vfork must not change `sockets` */

int is_can(int fd) { return fd >= 0 && fd < MOST && sockets[fd] & (CAN_SOCKET | TIMER); }

static const char *interface_name(void)
{
    const char *found = getenv("COSIM_BUS_INTERFACE");

    return found ? found : "";
}

static int failed(int number)
{
    errno = number;
    return -1;
}

static int connection(int type, int kind)
{
    struct sockaddr_un to = {.sun_family = AF_UNIX};
    const char *path = getenv("COSIM_BUS_SOCKETS");
    const int flags = type & (SOCK_NONBLOCK | SOCK_CLOEXEC), bytes = WAITING_FRAMES;
    int fd;

    if (path == NULL || strlen(path) >= sizeof to.sun_path) return failed(EAFNOSUPPORT);
    strcpy(to.sun_path, path);
    fd = (int)kernel(SYS_socket, AF_UNIX, SOCK_SEQPACKET | (flags & SOCK_CLOEXEC), 0);
    if (fd < 0) return fd;
    if (fd >= MOST || kernel(SYS_connect, fd, &to, sizeof to) < 0) {
        kernel(SYS_close, fd);
        return failed(ENOBUFS);
    }
    kernel(SYS_setsockopt, fd, SOL_SOCKET, SO_SNDBUF, &bytes, sizeof bytes);
    if (flags & SOCK_NONBLOCK) {
        int on = 1;
        kernel(SYS_ioctl, fd, FIONBIO, &on);
    }
    owner = getpid();
    sockets[fd] = (unsigned char)kind;
    return fd;
}

EXPORT int socket(int family, int type, int protocol)
{
    if (family != AF_CAN || bus_table() == NULL) return (int)kernel(SYS_socket, family, type, protocol);
    if ((type & 0xf) != SOCK_RAW || protocol != CAN_RAW) return failed(EPROTONOSUPPORT);
    return connection(type, CAN_SOCKET);
}

EXPORT int close(int fd)
{
    if (is_can(fd) && owner == getpid()) sockets[fd] = 0;
    wakes_others();
    return (int)kernel(SYS_close, fd);
}

static ssize_t tell(int fd, char what, const void *content, size_t size)
{
    char text[1024];

    if (size > sizeof text - 1) return failed(EINVAL);
    text[0] = what;
    memcpy(text + 1, content, size);
    wakes_others();
    return kernel(SYS_sendto, fd, text, size + 1, MSG_NOSIGNAL, NULL, 0);
}

EXPORT int bind(int fd, const struct sockaddr *to, socklen_t length)
{
    const struct sockaddr_can *address = (const struct sockaddr_can *)(const void *)to;

    if (!is_can(fd)) return (int)kernel(SYS_bind, fd, to, length);
    if (address->can_family != AF_CAN) return failed(EINVAL);
    if (address->can_ifindex != 0 && address->can_ifindex != INDEX) return failed(ENODEV);
    return tell(fd, 'B', "", 0) < 0 ? -1 : 0;
}

EXPORT int getsockname(int fd, struct sockaddr *restrict out, socklen_t *restrict length)
{
    const struct sockaddr_can found = {.can_family = AF_CAN, .can_ifindex = INDEX};

    if (!is_can(fd)) return (int)kernel(SYS_getsockname, fd, out, length);
    memcpy(out, &found, *length < sizeof found ? *length : sizeof found);
    *length = sizeof found;
    return 0;
}

static void note(int fd, int flag, const void *value)
{
    if (*(const int *)value) sockets[fd] |= (unsigned char)flag;
    else sockets[fd] &= (unsigned char)~flag;
}

EXPORT int setsockopt(int fd, int level, int name, const void *value, socklen_t size)
{
    char text[1000];

    if (!is_can(fd)) return (int)kernel(SYS_setsockopt, fd, level, name, value, size);
    if (level == SOL_SOCKET && size >= sizeof(int)) {
        if (name == SO_TIMESTAMP) note(fd, STAMP, value);
        if (name == SO_TIMESTAMPNS) note(fd, STAMP_NS, value);
        if (name == SO_TIMESTAMPING) note(fd, STAMPING, value);
        return 0;
    }
    if (level != SOL_CAN_RAW) return failed(ENOPROTOOPT);
    if (size > sizeof text - sizeof name) return failed(EINVAL);
    if (name == CAN_RAW_FD_FRAMES && size >= sizeof(int)) note(fd, FD_FRAMES, value);
    memcpy(text, &name, sizeof name);
    memcpy(text + sizeof name, value, size);
    return tell(fd, 'O', text, sizeof name + size) < 0 ? -1 : 0;
}

EXPORT unsigned if_nametoindex(const char *name)
{
    REAL(if_nametoindex);

    return bus_table() && strcmp(name, interface_name()) == 0 ? INDEX : real(name);
}

EXPORT char *if_indextoname(unsigned index, char name[IF_NAMESIZE])
{
    REAL(if_indextoname);

    if (bus_table() == NULL || index != INDEX) return real(index, name);
    snprintf(name, IF_NAMESIZE, "%s", interface_name());
    return name;
}

static int ask_interface(unsigned long request, struct ifreq *about)
{
    if (request == SIOCGIFNAME) {
        if (about->ifr_ifindex != INDEX) return failed(ENODEV);
        snprintf(about->ifr_name, IFNAMSIZ, "%s", interface_name());
        return 0;
    }
    if (strncmp(about->ifr_name, interface_name(), IFNAMSIZ) != 0) return failed(ENODEV);
    if (request == SIOCGIFINDEX) about->ifr_ifindex = INDEX;
    if (request == SIOCGIFMTU) about->ifr_mtu = getenv("COSIM_BUS_FD") ? CANFD_MTU : CAN_MTU;
    if (request == SIOCGIFFLAGS) about->ifr_flags = IFF_UP | IFF_RUNNING | IFF_NOARP;
    return 0;
}

EXPORT int ioctl(int fd, unsigned long request, ...)
{
    va_list given;
    void *argument;

    va_start(given, request);
    argument = va_arg(given, void *);
    va_end(given);
    if (is_can(fd) && (request == SIOCGIFNAME || request == SIOCGIFINDEX || request == SIOCGIFMTU ||
                       request == SIOCGIFFLAGS))
        return ask_interface(request, argument);
    return (int)kernel(SYS_ioctl, fd, request, argument);
}

static void add_stamp(struct msghdr *to, size_t *room, int type, const void *stamp, size_t size)
{
    struct cmsghdr *c = (struct cmsghdr *)(void *)((char *)to->msg_control + *room);

    if (to->msg_control == NULL || *room + CMSG_LEN(size) > to->msg_controllen) {
        to->msg_flags |= MSG_CTRUNC;
        return;
    }
    c->cmsg_level = SOL_SOCKET;
    c->cmsg_type = type;
    c->cmsg_len = CMSG_LEN(size);
    memcpy(CMSG_DATA(c), stamp, size);
    *room += CMSG_SPACE(size);
}

static void add_stamps(int fd, struct msghdr *to, int64_t when)
{
    const struct timespec t = to_timespec(when), three[3] = {t, {0, 0}, {0, 0}};
    const struct {
        long seconds, microseconds;
    } coarse = {t.tv_sec, t.tv_nsec / 1000};
    size_t used = 0;

    if (sockets[fd] & STAMP) add_stamp(to, &used, SO_TIMESTAMP, &coarse, sizeof coarse);
    if (sockets[fd] & STAMP_NS) add_stamp(to, &used, SO_TIMESTAMPNS, &t, sizeof t);
    if (sockets[fd] & STAMPING) add_stamp(to, &used, SO_TIMESTAMPING, three, sizeof three);
    to->msg_controllen = used < to->msg_controllen ? used : to->msg_controllen;
}

static ssize_t receive_frame(int fd, struct msghdr *to, int flags)
{
    const struct sockaddr_can from = {.can_family = AF_CAN, .can_ifindex = INDEX};
    packet_t p;
    ssize_t got = kernel(SYS_recvfrom, fd, &p, sizeof p, flags & ~MSG_TRUNC, NULL, NULL);
    const size_t head = sizeof p - sizeof p.frame;
    size_t i, done = 0, size;

    if (got < (ssize_t)head) return got < 0 ? got : failed(ENETDOWN);
    size = (size_t)got - head;
    for (i = 0; i < to->msg_iovlen && done < size; i++) {
        const size_t part = to->msg_iov[i].iov_len < size - done ? to->msg_iov[i].iov_len : size - done;

        memcpy(to->msg_iov[i].iov_base, p.frame + done, part);
        done += part;
    }
    to->msg_flags = p.flags;
    if (to->msg_name != NULL) {
        memcpy(to->msg_name, &from, to->msg_namelen < sizeof from ? to->msg_namelen : sizeof from);
        to->msg_namelen = sizeof from;
    }
    add_stamps(fd, to, p.when);
    return (ssize_t)done;
}

EXPORT int timerfd_create(clockid_t clock, int flags)
{
    const int type = (flags & TFD_NONBLOCK ? SOCK_NONBLOCK : 0) | (flags & TFD_CLOEXEC ? SOCK_CLOEXEC : 0);
    int64_t offset;
    int fd;

    if (bus_table() == NULL) return (int)kernel(SYS_timerfd_create, clock, flags);
    if (!clock_offset(clock, &offset)) return failed(EINVAL);
    fd = connection(type, TIMER);
    if (fd >= 0) {
        timers[fd].due = NEVER;
        timers[fd].period = 0;
        timers[fd].clock = clock;
    }
    return fd;
}

EXPORT int timerfd_gettime(int fd, struct itimerspec *out)
{
    int64_t left;

    if (!is_can(fd)) return (int)kernel(SYS_timerfd_gettime, fd, out);
    left = timers[fd].due == NEVER ? 0 : timers[fd].due - LOAD(bus_table()->now);
    if (left < 0 && timers[fd].period > 0) left = timers[fd].period - -left % timers[fd].period;
    out->it_value = to_timespec(left > 0 ? left : 0);
    out->it_interval = to_timespec(timers[fd].period);
    return 0;
}

EXPORT int timerfd_settime(int fd, int flags, const struct itimerspec *wanted, struct itimerspec *before)
{
    const struct timespec *value = &wanted->it_value;
    int64_t count, told[2];

    if (!is_can(fd)) return (int)kernel(SYS_timerfd_settime, fd, flags, wanted, before);
    if (before != NULL) timerfd_gettime(fd, before);
    while (kernel(SYS_recvfrom, fd, &count, sizeof count, MSG_DONTWAIT, NULL, NULL) > 0) {}
    told[0] = flags & TFD_TIMER_ABSTIME ? deadline_at(timers[fd].clock, value) : deadline_after(value);
    told[1] = (int64_t)wanted->it_interval.tv_sec * SECOND + wanted->it_interval.tv_nsec;
    if (told[0] < 0 || told[1] < 0) return failed(EINVAL);
    if (value->tv_sec == 0 && value->tv_nsec == 0) told[0] = NEVER;
    timers[fd].due = told[0];
    timers[fd].period = told[1];
    return tell(fd, 'T', told, sizeof told) < 0 ? -1 : 0;
}

/* Expirations that have not been read, as one number. */
static ssize_t read_timer(int fd, const struct msghdr *to, int flags)
{
    int64_t sum = 0, count;

    if (to->msg_iovlen == 0 || to->msg_iov[0].iov_len < sizeof sum) return failed(EINVAL);
    while (kernel(SYS_recvfrom, fd, &count, sizeof count, sum ? MSG_DONTWAIT : flags, NULL, NULL) > 0)
        sum += count;
    if (sum == 0) return -1;
    memcpy(to->msg_iov[0].iov_base, &sum, sizeof sum);
    return sizeof sum;
}

ssize_t can_receive(int fd, struct msghdr *to, int flags)
{
    if (sockets[fd] & TIMER) return read_timer(fd, to, flags);
    return receive_frame(fd, to, flags);
}

ssize_t can_send(int fd, const struct msghdr *from, int flags)
{
    char text[CANFD_MTU];
    size_t i, size = 0;
    ssize_t got;

    (void)flags;
    for (i = 0; i < from->msg_iovlen; i++) {
        const size_t part = from->msg_iov[i].iov_len;

        if (part > sizeof text - size) return failed(EINVAL);
        memcpy(text + size, from->msg_iov[i].iov_base, part);
        size += part;
    }
    if (size != CAN_MTU && !(size == CANFD_MTU && sockets[fd] & FD_FRAMES && getenv("COSIM_BUS_FD")))
        return failed(EINVAL);
    got = tell(fd, 'F', text, size);
    return got < 0 ? got : (ssize_t)size;
}
