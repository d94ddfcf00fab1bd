/* mail.c: see mail.h */
#define _GNU_SOURCE
#include "mail.h"

#include <string.h>
#include <unistd.h>

#include "pace.h"

#if defined(__linux__)

#include <linux/futex.h>
#include <sys/syscall.h>
#include <time.h>

static void sleep_until(uint32_t *asleep, int64_t deadline_ns)
{
    const struct timespec until = {deadline_ns / 1000000000, deadline_ns % 1000000000};

    syscall(SYS_futex, asleep, FUTEX_WAIT_BITSET_PRIVATE, 1, &until, NULL, FUTEX_BITSET_MATCH_ANY);
}

static void wake(uint32_t *asleep) { syscall(SYS_futex, asleep, FUTEX_WAKE_PRIVATE, 1, NULL, NULL, 0); }

#else

enum { LOOK_NS = 30000 };

static void sleep_until(uint32_t *asleep, int64_t deadline_ns)
{
    const int64_t look = pace_now() + LOOK_NS;

    (void)asleep;
    pace_wait(look < deadline_ns ? look : deadline_ns, 0, NULL);
}

static void wake(uint32_t *asleep) { (void)asleep; }

#endif

static int32_t empty(const ring_t *ring)
{
    return __atomic_load_n(&ring->head, __ATOMIC_SEQ_CST) == ring->tail;
}

int32_t mail_bring(ring_t *ring, uint32_t id, const void *data, int64_t length)
{
    frame_t frame = {.t_ns = pace_now(), .id = id, .length = (uint16_t)length};

    if (length > FRAME_DATA) {
        __atomic_store_n(&ring->dropped, ring->dropped + 1, __ATOMIC_RELAXED);
        return MAIL_FULL;
    }
    memcpy(frame.data, data, (size_t)length);
    if (!ring_put(ring, &frame)) return MAIL_FULL;
    __atomic_thread_fence(__ATOMIC_SEQ_CST); /* either it sees the frame, or this its sleep */
    return __atomic_load_n(&ring->asleep, __ATOMIC_RELAXED) ? MAIL_ASLEEP : MAIL_BROUGHT;
}

void mail_wake(ring_t *ring)
{
    __atomic_store_n(&ring->asleep, 0, __ATOMIC_SEQ_CST);
    wake(&ring->asleep);
}

int32_t mail_wait(ring_t *ring, int64_t deadline_ns)
{
    while (empty(ring) && pace_now() < deadline_ns) {
        __atomic_store_n(&ring->asleep, 1, __ATOMIC_SEQ_CST);
        if (empty(ring)) sleep_until(&ring->asleep, deadline_ns);
    }
    __atomic_store_n(&ring->asleep, 0, __ATOMIC_RELAXED);
    return !empty(ring);
}

int32_t mail_next(ring_t *ring, int32_t fd, frame_t *frame)
{
    char counted[256]; /* an eventfd gives 8 bytes, a pipe one write after the other */

    if (ring_get(ring, frame)) return 1;
    if (read(fd, counted, sizeof counted) < 0) return 0; /* a signal */
    return ring_get(ring, frame);
}
