/* thread.c: a thread of a program in bus time; see thread.h. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <linux/futex.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "thread.h"

/* A thread spins if it has looked at the clock, or for something to read, 200 times without time having
 * passed, or has waited 1000 times so. From then on each of these takes time, ns: little at first, since a
 * program that waits until the clock is past a deadline needs no more. */
enum { LOOK = 10, WAIT = 2, ENOUGH = 2000, SMALL = 100, LARGE = 10000, SMALL_ONES = 100 };

static table_t *table;
static int attached, program;
static __thread slot_t *mine, *forked __attribute__((tls_model("initial-exec")));
static __thread int last_look __attribute__((tls_model("initial-exec")));
static __thread unsigned looks, taken __attribute__((tls_model("initial-exec")));
static __thread int64_t looked_at __attribute__((tls_model("initial-exec")));
static __thread int inside __attribute__((tls_model("initial-exec")));
static __thread volatile sig_atomic_t poked __attribute__((tls_model("initial-exec")));

void *real_function(void **pointer, const char *name)
{
    if (*pointer == NULL) *pointer = dlsym(RTLD_NEXT, name);
    return *pointer;
}

long kernel(long number, ...)
{
    REAL(syscall);
    va_list given;
    long a[6];
    int i;

    va_start(given, number);
    for (i = 0; i < 6; i++) a[i] = va_arg(given, long);
    va_end(given);
    return real(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}

long raw_futex(uint32_t *word, int operation, uint32_t value, const struct timespec *timeout)
{
    return kernel(SYS_futex, word, operation, value, timeout, NULL, FUTEX_BITSET_MATCH_ANY);
}

static void ring(void)
{
    ADD(table->bell, 1);
    raw_futex(&table->bell, FUTEX_WAKE, 1, NULL);
}

static void on_wake(int number)
{
    (void)number;
    poked = 1;
}

static void listen_to_wakes(void)
{
    struct sigaction action = {0};

    action.sa_handler = on_wake;
    sigaction(WAKE_SIGNAL, &action, NULL);
}

static void lock_table(void)
{
    int32_t expected = 0;
    const int32_t me = (int32_t)getpid();

    while (!__atomic_compare_exchange_n(&table->lock, &expected, me, 0, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST)) {
        if (expected != 0 && kill(expected, 0) < 0 && errno == ESRCH) STORE(table->lock, 0);
        expected = 0;
        kernel(SYS_sched_yield);
    }
}

/* A free slot of the table, which is locked. */
static slot_t *take_slot(int32_t pid, int32_t tid)
{
    slot_t *found = NULL;
    int i;

    for (i = 0; i < SLOTS && found == NULL; i++)
        if (LOAD(table->slots[i].state) == FREE) found = &table->slots[i];
    if (found == NULL) {
        static const char text[] = "cosim bus: found more than 1024 threads of programs\n";
        if (write(2, text, sizeof text - 1) < 0) {}
        _exit(2);
    }
    found->program = program;
    found->number = ADD(table->numbers[program], 1);
    found->pid = pid;
    found->tid = tid;
    found->seq = 0;
    found->turn = NO_TURN;
    found->deadline = NEVER;
    table->alarms[found - table->slots] = NEVER;
    STORE(found->state, STARTING);
    return found;
}

slot_t *new_slot(int32_t pid, int32_t tid)
{
    slot_t *found;

    lock_table();
    found = take_slot(pid, tid);
    STORE(table->lock, 0);
    return found;
}

slot_t *slot_of_process(int32_t pid)
{
    int i;

    for (i = 0; i < SLOTS; i++)
        if (LOAD(table->slots[i].state) != FREE && table->slots[i].pid == pid && table->slots[i].tid == pid)
            return &table->slots[i];
    return NULL;
}

slot_t *slot_for_process(int32_t pid)
{
    slot_t *found;

    lock_table();
    found = slot_of_process(pid);
    if (found == NULL) found = take_slot(pid, pid);
    STORE(table->lock, 0);
    return found;
}

/* Without its coordinator, time would stand still for ever: the process ends. A coordinator whose parent has
 * not asked for its end yet is dead, too. */
static void end_without_coordinator(void)
{
    char text[256], *end = NULL;
    int fd;
    long got = 0;

    snprintf(text, sizeof text, "/proc/%d/stat", table->coordinator);
    fd = (int)kernel(SYS_openat, AT_FDCWD, text, O_RDONLY | O_CLOEXEC);
    if (fd >= 0) {
        got = kernel(SYS_read, fd, text, sizeof text - 1);
        kernel(SYS_close, fd);
        text[got > 0 ? got : 0] = 0;
        end = strrchr(text, ')');
    }
    if (end == NULL || end[1] == 0 || end[2] == 'Z' || end[2] == 'X') _exit(128 + SIGTERM);
}

/* Sleep until there is a turn; true if a signal came before. */
static int sleep_for_turn(void)
{
    const struct timespec second = {1, 0};

    while (raw_futex((uint32_t *)&mine->turn, FUTEX_WAIT, NO_TURN, &second) < 0) {
        if (errno != ETIMEDOUT) return errno == EINTR;
        end_without_coordinator();
    }
    return 0;
}

static void take_turn(void)
{
    while (LOAD(mine->turn) == NO_TURN) sleep_for_turn();
}

void adopt_slot(slot_t *slot)
{
    sigset_t wake;

    mine = slot;
    looks = taken = 0;
    slot->pid = (int32_t)getpid();
    slot->tid = (int32_t)kernel(SYS_gettid);
    sigemptyset(&wake);
    sigaddset(&wake, WAKE_SIGNAL);
    kernel(SYS_rt_sigprocmask, SIG_UNBLOCK, &wake, NULL, 8);
    inside++;
    STORE(slot->turn, NO_TURN);
    STORE(slot->state, READY);
    ring();
    take_turn();
    STORE(slot->turn, NO_TURN);
    inside--;
}

slot_t *own_slot(void)
{
    if (bus_table() == NULL) return NULL;
    if (mine == NULL) { /* a thread that another library has made */
        inside++;
        adopt_slot(new_slot((int32_t)getpid(), (int32_t)kernel(SYS_gettid)));
        inside--;
    }
    return mine;
}

/* The slot of a child is made before the child: else time could pass before the child begins, and the
 * order of two children would be that in which they happen to run. */
static void before_fork(void)
{
    own_slot();
    wakes_others();
    forked = new_slot((int32_t)getpid(), 0);
}

static void in_child(void) { adopt_slot(forked); }

void fork_has_failed(void) { STORE(forked->state, FREE); }

static void attach(void)
{
    const char *path = getenv("COSIM_BUS_TABLE"), *number = getenv("COSIM_BUS_PROGRAM");
    int fd;

    attached = 1;
    if (path == NULL || number == NULL || (fd = open(path, O_RDWR | O_CLOEXEC)) < 0) return;
    table = mmap(NULL, sizeof *table, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    kernel(SYS_close, fd);
    if (table == MAP_FAILED || table->magic != MAGIC) {
        table = NULL;
        return;
    }
    program = atoi(number) % PROGRAMS;
    listen_to_wakes();
    if (getppid() == table->coordinator) prctl(PR_SET_PDEATHSIG, SIGTERM);
    pthread_atfork(before_fork, NULL, in_child);
    adopt_slot(slot_for_process((int32_t)getpid()));
}

__attribute__((constructor)) static void start(void) { bus_table(); }

table_t *bus_table(void)
{
    if (!attached) attach();
    return table;
}

static void begin(int64_t deadline, int signalled)
{
    inside++;
    poked = 0;
    mine->signalled = signalled;
    mine->deadline = deadline;
    STORE(mine->turn, NO_TURN);
    ADD(mine->seq, 1);
    STORE(mine->state, WAITING);
    ring();
}

enum turn wait_ends(void)
{
    const int before = errno;
    int32_t expected = WAITING;
    enum turn found;

    if (__atomic_compare_exchange_n(&mine->state, &expected, READY, 0, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST))
        ring();
    take_turn();
    found = (enum turn)LOAD(mine->turn);
    STORE(mine->turn, NO_TURN);
    inside--;
    errno = before;
    return found;
}

int woken_in_vain(void)
{
    const int found = poked;

    poked = 0;
    return found;
}

int sleep_until(int64_t deadline)
{
    enum turn found;
    int interrupted;

    own_slot();
    do {
        begin(deadline, 0);
        interrupted = sleep_for_turn();
        found = wait_ends();
    } while (found != TIME_OUT && !(interrupted && !woken_in_vain()));
    return found == TIME_OUT ? 0 : EINTR;
}

void wakes_others(void)
{
    last_look = 0;
    if (table != NULL) STORE(table->lease, 0);
}

/* Count a look or a wait; true if the thread spins. */
static int spins(unsigned weight)
{
    const int64_t now = LOAD(table->now);

    if (now > looked_at + LARGE) looks = taken = 0; /* time has passed by a wait */
    looked_at = now;
    looks += weight;
    if (looks <= ENOUGH) return 0;
    looks = ENOUGH;
    return 1;
}

static void take_time(void)
{
    const int64_t until = LOAD(table->now) + (taken < SMALL_ONES ? SMALL : LARGE);

    taken++;
    if (until < LOAD(table->lease)) STORE(table->now, until);
    else sleep_until(until);
}

void has_a_lock(void)
{
    if (last_look && looks >= LOOK) looks -= LOOK;
    last_look = 0;
}

void looked_in_vain(void)
{
    const int before = errno;

    if (own_slot() != NULL && !inside && spins(LOOK)) take_time();
    last_look = 1;
    errno = before;
}

void wait_begins(int64_t deadline, int signalled)
{
    const int before = errno;

    if (own_slot() != NULL && !inside && spins(WAIT)) take_time();
    begin(deadline, signalled);
    errno = before;
}

int64_t bus_now(void)
{
    looked_in_vain();
    return LOAD(table->now);
}

static int64_t to_ns(const struct timespec *t)
{
    if (t->tv_nsec < 0 || t->tv_nsec >= SECOND) return -1;
    if (t->tv_sec < 0) return 0;
    if (t->tv_sec > INT64_MAX / SECOND / 4) return NEVER;
    return (int64_t)t->tv_sec * SECOND + t->tv_nsec;
}

static int64_t later(int64_t ns) { return ns < 0 ? -1 : ns > NEVER / 2 ? NEVER : LOAD(table->now) + ns; }

int64_t deadline_after(const struct timespec *duration)
{
    return duration == NULL ? NEVER : later(to_ns(duration));
}

int64_t deadline_in_ms(int milliseconds)
{
    return milliseconds < 0 ? NEVER : later((int64_t)milliseconds * 1000000);
}

int clock_offset(clockid_t clock, int64_t *offset)
{
    switch (clock) {
    case CLOCK_REALTIME:
    case CLOCK_REALTIME_COARSE:
    case CLOCK_REALTIME_ALARM:
    case CLOCK_TAI: *offset = table->date; return 1;
    case CLOCK_MONOTONIC:
    case CLOCK_MONOTONIC_RAW:
    case CLOCK_MONOTONIC_COARSE:
    case CLOCK_BOOTTIME:
    case CLOCK_BOOTTIME_ALARM: *offset = table->monotonic; return 1;
    default: return 0;
    }
}

int64_t deadline_at(clockid_t clock, const struct timespec *when)
{
    int64_t offset, ns;

    if (when == NULL) return NEVER;
    if (!clock_offset(clock, &offset) || (ns = to_ns(when)) < 0) return -1;
    if (ns == NEVER) return NEVER;
    return ns > offset ? ns - offset : 0;
}

struct timespec to_timespec(int64_t ns)
{
    struct timespec t;

    t.tv_sec = (time_t)(ns / SECOND);
    t.tv_nsec = (long)(ns % SECOND);
    return t;
}
