/* bringup.c: drives with protocols of their own, for the node that commands them; see bringup.h. */
#include "bringup.h"

#include <stddef.h>

#include "pace.h"
#include "send.h"
#include "service.h"

enum { AGAIN_NS = 100000000, FEED_NS = 5000000, NOW_NS = 50000000, PERIODS = 4 };

/* rad/s below which a joint may rest, and rad that no encoder hides. */
#define SLOW 0.1
#define UNSEEN 0.05

static void note(node_t *n, const commanded_t *d, int64_t t_ns)
{
    drive_events_t *e = &n->drive_events;
    if (e->n < e->capacity)
        e->events[e->n] =
            (drive_event_t){t_ns, (int32_t)(d - n->commanded), d->phase, d->row, d->failure, d->word};
    e->n++;
}

/* It failed: no torque is sent to it any more, and its node stops. */
static void fail(node_t *n, commanded_t *d, int32_t why, int64_t t_ns)
{
    if (d->phase != DRIVE_RISING && d->phase != DRIVE_SERVING) return;
    d->failed_step = d->phase == DRIVE_RISING ? d->step : -1;
    d->phase = DRIVE_FAILED;
    d->failure = why;
    d->failed_word = d->word;
    d->let_down = 0;
    n->life.now |= WHY_DRIVE;
    note(n, d, t_ns);
}

/* ---- what drives tell ---- */

static uint64_t word_of(const frame_t *frame)
{
    uint64_t word = 0;
    for (uint32_t i = 0; i < 8 && i < frame->length; i++) word |= (uint64_t)frame->data[i] << 8 * i;
    return word;
}

static int32_t row_of(const commanded_t *d, uint64_t word)
{
    for (int32_t i = 0; i < d->n_told; i++)
        if (((word & d->told[i].mask) != d->told[i].value) == d->told[i].differs) return i;
    return -1;
}

static void take_state(node_t *n, commanded_t *d, const frame_t *frame)
{
    const uint64_t word = word_of(frame);
    const int32_t row = row_of(d, word), changed = row != d->row;
    if ((frame->flags ^ d->format) & FRAME_FD) {
        fail(n, d, FAILED_FORMAT, frame->t_ns);
        return;
    }
    d->word = word;
    if ((word & d->own_mask) != d->own) {
        fail(n, d, FAILED_NUMBER, frame->t_ns);
        return;
    }
    d->row = row;
    d->told_ns = frame->t_ns;
    d->heard++;
    if (changed) note(n, d, frame->t_ns);
}

static int32_t take_answer(node_t *n, commanded_t *d, const frame_t *frame)
{
    if (d->phase != DRIVE_RISING || d->step >= d->n_steps) return 0;
    const step_t *s = d->steps + d->step;
    const uint64_t word = word_of(frame);
    if (s->kind != STEP_FRAME || d->sent_ns == 0 || !frame_accepted(&s->answer, frame)) return 0;
    if ((word & s->mask) != (s->value & s->mask)) return 0;
    if ((frame->flags ^ d->format) & FRAME_FD) {
        fail(n, d, FAILED_FORMAT, frame->t_ns);
    } else if ((word & s->exact) != (s->value & s->exact)) {
        d->word = word;
        fail(n, d, FAILED_VALUE, frame->t_ns);
    } else {
        d->answered = 1;
    }
    return 1;
}

/* Whether a frame with the identifier of its state tells none, such as the answer of a register. */
static int32_t is_other(const commanded_t *d, const frame_t *frame)
{
    const int32_t row = row_of(d, word_of(frame));
    return row >= 0 && d->told[row].kind == TOLD_OTHER;
}

API int32_t bringup_hear(node_t *n, const frame_t *frame)
{
    int32_t found = HEARD_NOT;
    for (int32_t i = 0; i < n->n_commanded; i++) {
        commanded_t *d = n->commanded + i;
        if (d->bus != frame->bus) continue;
        if (take_answer(n, d, frame)) found = HEARD_ANSWER;
        if (d->n_told == 0 || !frame_accepted(&d->status, frame)) continue;
        if (is_other(d, frame)) {
            found = HEARD_ANSWER;
            continue;
        }
        take_state(n, d, frame);
        if (found == HEARD_NOT) found = HEARD_STATE;
    }
    return found;
}

/* Whether new positions stay the same, bit by bit, for a way that its velocity cannot leave unseen. At rest
 * a velocity may be some steps of its resolution beside 0. */
static int32_t stands_still(const node_t *n, commanded_t *d)
{
    if (d->q_of < 0 || d->dq_of < 0) return 0;
    const reception_t *r = n->receptions + d->q_of;
    const double q = r->values[d->q_at], dq = n->receptions[d->dq_of].values[d->dq_at];
    const int64_t passed = r->newest - d->q_newest;
    if (passed <= 0) return 0;
    const int32_t slow = dq < SLOW && dq > -SLOW, known = d->q_newest >= 0;
    d->moved =
        known && !slow && q == d->q_last ? d->moved + dq * (double)(passed * r->period_ns) * 1e-9 : 0.0;
    d->q_newest = r->newest;
    d->q_last = q;
    return d->moved > UNSEEN || d->moved < -UNSEEN;
}

/* Whether a position or velocity of a drive is older than it may be: no sample came, and none waits here. */
static int32_t is_stale(const node_t *n, int32_t drive)
{
    const commanded_t *d = n->commanded + drive;
    for (int32_t i = 0; n->begun && i < n->n_inlets; i++) {
        const inlet_t *in = n->inlets + i;
        const ptrdiff_t of = in->reception - n->receptions;
        const int32_t mine = of == d->q_of || of == d->dq_of;
        if (!mine || in->stop_ns <= 0 || in->reception->newest != in->last_newest) continue;
        if (n->now_ns - in->heard_ns > in->stop_ns) return 1;
    }
    return 0;
}

API void bringup_watch(node_t *n, int64_t now_ns)
{
    for (int32_t i = 0; i < n->n_commanded; i++) {
        commanded_t *d = n->commanded + i;
        if (d->phase != DRIVE_SERVING || d->n_told == 0) continue;
        const int32_t enabled = d->row >= 0 && d->told[d->row].kind == TOLD_ENABLED;
        if (d->heard > 0 && !enabled) fail(n, d, FAILED_STATE, now_ns);
        else if (d->within_ns > 0 && now_ns - d->told_ns > d->within_ns) fail(n, d, FAILED_SILENT, now_ns);
        else if (d->heard > 0 && is_stale(n, i)) fail(n, d, FAILED_SILENT, now_ns);
        else if (stands_still(n, d)) fail(n, d, FAILED_STILL, now_ns);
    }
}

API void bringup_excuse(node_t *n, int64_t late_ns)
{
    for (int32_t i = 0; i < n->n_commanded; i++) {
        commanded_t *d = n->commanded + i;
        if (d->phase == DRIVE_SERVING) d->told_ns += late_ns;
        if (d->phase == DRIVE_RISING) d->late_ns += late_ns;
    }
}

/* ---- what they are told ---- */

static void send_frame(node_t *n, const frame_t *given, int64_t now_ns)
{
    frame_t frame = *given;
    node_send(n, frame.bus, &frame, now_ns);
}

static void send_disabling(node_t *n, const commanded_t *d, int64_t now_ns)
{
    for (int32_t k = 0; k < d->n_disabling; k++) send_frame(n, d->disabling + k, now_ns);
}

static int32_t has_followed(const commanded_t *d, const step_t *s)
{
    switch (s->kind) {
    case STEP_NO_ANSWER: return 1;
    case STEP_FRAME: return d->answered;
    default: return d->told_ns > d->began_ns && d->row >= 0 && (s->states >> d->row & 1);
    }
}

static void serve(node_t *n, commanded_t *d, int64_t now_ns)
{
    d->phase = DRIVE_SERVING;
    d->failure = FAILED_NOT;
    d->up_ns = now_ns;
    note(n, d, now_ns);
}

/* The next frame of a bring-up, when the answer to the last one has come. */
static void rise(node_t *n, commanded_t *d, int64_t now_ns)
{
    if (d->step < d->n_steps && d->sent_ns != 0 && has_followed(d, d->steps + d->step)) {
        d->step++;
        d->sent_ns = 0;
    }
    if (d->step >= d->n_steps) {
        serve(n, d, now_ns);
        return;
    }
    const step_t *s = d->steps + d->step;
    if (d->sent_ns == 0) {
        d->began_ns = now_ns;
        d->late_ns = 0;
        d->answered = 0;
    } else if (now_ns - d->began_ns - d->late_ns > s->within_ns) {
        fail(n, d, FAILED_ANSWER, now_ns);
        return;
    } else if (s->again_ns == 0 || now_ns - d->sent_ns < s->again_ns) {
        return;
    }
    d->sent_ns = now_ns;
    send_frame(n, &s->frame, now_ns);
}

static void begin_rising(node_t *n, commanded_t *d, int64_t now_ns)
{
    d->phase = DRIVE_RISING;
    d->failure = FAILED_NOT;
    d->step = 0;
    d->sent_ns = 0;
    d->told_ns = -1;
    d->heard = 0;
    d->row = -1;
    d->q_newest = -1;
    note(n, d, now_ns);
}

/* Torque 0 that feeds a drive in the run is a frame of its message like others. */
static void count_feed(node_t *n, const commanded_t *d)
{
    for (int32_t i = 0; n->begun && i < n->n_outlets; i++)
        if (n->outlets[i].commanded == d) n->outlets[i].sent++;
}

static void feed(node_t *n, int64_t now_ns, int32_t all)
{
    if (now_ns - n->fed_ns < n->feed_ns) return;
    n->fed_ns = now_ns;
    for (int32_t i = 0; i < n->n_commanded; i++) {
        const commanded_t *d = n->commanded + i;
        if (!d->feeds || !(d->phase == DRIVE_RISING || (all && d->phase == DRIVE_SERVING))) continue;
        send_frame(n, &d->feed, now_ns);
        count_feed(n, d);
    }
}

static int32_t count(const node_t *n, int32_t phase)
{
    int32_t found = 0;
    for (int32_t i = 0; i < n->n_commanded; i++) found += n->commanded[i].phase == phase;
    return found;
}

API void bringup_rest(node_t *n, int64_t now_ns)
{
    n->disable_ns = now_ns + AGAIN_NS;
    n->deferred = 0;
    for (int32_t i = 0; i < n->n_commanded; i++) {
        commanded_t *d = n->commanded + i;
        if (d->phase != DRIVE_RESTING) {
            d->phase = DRIVE_RESTING;
            note(n, d, now_ns);
        }
        send_disabling(n, d, now_ns);
    }
}

/* Drives of a node that runs, or is armed, are up; others rest. */
static int32_t is_wanted(const node_t *n)
{
    const int32_t state = n->life.state;
    return state == LIFE_ACTIVE || state == LIFE_STOPPING || (state == LIFE_INACTIVE && n->life.armed);
}

API uint32_t bringup_step(node_t *n, int64_t now_ns, int32_t feed_all)
{
    if (n->n_commanded == 0 || n->clock == CLOCK_REPLAY) return 0;
    if (!is_wanted(n)) {
        const int32_t again = n->life.state == LIFE_FAULT && now_ns >= n->disable_ns;
        if (!again && count(n, DRIVE_RESTING) == n->n_commanded) return 0;
        bringup_rest(n, now_ns);
        return ROW_DISABLED;
    }
    const int32_t before = count(n, DRIVE_SERVING);
    for (int32_t i = 0; i < n->n_commanded; i++) {
        commanded_t *d = n->commanded + i;
        if (d->phase == DRIVE_RESTING && n->life.state == LIFE_INACTIVE) begin_rising(n, d, now_ns);
        if (d->phase == DRIVE_RISING) rise(n, d, now_ns);
        if (d->phase == DRIVE_FAILED && !d->let_down) {
            d->let_down = 1;
            send_disabling(n, d, now_ns);
        }
    }
    feed(n, now_ns, feed_all);
    return before < n->n_commanded && count(n, DRIVE_SERVING) == n->n_commanded ? ROW_ENABLED : 0;
}

/* ---- ready ---- */

/* When a position was received last, on the clock of frames; -1: never. */
static int64_t received_ns(const node_t *n, const reception_t *r)
{
    const int64_t arrival = r->newest < 0 ? -1 : r->arrival_ns + n->start_ns;
    return arrival > r->previewed_ns ? arrival : r->previewed_ns;
}

/* The age of a position that the node accepts in its run, as long as a state of that age is one; at least
 * some periods of the message. */
static int64_t oldest_ns(const node_t *n, const reception_t *r)
{
    const int64_t least = PERIODS * r->period_ns > NOW_NS ? PERIODS * r->period_ns : NOW_NS;
    int64_t limit = n->commanded[r->drive].within_ns;
    for (int32_t i = 0; i < n->n_inlets; i++)
        if (n->inlets[i].reception == r && n->inlets[i].stop_ns < limit) limit = n->inlets[i].stop_ns;
    return limit > least ? limit : least;
}

static int32_t is_of_now(const node_t *n, const reception_t *r, int64_t now_ns)
{
    const int64_t limit = oldest_ns(n, r);
    const int64_t t = received_ns(n, r);
    return t >= 0 && t >= n->commanded[r->drive].up_ns - limit && now_ns - t <= limit;
}

API int32_t bringup_ready(const node_t *n, int64_t now_ns)
{
    if (count(n, DRIVE_SERVING) < n->n_commanded) return 0;
    for (int32_t i = 0; n->n_commanded > 0 && i < n->n_receptions; i++)
        if (n->receptions[i].drive >= 0 && !is_of_now(n, n->receptions + i, now_ns)) return 0;
    return 1;
}

void bringup_keep_lacks(node_t *n, int64_t now_ns)
{
    for (int32_t i = 0; i < n->n_commanded; i++)
        n->commanded[i].lacks = n->commanded[i].phase == DRIVE_SERVING ? LACKS_NOTHING : LACKS_BRINGUP;
    for (int32_t i = 0; n->n_commanded > 0 && i < n->n_receptions; i++) {
        const reception_t *r = n->receptions + i;
        if (r->drive < 0 || is_of_now(n, r, now_ns)) continue;
        commanded_t *d = n->commanded + r->drive;
        if (d->lacks == LACKS_NOTHING) d->lacks = LACKS_POSITION;
        d->position_ns = received_ns(n, r) < 0 ? -1 : now_ns - received_ns(n, r);
    }
}

uint64_t bringup_serving(const node_t *n)
{
    uint64_t bits = 0;
    for (int32_t i = 0; i < n->n_commanded; i++)
        bits |= (uint64_t)(n->commanded[i].phase == DRIVE_SERVING) << i;
    return bits;
}

void bringup_replay(node_t *n, uint64_t serving)
{
    for (int32_t i = 0; i < n->n_commanded; i++)
        n->commanded[i].phase = serving >> i & 1 ? DRIVE_SERVING : DRIVE_RESTING;
}

void bringup_assume(node_t *n, int64_t now_ns)
{
    for (int32_t i = 0; i < n->n_commanded; i++) {
        commanded_t *d = n->commanded + i;
        d->phase = DRIVE_SERVING;
        d->row = -1;
        d->heard = 0;
        d->told_ns = now_ns;
    }
}

API void bringup_feed_until(node_t *n, const int32_t *stop)
{
    int64_t next = pace_now();
    while (!*(const volatile int32_t *)stop && !*(volatile int32_t *)&n->quit) {
        bringup_step(n, next, 1);
        node_host(n, next);
        next += FEED_NS;
        pace_wait(next, 0, &n->quit);
        if (pace_now() > next + FEED_NS) next = pace_now();
    }
}
