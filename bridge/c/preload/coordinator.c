/* coordinator.c: the side of `cosim bus`, which decides when time passes and which thread runs next
 *
 * A thread waits if its slot is WAITING and the kernel says that it sleeps: a thread that another one has
 * woken runs for the kernel before the call that woke it returns. Two rounds over all threads, in which no
 * thread has begun another wait, show that all of them wait at the same time. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <linux/futex.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "thread.h"

/* A thread that sleeps in a call that is not covered counts as waiting after this time of the wall clock. */
enum { PATIENCE = 50000000, BACK_OFF_LEAST = 20000, BACK_OFF_MOST = 1000000, YIELDS = 30 };

typedef struct {
    int stat, pid, tid;
    uint32_t seq;
    int64_t asleep_since, runtime; /* of a thread in a call that is not covered, ns; runtime -1: not yet */
} watch_t;

typedef struct {
    table_t *table;
    int culprit;
    watch_t watched[SLOTS];
} coordinator_t;

static int64_t wall_ns(void)
{
    struct timespec t;

    kernel(SYS_clock_gettime, CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * SECOND + t.tv_nsec;
}

/* A coordinator with its table in the new file `path`; null where that cannot be made. */
EXPORT coordinator_t *coordinator_make(const char *path, int64_t date, int64_t monotonic)
{
    coordinator_t *c = calloc(1, sizeof *c);
    const int fd = open(path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
    int i;

    if (c == NULL || fd < 0 || ftruncate(fd, sizeof *c->table) < 0) return NULL;
    c->table = mmap(NULL, sizeof *c->table, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    kernel(SYS_close, fd);
    if (c->table == MAP_FAILED) return NULL;
    c->table->coordinator = (int32_t)getpid();
    c->table->date = date;
    c->table->monotonic = monotonic;
    for (i = 0; i < SLOTS; i++) {
        c->table->alarms[i] = NEVER;
        c->watched[i].stat = -1;
    }
    STORE(c->table->magic, MAGIC);
    return c;
}

EXPORT void coordinator_free(coordinator_t *c)
{
    int i;

    for (i = 0; i < SLOTS; i++)
        if (c->watched[i].stat >= 0) kernel(SYS_close, c->watched[i].stat);
    munmap(c->table, sizeof *c->table);
    free(c);
}

/* The state of a thread by the kernel, 'S' for one that sleeps; 'X' if it is gone. */
static char state_of(watch_t *w, const slot_t *s)
{
    char text[128], *end;
    ssize_t got;

    if (w->stat < 0 || w->pid != s->pid || w->tid != s->tid) {
        if (w->stat >= 0) kernel(SYS_close, w->stat);
        w->pid = s->pid;
        w->tid = s->tid;
        snprintf(text, sizeof text, "/proc/%d/task/%d/stat", w->pid, w->tid ? w->tid : w->pid);
        w->stat = open(text, O_RDONLY | O_CLOEXEC);
        w->asleep_since = 0;
        w->runtime = -1;
        if (w->stat < 0) return 'X';
    }
    got = pread(w->stat, text, sizeof text - 1, 0);
    if (got <= 0) return 'X';
    text[got] = 0;
    end = strrchr(text, ')');
    if (end == NULL || end + 2 >= text + got) return 'R';
    return end[2] == 'Z' ? 'X' : end[2];
}

static int64_t runtime_of(const slot_t *s)
{
    char text[64];
    long long found = -1;
    FILE *file;

    snprintf(text, sizeof text, "/proc/%d/task/%d/schedstat", s->pid, s->tid);
    file = fopen(text, "re");
    if (file == NULL) return -1;
    if (fscanf(file, "%lld", &found) != 1) found = -1;
    fclose(file);
    return found;
}

/* A thread that sleeps without having said that it waits: true once it has done so for long. */
static int has_slept_long(watch_t *w, const slot_t *s)
{
    const int64_t runtime = runtime_of(s), now = wall_ns();

    if (runtime != w->runtime || runtime < 0) {
        w->runtime = runtime;
        w->asleep_since = now;
    }
    return now - w->asleep_since > PATIENCE;
}

static int all_wait(coordinator_t *c, int again)
{
    int i;

    for (i = 0; i < SLOTS; i++) {
        slot_t *s = &c->table->slots[i];
        watch_t *w = &c->watched[i];
        const int32_t state = LOAD(s->state);
        char kernels;

        if (state == FREE) continue;
        kernels = state_of(w, s);
        if (kernels == 'X') {
            if (s->tid == s->pid) STORE(c->table->alarms[i], NEVER);
            STORE(s->state, FREE);
            kernel(SYS_close, w->stat);
            w->stat = -1;
            return 0;
        }
        if (state != READY && !(state == WAITING && kernels == 'S') &&
            !(state == RUNNING && kernels == 'S' && has_slept_long(w, s))) {
            c->culprit = i;
            return 0;
        }
        if (again && w->seq != LOAD(s->seq)) return 0;
        w->seq = LOAD(s->seq);
    }
    return 1;
}

/* Wait until all threads wait, at most `most` (ns of the wall clock); true if they do. */
EXPORT int coordinator_settle(coordinator_t *c, int64_t most)
{
    const int64_t start = wall_ns();
    struct timespec pause = {0, BACK_OFF_LEAST};
    int tries = 0;

    for (;;) {
        const uint32_t bell = LOAD(c->table->bell);

        if (all_wait(c, 0) && all_wait(c, 1)) return 1;
        if (wall_ns() - start > most) return 0;
        if (++tries < YIELDS) {
            kernel(SYS_sched_yield);
            continue;
        }
        raw_futex(&c->table->bell, FUTEX_WAIT, bell, &pause);
        if (pause.tv_nsec < BACK_OFF_MOST) pause.tv_nsec *= 2;
    }
}

/* The first thread, by program and number, that can go on now: its slot, or -1. */
EXPORT int32_t coordinator_next(const coordinator_t *c)
{
    const table_t *t = c->table;
    int32_t best = -1;
    int i;

    for (i = 0; i < SLOTS; i++) {
        const slot_t *s = &t->slots[i], *b = &t->slots[best < 0 ? i : best];
        const int32_t state = LOAD(s->state);

        if (state != READY && !(state == WAITING && s->deadline <= LOAD(t->now))) continue;
        if (best < 0 || s->program < b->program || (s->program == b->program && s->number < b->number))
            best = i;
    }
    return best;
}

/* The earliest time at which a thread that waits continues, or an alarm comes, ns; INT64_MAX: none. */
EXPORT int64_t coordinator_earliest(const coordinator_t *c)
{
    int64_t best = NEVER;
    int i;

    for (i = 0; i < SLOTS; i++) {
        const slot_t *s = &c->table->slots[i];
        const int64_t due = LOAD(c->table->alarms[i]);

        if (LOAD(s->state) == WAITING && s->deadline < best) best = s->deadline;
        if (due < best) best = due;
    }
    return best;
}

EXPORT int64_t coordinator_now(const coordinator_t *c) { return LOAD(c->table->now); }

/* Set bus time, ns, and send the alarms that are due. */
EXPORT void coordinator_advance(coordinator_t *c, int64_t now)
{
    table_t *t = c->table;
    int i;

    STORE(t->now, now);
    for (i = 0; i < SLOTS; i++) {
        const int64_t due = LOAD(t->alarms[i]), interval = LOAD(t->intervals[i]);

        if (due > now || LOAD(t->slots[i].state) == FREE) continue;
        STORE(t->alarms[i], interval > 0 ? due + interval : NEVER);
        kill(t->slots[i].pid, SIGALRM);
    }
}

/* The time until which a thread may let time pass by itself: until another one, or the bus, has to act. */
static int64_t lease_of(const coordinator_t *c, int32_t place, int64_t horizon)
{
    int64_t best = horizon;
    int i;

    for (i = 0; i < SLOTS; i++) {
        const slot_t *s = &c->table->slots[i];
        const int32_t state = LOAD(s->state);
        const int64_t due = LOAD(c->table->alarms[i]);

        if (due < best) best = due;
        if (i == place || state == FREE) continue;
        if (state != WAITING && state != RUNNING) return 0;
        if (state == WAITING && s->deadline < best) best = s->deadline;
    }
    return best;
}

/* Let a thread go on; nothing else happens before `horizon`, ns. */
EXPORT void coordinator_grant(coordinator_t *c, int32_t place, int64_t horizon)
{
    slot_t *s = &c->table->slots[place];
    int32_t waiting = WAITING;

    STORE(c->table->lease, lease_of(c, place, horizon));
    if (__atomic_compare_exchange_n(&s->state, &waiting, RUNNING, 0, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST)) {
        STORE(s->turn, TIME_OUT);
        if (s->signalled) kernel(SYS_tgkill, s->pid, s->tid, WAKE_SIGNAL);
    } else {
        STORE(s->state, RUNNING);
        STORE(s->turn, GO_ON);
    }
    raw_futex((uint32_t *)&s->turn, FUTEX_WAKE, 1, NULL);
}

/* End the lease: something else may happen earlier. */
EXPORT void coordinator_revoke(coordinator_t *c) { STORE(c->table->lease, 0); }

/* Let coordinator_settle look again. */
EXPORT void coordinator_ring(coordinator_t *c)
{
    ADD(c->table->bell, 1);
    raw_futex(&c->table->bell, FUTEX_WAKE, 1, NULL);
}

/* The number of threads that a program has had. */
EXPORT int32_t coordinator_threads(const coordinator_t *c, int32_t program)
{
    return LOAD(c->table->numbers[program]);
}

/* A thread that did not wait when coordinator_settle looked last: program, number, pid, tid. */
EXPORT void coordinator_culprit(const coordinator_t *c, int32_t out[4])
{
    const slot_t *s = &c->table->slots[c->culprit];

    out[0] = s->program;
    out[1] = s->number;
    out[2] = s->pid;
    out[3] = s->tid;
}
