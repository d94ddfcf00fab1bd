/* mailbox.c: see mailbox.h */
#define _GNU_SOURCE
#include "mailbox.h"

#if !defined(_WIN32) && !defined(__wasm__)

#include <errno.h>
#include <poll.h>
#include <unistd.h>

#if defined(__linux__)
#include <linux/futex.h>
#include <sys/syscall.h>
#include <time.h>
#endif

enum { NAP_MS = 50, GRACE_MS = 1000, LOOKS = 500, EAGER = 16, CALM = 1000 };
enum { WOKEN, NOTHING, GONE };

static int arrived(const uint32_t *count, uint32_t seen)
{
    return __atomic_load_n(count, __ATOMIC_SEQ_CST) != seen;
}

/* Look for a few microseconds. If that has failed often, only now and then: the other side may take
 * longer, or have to wait for this processor. */
static int look(mail_end_t *x, const uint32_t *count)
{
    if (!x->eager && ++x->calm < CALM) return arrived(count, x->seen);
    x->calm = 0;
    for (int i = 0; i < LOOKS; i++) {
        if (arrived(count, x->seen)) {
            x->eager = EAGER;
            return 1;
        }
#if defined(__x86_64__) || defined(__i386__)
        __builtin_ia32_pause();
#elif defined(__aarch64__)
        __asm__ volatile("isb");
#endif
    }
    if (x->eager) x->eager--;
    return 0;
}

/* Whether the other side has closed its pipe; in `wait_ms`, a byte of it may come, which is taken. */
static int nap_pipe(const mail_end_t *x, int wait_ms, int *byte)
{
    struct pollfd pipe = {x->incoming, x->bytes ? POLLIN : 0, 0};
    char taken;

    if (poll(&pipe, 1, wait_ms) < 1) return NOTHING;
    if (pipe.revents & POLLIN && read(x->incoming, &taken, 1) == 1) return *byte = 1, WOKEN;
    return pipe.revents & (POLLHUP | POLLERR | POLLNVAL | POLLIN) ? GONE : NOTHING;
}

static int nap(const mail_end_t *x, uint32_t *asleep, int *byte)
{
#if defined(__linux__)
    if (!x->bytes) {
        const struct timespec most = {0, NAP_MS * 1000000};
        if (!syscall(SYS_futex, asleep, FUTEX_WAIT, 1, &most, NULL, 0) || errno != ETIMEDOUT) return WOKEN;
        return nap_pipe(x, 0, byte);
    }
#endif
    (void)asleep;
    return nap_pipe(x, NAP_MS, byte);
}

/* Wait until the other side has brought something: LOST_NOT, or why not. `patience` (s): infinity for
 * ever. */
static int await(mail_end_t *x, const uint32_t *count, uint32_t *asleep, double patience)
{
    double waited = 0.0;
    int byte = 0, lost = LOST_NOT, stopped = 0;

    if (look(x, count)) return LOST_NOT;
    __atomic_store_n(asleep, 1, __ATOMIC_SEQ_CST);
    while (lost == LOST_NOT && !arrived(count, x->seen)) {
        const int found = nap(x, asleep, &byte);
        if (found == GONE) lost = LOST_ENDED;
        if (found != NOTHING) continue;
        waited += NAP_MS * 1e-3;
        if (!stopped && x->stop && *(const volatile int32_t *)x->stop) {
            stopped = x->box->stop = 1;
            if (patience > waited + GRACE_MS * 1e-3) patience = waited + GRACE_MS * 1e-3;
        }
        if (waited >= patience) lost = stopped ? LOST_STOPPED : LOST_LATE;
    }
    if (!__atomic_exchange_n(asleep, 0, __ATOMIC_SEQ_CST) && x->bytes && !byte)
        while (nap_pipe(x, NAP_MS, &byte) == NOTHING) /* it is on its way */
            ;
    return arrived(count, x->seen) ? LOST_NOT : lost;
}

/* Count one more, and wake who waits for it. */
static void bring(const mail_end_t *x, uint32_t *count, uint32_t *asleep)
{
    __atomic_store_n(count, *count + 1, __ATOMIC_SEQ_CST);
    if (!__atomic_exchange_n(asleep, 0, __ATOMIC_SEQ_CST)) return;
#if defined(__linux__)
    if (!x->bytes) {
        syscall(SYS_futex, asleep, FUTEX_WAKE, 1, NULL, NULL, 0);
        return;
    }
#endif
    if (write(x->outgoing, "!", 1) != 1) return; /* the other process has ended: the wait reports it */
}

static void ask(mail_end_t *x, int32_t what)
{
    x->box->what = what;
    bring(x, &x->box->asked, &x->box->asked_asleep);
}

void mailbox_ask(const unit_t *u, const double *s, double t, int64_t hit)
{
    mail_end_t *x = u->instance;
    double *slopes = x->signals + u->input_count + u->output_count;

    memcpy(x->signals, s + u->input, (size_t)u->input_count * sizeof *s);
    memcpy(x->signals + u->input_count, s + u->output, /* those of clocks hold until they tick */
           (size_t)u->output_count * sizeof *s);
    for (int64_t i = 0; i < x->n_slopes; i++) slopes[i] = s[x->slopes[i]];
    x->box->t = t;
    x->box->hit = hit;
    ask(x, ASK_STEP);
}

int32_t mailbox_answer(const unit_t *u, double *s, double *reached, int *status, int32_t *failed)
{
    mail_end_t *x = u->instance;
    const mailbox_t *box = x->box;

    *status = await(x, &x->box->answered, &x->box->answered_asleep, x->patience);
    if (*status != LOST_NOT) return RUN_LOST;
    x->seen++;
    memcpy(s + u->output, x->signals + u->input_count, (size_t)u->output_count * sizeof *s);
    *status = box->status;
    *reached = box->reached;
    *failed = (int32_t)(box->failed < u->input_count ? u->input + box->failed
                                                     : u->output + box->failed - u->input_count);
    return box->result;
}

/* For calls other than steps: the request and the answer themselves go through the pipes. */
API void engine_ask(mail_end_t *x) { ask(x, ASK_CALL); }

API int32_t engine_await(mail_end_t *x, double patience)
{
    const int lost = await(x, &x->box->answered, &x->box->answered_asleep, patience);
    if (lost == LOST_NOT) x->seen++;
    return lost;
}

int32_t mailbox_asked(mail_end_t *x)
{
    if (await(x, &x->box->asked, &x->box->asked_asleep, HUGE_VAL) != LOST_NOT) return -1;
    x->seen++;
    return x->box->what;
}

API void engine_answer(mail_end_t *x) { bring(x, &x->box->answered, &x->box->answered_asleep); }

#else /* no FMU has a process of its own there */

void mailbox_ask(const unit_t *u, const double *s, double t, int64_t hit)
{
    (void)u, (void)s, (void)t, (void)hit;
}
int32_t mailbox_answer(const unit_t *u, double *s, double *reached, int *status, int32_t *failed)
{
    (void)u, (void)s, (void)reached, (void)failed;
    *status = LOST_ENDED;
    return RUN_LOST;
}
API void engine_ask(mail_end_t *x) { (void)x; }
API int32_t engine_await(mail_end_t *x, double patience)
{
    (void)x, (void)patience;
    return LOST_ENDED;
}
int32_t mailbox_asked(mail_end_t *x)
{
    (void)x;
    return -1;
}
API void engine_answer(mail_end_t *x) { (void)x; }

#endif
