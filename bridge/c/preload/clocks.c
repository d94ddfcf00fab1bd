/* clocks.c: the clocks and sleeps of the C library in bus time */
#define _GNU_SOURCE
#include <errno.h>
#include <signal.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <unistd.h>

#include "thread.h"

EXPORT int clock_gettime(clockid_t clock, struct timespec *out)
{
    int64_t offset;

    if (bus_table() == NULL || !clock_offset(clock, &offset))
        return (int)kernel(SYS_clock_gettime, clock, out); /* of processes and threads: the machine's */
    *out = to_timespec(bus_now() + offset);
    return 0;
}

EXPORT int gettimeofday(struct timeval *restrict out, void *restrict zone)
{
    struct timespec now;

    (void)zone;
    clock_gettime(CLOCK_REALTIME, &now);
    out->tv_sec = now.tv_sec;
    out->tv_usec = now.tv_nsec / 1000;
    return 0;
}

EXPORT time_t time(time_t *out)
{
    struct timespec now;

    clock_gettime(CLOCK_REALTIME, &now);
    if (out != NULL) *out = now.tv_sec;
    return now.tv_sec;
}

EXPORT int timespec_get(struct timespec *out, int base)
{
    if (base != TIME_UTC) return 0;
    clock_gettime(CLOCK_REALTIME, out);
    return base;
}

/* Sleep until a deadline of the bus; an error number, and what is left, ns. */
static int slept(int64_t deadline, int64_t *left)
{
    int found;

    *left = 0;
    if (deadline < 0) return EINVAL;
    if (deadline <= LOAD(bus_table()->now)) {
        looked_in_vain();
        return 0;
    }
    found = sleep_until(deadline);
    if (found) *left = deadline - LOAD(bus_table()->now);
    return found;
}

EXPORT int clock_nanosleep(clockid_t clock, int flags, const struct timespec *wanted, struct timespec *left)
{
    int64_t offset, remaining;
    int found;

    if (bus_table() == NULL || !clock_offset(clock, &offset))
        return kernel(SYS_clock_nanosleep, clock, flags, wanted, left) < 0 ? errno : 0;
    found = slept(flags & TIMER_ABSTIME ? deadline_at(clock, wanted) : deadline_after(wanted), &remaining);
    if (found == EINTR && left != NULL && !(flags & TIMER_ABSTIME)) *left = to_timespec(remaining);
    return found;
}

EXPORT int nanosleep(const struct timespec *wanted, struct timespec *left)
{
    const int found = clock_nanosleep(CLOCK_MONOTONIC, 0, wanted, left);

    if (found) errno = found;
    return found ? -1 : 0;
}

EXPORT int usleep(useconds_t microseconds)
{
    const struct timespec wanted = to_timespec((int64_t)microseconds * 1000);

    return nanosleep(&wanted, NULL);
}

EXPORT unsigned sleep(unsigned seconds)
{
    const struct timespec wanted = {(time_t)seconds, 0};
    struct timespec left;

    if (nanosleep(&wanted, &left) == 0) return 0;
    return (unsigned)left.tv_sec + (left.tv_nsec > 0);
}

EXPORT int sched_yield(void)
{
    if (bus_table() == NULL) return (int)kernel(SYS_sched_yield);
    looked_in_vain();
    return 0;
}

static int64_t from_timeval(const struct timeval *t)
{
    return (int64_t)t->tv_sec * SECOND + (int64_t)t->tv_usec * 1000;
}

static struct timeval to_timeval(int64_t ns)
{
    const struct timeval t = {(time_t)(ns / SECOND), (suseconds_t)(ns % SECOND / 1000)};

    return t;
}

EXPORT int getitimer(__itimer_which_t which, struct itimerval *out)
{
    slot_t *process = bus_table() ? slot_of_process((int32_t)getpid()) : NULL;
    const long place = process ? process - bus_table()->slots : 0;
    int64_t due;

    if (process == NULL || which != ITIMER_REAL) return (int)kernel(SYS_getitimer, which, out);
    due = LOAD(bus_table()->alarms[place]);
    out->it_value = to_timeval(due == NEVER ? 0 : due - LOAD(bus_table()->now));
    out->it_interval = to_timeval(LOAD(bus_table()->intervals[place]));
    return 0;
}

EXPORT int setitimer(__itimer_which_t which, const struct itimerval *restrict wanted,
                     struct itimerval *restrict before)
{
    slot_t *process = bus_table() ? slot_of_process((int32_t)getpid()) : NULL;
    const long place = process ? process - bus_table()->slots : 0;
    int64_t ns;

    if (process == NULL || which != ITIMER_REAL) return (int)kernel(SYS_setitimer, which, wanted, before);
    if (before != NULL) getitimer(which, before);
    ns = from_timeval(&wanted->it_value);
    wakes_others();
    STORE(bus_table()->intervals[place], from_timeval(&wanted->it_interval));
    STORE(bus_table()->alarms[place], ns ? LOAD(bus_table()->now) + ns : NEVER);
    return 0;
}

EXPORT unsigned alarm(unsigned seconds)
{
    const struct itimerval wanted = {{0, 0}, {(time_t)seconds, 0}};
    struct itimerval before = {{0, 0}, {0, 0}};

    setitimer(ITIMER_REAL, &wanted, &before);
    return (unsigned)before.it_value.tv_sec + (before.it_value.tv_usec > 0);
}
