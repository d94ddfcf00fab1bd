/* files.c: waits for files, sockets and pipes in bus time */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#include "can.h"
#include "thread.h"

enum { MASK = 8 /* bytes of the kernel's set of signals */ };

/* A system call that waits for as long as its last but one argument, repeated until `deadline`. */
typedef struct {
    long number, a[6];
    int timeout;     /* the place of the time-out among the arguments */
    int in_ms;       /* it is in milliseconds, else a struct timespec */
    fd_set *sets[3]; /* of select, to be put back before each call */
    size_t bytes;
} waiting_t;

static const sigset_t *without_wake(const sigset_t *given, sigset_t *own)
{
    if (given == NULL) return NULL;
    *own = *given;
    sigdelset(own, WAKE_SIGNAL);
    return own;
}

static long ask(const waiting_t *w, int at_once)
{
    struct timespec none = {0, 0};
    long a[6];

    memcpy(a, w->a, sizeof a);
    a[w->timeout] = w->in_ms ? (at_once ? 0 : -1) : at_once ? (long)&none : 0;
    return kernel(w->number, a[0], a[1], a[2], a[3], a[4], a[5]);
}

static long wait_until(const waiting_t *w, int64_t deadline)
{
    char *kept = w->bytes ? malloc(3 * w->bytes) : NULL;
    enum turn how = NO_TURN;
    long got;
    int i, again;

    for (i = 0; i < 3 && kept; i++)
        if (w->sets[i]) memcpy(kept + (size_t)i * w->bytes, w->sets[i], w->bytes);
    own_slot();
    got = ask(w, 1);
    again = got == 0;
    if (again && deadline <= LOAD(bus_table()->now)) {
        if (deadline >= 0) looked_in_vain();
        again = 0;
    }
    while (again) {
        for (i = 0; i < 3 && kept; i++)
            if (w->sets[i]) memcpy(w->sets[i], kept + (size_t)i * w->bytes, w->bytes);
        wait_begins(deadline, 1);
        got = ask(w, 0);
        how = wait_ends();
        again = got < 0 && errno == EINTR && how != TIME_OUT && woken_in_vain();
    }
    if (got < 0 && errno == EINTR && how == TIME_OUT) {
        got = 0;
        for (i = 0; i < 3 && kept; i++)
            if (w->sets[i]) memset(w->sets[i], 0, w->bytes);
    }
    free(kept);
    return got;
}

static int refuse(void)
{
    errno = EINVAL;
    return -1;
}

static int polled(struct pollfd *files, nfds_t count, int64_t deadline, const sigset_t *mask)
{
    sigset_t own;
    waiting_t w = {SYS_ppoll, {(long)files, (long)count, 0, 0, MASK, 0}, 2, 0, {NULL}, 0};

    if (deadline < 0) return refuse();
    w.a[3] = (long)without_wake(mask, &own);
    return (int)wait_until(&w, deadline);
}

EXPORT int poll(struct pollfd *files, nfds_t count, int milliseconds)
{
    if (bus_table() == NULL) {
        REAL(poll);
        return real(files, count, milliseconds);
    }
    return polled(files, count, deadline_in_ms(milliseconds), NULL);
}

EXPORT int ppoll(struct pollfd *files, nfds_t count, const struct timespec *timeout, const sigset_t *mask)
{
    if (bus_table() == NULL) {
        REAL(ppoll);
        return real(files, count, timeout, mask);
    }
    return polled(files, count, deadline_after(timeout), mask);
}

EXPORT int __poll_chk(struct pollfd *files, nfds_t count, int milliseconds, size_t size)
{
    (void)size;
    return poll(files, count, milliseconds);
}

EXPORT int __ppoll_chk(struct pollfd *files, nfds_t count, const struct timespec *timeout,
                       const sigset_t *mask, size_t size)
{
    (void)size;
    return ppoll(files, count, timeout, mask);
}

static int selected(int count, fd_set *sets[3], int64_t deadline, const sigset_t *mask)
{
    struct {
        const sigset_t *mask;
        size_t bytes;
    } sixth = {NULL, MASK};
    sigset_t own;
    waiting_t w = {SYS_pselect6,
                   {count, (long)sets[0], (long)sets[1], (long)sets[2], 0, (long)&sixth},
                   4,
                   0,
                   {sets[0], sets[1], sets[2]},
                   ((size_t)count + 63) / 64 * 8};

    if (deadline < 0) return refuse();
    sixth.mask = without_wake(mask, &own);
    return (int)wait_until(&w, deadline);
}

EXPORT int select(int count, fd_set *restrict in, fd_set *restrict out, fd_set *restrict failed,
                  struct timeval *restrict timeout)
{
    fd_set *sets[3] = {in, out, failed};
    struct timespec duration;
    int64_t deadline;
    int found;

    if (bus_table() == NULL) {
        REAL(select);
        return real(count, in, out, failed, timeout);
    }
    if (timeout != NULL) {
        duration.tv_sec = timeout->tv_sec + timeout->tv_usec / 1000000;
        duration.tv_nsec = timeout->tv_usec % 1000000 * 1000;
    }
    deadline = deadline_after(timeout ? &duration : NULL);
    found = selected(count, sets, deadline, NULL);
    if (timeout != NULL && deadline != NEVER) { /* as Linux does: what is left */
        const int64_t left = deadline - LOAD(bus_table()->now);

        timeout->tv_sec = left > 0 ? (time_t)(left / SECOND) : 0;
        timeout->tv_usec = left > 0 ? (suseconds_t)(left % SECOND / 1000) : 0;
    }
    return found;
}

EXPORT int pselect(int count, fd_set *restrict in, fd_set *restrict out, fd_set *restrict failed,
                   const struct timespec *restrict timeout, const sigset_t *restrict mask)
{
    fd_set *sets[3] = {in, out, failed};

    if (bus_table() == NULL) {
        REAL(pselect);
        return real(count, in, out, failed, timeout, mask);
    }
    return selected(count, sets, deadline_after(timeout), mask);
}

static int epolled(int fd, struct epoll_event *events, int most, int64_t deadline, const sigset_t *mask)
{
    sigset_t own;
    waiting_t w = {SYS_epoll_pwait, {fd, (long)events, most, 0, 0, MASK}, 3, 1, {NULL}, 0};

    if (deadline < 0) return refuse();
    w.a[4] = (long)without_wake(mask, &own);
    return (int)wait_until(&w, deadline);
}

EXPORT int epoll_pwait(int fd, struct epoll_event *events, int most, int milliseconds, const sigset_t *mask)
{
    if (bus_table() == NULL) {
        REAL(epoll_pwait);
        return real(fd, events, most, milliseconds, mask);
    }
    return epolled(fd, events, most, deadline_in_ms(milliseconds), mask);
}

EXPORT int epoll_wait(int fd, struct epoll_event *events, int most, int milliseconds)
{
    return epoll_pwait(fd, events, most, milliseconds, NULL);
}

EXPORT int epoll_pwait2(int fd, struct epoll_event *events, int most, const struct timespec *timeout,
                        const sigset_t *mask)
{
    if (bus_table() == NULL) {
        REAL(epoll_pwait2);
        return real(fd, events, most, timeout, mask);
    }
    return epolled(fd, events, most, deadline_after(timeout), mask);
}

/* A connection to the process of the bus, which answers at any moment of the wall clock. */
static int is_of_the_bus(int fd)
{
    struct ucred peer = {0};
    socklen_t length = sizeof peer;

    return !is_can(fd) && getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &length) == 0 &&
           peer.pid == bus_table()->coordinator;
}

static int blocks(int fd, int flags)
{
    const int mode = fcntl(fd, F_GETFL);

    return !(flags & MSG_DONTWAIT || mode < 0 || mode & O_NONBLOCK);
}

/* Wait until a file that blocks has something to read, or room; at once where the call does not block.
 * An answer of the bus costs a wait also if it is there already: else the order would depend on the machine. */
static void until_ready(int fd, short events, int flags)
{
    struct pollfd file = {fd, events, 0};
    waiting_t w = {SYS_ppoll, {(long)&file, 1, 0, 0, MASK, 0}, 2, 0, {NULL}, 0};
    const int before = errno;

    if (bus_table() == NULL) return;
    if (ask(&w, 1) == 0) {
        if (blocks(fd, flags)) wait_until(&w, NEVER);
        else looked_in_vain();
    } else if (is_of_the_bus(fd) && blocks(fd, flags)) {
        wait_begins(NEVER, 0);
        wait_ends();
    }
    errno = before;
}

/* A frame for a buffer, or from it. */
static ssize_t one_frame(int fd, void *buffer, size_t size, int flags, int sends)
{
    struct iovec part = {buffer, size};
    struct msghdr message = {.msg_iov = &part, .msg_iovlen = 1};

    return sends ? can_send(fd, &message, flags) : can_receive(fd, &message, flags);
}

static ssize_t from_sender(int fd, void *buffer, size_t size, int flags, void *from, socklen_t *length)
{
    struct iovec part = {buffer, size};
    struct msghdr message = {
        .msg_name = from, .msg_namelen = length ? *length : 0, .msg_iov = &part, .msg_iovlen = 1};
    const ssize_t got = can_receive(fd, &message, flags);

    if (length != NULL) *length = message.msg_namelen;
    return got;
}

static ssize_t several_parts(int fd, const struct iovec *parts, int count, int sends)
{
    struct msghdr message = {.msg_iov = (struct iovec *)parts, .msg_iovlen = (size_t)count};

    return sends ? can_send(fd, &message, 0) : can_receive(fd, &message, 0);
}

#define READER(type, name, parameters, arguments, flags, frame) \
    EXPORT type name parameters                                 \
    {                                                           \
        REAL(name);                                             \
        until_ready(fd, POLLIN, flags);                         \
        if (is_can(fd)) return (type)(frame);                   \
        return real arguments;                                  \
    }

READER(ssize_t, read, (int fd, void *to, size_t size), (fd, to, size), 0, one_frame(fd, to, size, 0, 0))
READER(ssize_t, readv, (int fd, const struct iovec *to, int count), (fd, to, count), 0,
       several_parts(fd, to, count, 0))
READER(ssize_t, recv, (int fd, void *to, size_t size, int flags), (fd, to, size, flags), flags,
       one_frame(fd, to, size, flags, 0))
READER(ssize_t, recvmsg, (int fd, struct msghdr *to, int flags), (fd, to, flags), flags,
       can_receive(fd, to, flags))
READER(ssize_t, recvfrom,
       (int fd, void *restrict to, size_t size, int flags, struct sockaddr *restrict from,
        socklen_t *restrict length),
       (fd, to, size, flags, from, length), flags, from_sender(fd, to, size, flags, from, length))
READER(int, accept, (int fd, struct sockaddr *restrict from, socklen_t *restrict length), (fd, from, length),
       0, refuse())
READER(int, accept4, (int fd, struct sockaddr *restrict from, socklen_t *restrict length, int flags),
       (fd, from, length, flags), 0, refuse())

EXPORT ssize_t __read_chk(int fd, void *to, size_t size, size_t room)
{
    (void)room;
    return read(fd, to, size);
}

EXPORT ssize_t __recv_chk(int fd, void *to, size_t size, size_t room, int flags)
{
    (void)room;
    return recv(fd, to, size, flags);
}

EXPORT ssize_t __recvfrom_chk(int fd, void *restrict to, size_t size, size_t room, int flags,
                              struct sockaddr *restrict from, socklen_t *restrict length)
{
    (void)room;
    return recvfrom(fd, to, size, flags, from, length);
}

#define WRITER(name, parameters, arguments, frame) \
    EXPORT ssize_t name parameters                 \
    {                                              \
        REAL(name);                                \
        wakes_others();                            \
        if (is_can(fd)) {                          \
            until_ready(fd, POLLOUT, 0);           \
            return frame;                          \
        }                                          \
        return real arguments;                     \
    }

WRITER(write, (int fd, const void *from, size_t size), (fd, from, size),
       one_frame(fd, (void *)from, size, 0, 1))
WRITER(writev, (int fd, const struct iovec *from, int count), (fd, from, count),
       several_parts(fd, from, count, 1))
WRITER(send, (int fd, const void *from, size_t size, int flags), (fd, from, size, flags),
       one_frame(fd, (void *)from, size, flags, 1))
WRITER(sendmsg, (int fd, const struct msghdr *from, int flags), (fd, from, flags), can_send(fd, from, flags))
WRITER(sendto,
       (int fd, const void *from, size_t size, int flags, const struct sockaddr *to, socklen_t length),
       (fd, from, size, flags, to, length), one_frame(fd, (void *)from, size, flags, 1))
