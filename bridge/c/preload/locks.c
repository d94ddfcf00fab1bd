/* locks.c: semaphores, conditions, mutexes and futexes in bus time
 *
 * A condition is a counter that changes with each signal. So a wait for it is one system call, which the
 * coordinator can end; that of the C library calls again by itself. */
#define _GNU_SOURCE
#include <errno.h>
#include <limits.h>
#include <linux/futex.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdarg.h>
#include <string.h>
#include <sys/syscall.h>

#include "thread.h"

enum { LOOK = 100000 /* a mutex with a time-out is tried so often, ns */ };

typedef struct {
    uint32_t counter;
    int32_t clock;
} condition_t;

static condition_t *as_condition(pthread_cond_t *c) { return (condition_t *)(void *)c; }

static int try_semaphore(sem_t *semaphore)
{
    REAL(sem_trywait);
    const int found = real(semaphore);

    if (found == 0) has_a_lock();
    return found;
}

EXPORT int sem_trywait(sem_t *semaphore)
{
    const int found = try_semaphore(semaphore);

    if (found < 0 && errno == EAGAIN && bus_table()) looked_in_vain();
    return found;
}

static int wait_for_semaphore(sem_t *semaphore, int64_t deadline)
{
    REAL(sem_wait);
    enum turn how;
    int got;

    if (try_semaphore(semaphore) == 0) return 0;
    if (errno != EAGAIN) return -1;
    if (deadline < 0) {
        errno = EINVAL;
        return -1;
    }
    if (deadline <= LOAD(bus_table()->now)) {
        looked_in_vain();
        errno = ETIMEDOUT;
        return -1;
    }
    do {
        wait_begins(deadline, 1);
        got = real(semaphore);
        how = wait_ends();
    } while (got < 0 && errno == EINTR && how != TIME_OUT && woken_in_vain());
    if (got < 0 && how == TIME_OUT) errno = ETIMEDOUT;
    return got;
}

EXPORT int sem_wait(sem_t *semaphore)
{
    REAL(sem_wait);

    return bus_table() ? wait_for_semaphore(semaphore, NEVER) : real(semaphore);
}

EXPORT int sem_timedwait(sem_t *restrict semaphore, const struct timespec *restrict when)
{
    REAL(sem_timedwait);

    return bus_table() ? wait_for_semaphore(semaphore, deadline_at(CLOCK_REALTIME, when))
                       : real(semaphore, when);
}

EXPORT int sem_clockwait(sem_t *restrict semaphore, clockid_t clock, const struct timespec *restrict when)
{
    REAL(sem_clockwait);

    return bus_table() ? wait_for_semaphore(semaphore, deadline_at(clock, when))
                       : real(semaphore, clock, when);
}

EXPORT int sem_post(sem_t *semaphore)
{
    REAL(sem_post);

    wakes_others();
    return real(semaphore);
}

static int lock_mutex(pthread_mutex_t *mutex, int64_t deadline)
{
    REAL(pthread_mutex_lock);
    int got = pthread_mutex_trylock(mutex);

    while (got == EBUSY && deadline != NEVER) {
        if (deadline <= LOAD(bus_table()->now)) return deadline < 0 ? EINVAL : ETIMEDOUT;
        sleep_until(LOAD(bus_table()->now) + LOOK);
        got = pthread_mutex_trylock(mutex);
    }
    if (got != EBUSY) return got;
    wait_begins(NEVER, 0);
    got = real(mutex);
    wait_ends();
    return got;
}

EXPORT int pthread_mutex_lock(pthread_mutex_t *mutex)
{
    REAL(pthread_mutex_lock);

    return own_slot() ? lock_mutex(mutex, NEVER) : real(mutex);
}

EXPORT int pthread_mutex_timedlock(pthread_mutex_t *restrict mutex, const struct timespec *restrict when)
{
    REAL(pthread_mutex_timedlock);

    return own_slot() ? lock_mutex(mutex, deadline_at(CLOCK_REALTIME, when)) : real(mutex, when);
}

EXPORT int pthread_mutex_clocklock(pthread_mutex_t *restrict mutex, clockid_t clock,
                                   const struct timespec *restrict when)
{
    REAL(pthread_mutex_clocklock);

    return own_slot() ? lock_mutex(mutex, deadline_at(clock, when)) : real(mutex, clock, when);
}

EXPORT int pthread_mutex_unlock(pthread_mutex_t *mutex)
{
    REAL(pthread_mutex_unlock);

    wakes_others();
    return real(mutex);
}

EXPORT int pthread_cond_init(pthread_cond_t *restrict c, const pthread_condattr_t *restrict attributes)
{
    REAL(pthread_cond_init);
    clockid_t clock = CLOCK_REALTIME;

    if (bus_table() == NULL) return real(c, attributes);
    if (attributes != NULL) pthread_condattr_getclock(attributes, &clock);
    memset(c, 0, sizeof *c);
    as_condition(c)->clock = (int32_t)clock;
    return 0;
}

EXPORT int pthread_cond_destroy(pthread_cond_t *c)
{
    REAL(pthread_cond_destroy);

    return bus_table() ? 0 : real(c);
}

static int change(pthread_cond_t *c, uint32_t most)
{
    wakes_others();
    ADD(as_condition(c)->counter, 1);
    raw_futex(&as_condition(c)->counter, FUTEX_WAKE, most, NULL);
    return 0;
}

EXPORT int pthread_cond_signal(pthread_cond_t *c)
{
    REAL(pthread_cond_signal);

    return bus_table() ? change(c, 1) : real(c);
}

EXPORT int pthread_cond_broadcast(pthread_cond_t *c)
{
    REAL(pthread_cond_broadcast);

    return bus_table() ? change(c, INT_MAX) : real(c);
}

static int wait_for_change(pthread_cond_t *c, pthread_mutex_t *mutex, int64_t deadline)
{
    uint32_t *counter = &as_condition(c)->counter;
    const uint32_t before = LOAD(*counter);
    enum turn how = NO_TURN;

    own_slot();
    if (deadline < 0) return EINVAL;
    pthread_mutex_unlock(mutex);
    if (deadline <= LOAD(bus_table()->now)) {
        looked_in_vain();
        how = TIME_OUT;
    }
    while (LOAD(*counter) == before && how != TIME_OUT) {
        wait_begins(deadline, 1);
        raw_futex(counter, FUTEX_WAIT, before, NULL);
        how = wait_ends();
    }
    pthread_mutex_lock(mutex);
    return how == TIME_OUT && LOAD(*counter) == before ? ETIMEDOUT : 0;
}

EXPORT int pthread_cond_wait(pthread_cond_t *restrict c, pthread_mutex_t *restrict mutex)
{
    REAL(pthread_cond_wait);

    return bus_table() ? wait_for_change(c, mutex, NEVER) : real(c, mutex);
}

EXPORT int pthread_cond_timedwait(pthread_cond_t *restrict c, pthread_mutex_t *restrict mutex,
                                  const struct timespec *restrict when)
{
    REAL(pthread_cond_timedwait);

    return bus_table() ? wait_for_change(c, mutex, deadline_at((clockid_t)as_condition(c)->clock, when))
                       : real(c, mutex, when);
}

EXPORT int pthread_cond_clockwait(pthread_cond_t *restrict c, pthread_mutex_t *restrict mutex,
                                  clockid_t clock, const struct timespec *restrict when)
{
    REAL(pthread_cond_clockwait);

    return bus_table() ? wait_for_change(c, mutex, deadline_at(clock, when)) : real(c, mutex, clock, when);
}

EXPORT int pthread_join(pthread_t thread, void **result)
{
    REAL(pthread_join);
    int found;

    if (own_slot() == NULL) return real(thread, result);
    wait_begins(NEVER, 0);
    found = real(thread, result);
    wait_ends();
    return found;
}

/* FUTEX_WAIT has a duration, FUTEX_WAIT_BITSET a time. */
static long wait_at_futex(const long a[6])
{
    const int operation = (int)a[1], command = operation & ~(FUTEX_PRIVATE_FLAG | FUTEX_CLOCK_REALTIME);
    const struct timespec *given = (const struct timespec *)a[3];
    const clockid_t clock = operation & FUTEX_CLOCK_REALTIME ? CLOCK_REALTIME : CLOCK_MONOTONIC;
    const int64_t deadline = command == FUTEX_WAIT ? deadline_after(given) : deadline_at(clock, given);
    enum turn how;
    long got;

    if (deadline < 0) {
        errno = EINVAL;
        return -1;
    }
    if (LOAD(*(uint32_t *)a[0]) != (uint32_t)a[2]) {
        errno = EAGAIN;
        return -1;
    }
    if (deadline <= LOAD(bus_table()->now)) {
        looked_in_vain();
        errno = ETIMEDOUT;
        return -1;
    }
    do {
        wait_begins(deadline, 1);
        got = kernel(SYS_futex, a[0], a[1] & ~(long)FUTEX_CLOCK_REALTIME, a[2], NULL, a[4], a[5]);
        how = wait_ends();
    } while (got < 0 && errno == EINTR && how != TIME_OUT && woken_in_vain());
    if (got < 0 && how == TIME_OUT) errno = ETIMEDOUT;
    return got;
}

/* The function `syscall`, by the name that the linker knows. */
EXPORT long any_call(long number, ...) __asm__("syscall");

EXPORT long any_call(long number, ...)
{
    va_list given;
    long a[6];
    int i;

    va_start(given, number);
    for (i = 0; i < 6; i++) a[i] = va_arg(given, long);
    va_end(given);
    if (bus_table() != NULL) {
        const int command = (int)a[1] & ~(FUTEX_PRIVATE_FLAG | FUTEX_CLOCK_REALTIME);

        if (number == SYS_futex && (command == FUTEX_WAIT || command == FUTEX_WAIT_BITSET))
            return wait_at_futex(a);
        if (number == SYS_clock_gettime) return clock_gettime((clockid_t)a[0], (struct timespec *)a[1]);
        if (number == SYS_nanosleep) return nanosleep((void *)a[0], (void *)a[1]);
        if (number == SYS_futex) wakes_others();
    }
    return kernel(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}
