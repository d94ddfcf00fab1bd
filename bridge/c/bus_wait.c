/* bus_wait.c: sleep until a frame has arrived; see bus_wait.h */
#define _GNU_SOURCE
#include "bus_wait.h"

#include "pace.h"

enum { LOOK_NS = 500000, BUSES = 16, SECOND = 1000000000 };

static int64_t earlier(int64_t a, int64_t b) { return a < b ? a : b; }

#ifdef __linux__
#include <poll.h>
#include <time.h>
#include <unistd.h>

/* The descriptor that signals an arrival; -1: none. */
static int descriptor(const bus_t *bus)
{
    if (bus->kind == BUS_SOCKET) return bus->fd;
    return bus->rx->bell > 0 ? bus->rx->bell : -1;
}

/* Resets the bells that have rung. */
static void silence(const bus_t *bus)
{
    uint64_t rung;

    if (bus->kind != BUS_SOCKET && read(bus->rx->bell, &rung, sizeof rung) < 0) return;
}

void bus_wait(const bus_t *buses, int32_t n, int64_t deadline_ns)
{
    struct pollfd ends[BUSES];
    const int64_t now = pace_now();
    int32_t i, broken = 0;

    for (i = 0; i < n && i < BUSES; i++) {
        ends[i] = (struct pollfd){.fd = descriptor(buses + i), .events = POLLIN};
        if (ends[i].fd < 0) deadline_ns = earlier(deadline_ns, now + LOOK_NS);
    }
    if (deadline_ns <= now) return;
    const struct timespec rest = {(deadline_ns - now) / SECOND, (deadline_ns - now) % SECOND};
    if (ppoll(ends, (nfds_t)i, &rest, 0) <= 0) return;
    while (i-- > 0) {
        if (ends[i].revents & POLLIN) silence(buses + i);
        else broken |= ends[i].revents;
    }
    if (broken) /* an interface that is down: no reason to run in circles */
        pace_wait(earlier(deadline_ns, now + LOOK_NS), 0, 0);
}

#else

void bus_wait(const bus_t *buses, int32_t n, int64_t deadline_ns)
{
    (void)buses, (void)n;
    pace_wait(earlier(deadline_ns, pace_now() + LOOK_NS), 0, 0);
}

#endif
