/* delay.c: see delay.h. Every operation rounds as in cosim/links/semantics.py and grid.py, in double
 * precision, so rows agree exactly. */
#include "delay.h"

#include <string.h>

#define TOLERANCE 1e-9       /* ticks, as in cosim/links/semantics.py */
#define NS 1e-9              /* s */
#define FAR 4e18             /* ticks; anything beyond is as far */
#define FAR_TICKS 1000000000 /* of a lead */

static int64_t floor_of(double x)
{
    if (x > FAR) x = FAR;
    if (x < -FAR) x = -FAR;
    const int64_t k = (int64_t)x;
    return k - ((double)k > x);
}

static int64_t floor_div(int64_t a, int64_t b) { return a / b - (a % b != 0 && a < 0); }

/* ceil(T/h), forgiving 1e-9 tick. */
static int64_t ticks_up(const delay_t *d, double T) { return -floor_of(-(T / d->h - TOLERANCE)); }

static double delay_at(const delay_t *d, int64_t index)
{
    return d->n_delays > 0 ? d->delays[index % d->n_delays] : 0.0;
}

static const sample_t *find_sample(const delay_t *d, int64_t sequence)
{
    const sample_t *s = &d->samples[sequence & (d->capacity - 1)];
    return sequence >= 0 && s->sequence == sequence ? s : NULL;
}

/* ---- the queue: samples on their way, a binary heap by (due, sequence) ---- */

static int before(waiting_t a, waiting_t b)
{
    return a.due < b.due || (a.due == b.due && a.sequence < b.sequence);
}

static void pop(delay_t *d)
{
    const int64_t n = --d->n_queue;
    const waiting_t last = d->queue[n];
    int64_t i = 0;
    for (int64_t child; (child = 2 * i + 1) < n; i = child) {
        const int64_t right = child + 1;
        if (right < n && before(d->queue[right], d->queue[child])) child = right;
        if (!before(d->queue[child], last)) break;
        d->queue[i] = d->queue[child];
    }
    d->queue[i] = last;
}

static void push(delay_t *d, waiting_t new)
{
    if (d->n_queue == d->capacity) {
        d->forgotten++;
        pop(d);
    }
    int64_t i = d->n_queue++;
    for (int64_t parent; i > 0 && before(new, d->queue[parent = (i - 1) / 2]); i = parent)
        d->queue[i] = d->queue[parent];
    d->queue[i] = new;
}

/* The next that is due by tick K and still kept, or NULL. */
static const sample_t *next_due(delay_t *d, int64_t K)
{
    while (d->n_queue > 0 && d->queue[0].due <= K) {
        const sample_t *s = find_sample(d, d->queue[0].sequence);
        pop(d);
        if (s) return s;
        d->forgotten++;
    }
    return NULL;
}

/* ---- putting ---- */

void delay_reset(delay_t *d)
{
    for (int64_t i = 0; i < d->capacity; i++) d->samples[i].sequence = -1;
    d->newest = d->visible = d->held = d->given.sequence = -1;
    d->n_queue = d->network_ns = d->last_due = 0;
    d->lost = d->ignored = d->forgotten = d->dropped = 0;
    d->line_first = d->n_line = 0;
    d->looked = -1;
}

static int64_t network(int64_t sent_ns, int64_t arrival_ns)
{
    return arrival_ns > sent_ns ? arrival_ns - sent_ns : 0;
}

/* The tick a sample is due, with T (s) of the law. */
static int64_t due(const delay_t *d, int64_t sequence, int64_t network_ns, double T)
{
    return d->period * sequence + ticks_up(d, T + NS * (double)(network_ns - d->phase_ns));
}

void delay_put(delay_t *d, int64_t sequence, int64_t sent_ns, int64_t arrival_ns, const double *values)
{
    sample_t *s = &d->samples[sequence & (d->capacity - 1)];
    const int overtaken = d->kind == DELAY_FIFO && sequence < d->newest;
    if (sequence < 0 || s->sequence >= sequence || overtaken) {
        d->ignored++;
        return;
    }
    const double T = d->kind >= DELAY_LAST ? delay_at(d, sequence) : 0.0;
    if (!(T - T == 0.0)) {
        d->lost++;
        return;
    }
    s->sequence = sequence;
    s->sent_ns = sent_ns;
    s->arrival_ns = arrival_ns;
    s->due = due(d, sequence, network(sent_ns, arrival_ns), T);
    if (d->kind == DELAY_FIFO) {
        if (d->newest >= 0 && s->due < d->last_due) s->due = d->last_due;
        d->last_due = s->due;
    }
    memcpy(d->values + (sequence & (d->capacity - 1)) * d->width, values, (size_t)d->width * sizeof *values);
    if (sequence > d->newest) d->newest = sequence;
    if (d->kind != DELAY_NONE && d->kind != DELAY_PLAYOUT) push(d, (waiting_t){s->due, sequence});
}

/* ---- taking ---- */

static void hold(delay_t *d, const sample_t *s)
{
    if (s->sequence == d->held) return;
    memcpy(d->values + d->capacity * d->width, d->values + (s->sequence & (d->capacity - 1)) * d->width,
           (size_t)d->width * sizeof *d->values);
    d->given = *s;
    d->held = s->sequence;
}

static void take_packets(delay_t *d, int64_t K)
{
    const sample_t *best = NULL, *s;
    waiting_t top = {d->given.due, d->held};
    while ((s = next_due(d, K))) {
        const waiting_t one = {s->due, s->sequence};
        const int newer = d->kind == DELAY_LAST ? before(top, one) : one.sequence > top.sequence;
        if (top.sequence < 0 || newer) {
            best = s;
            top = one;
        }
    }
    if (best) hold(d, best);
}

/* A sample that has got through enters the queue. */
static void enter(delay_t *d, int64_t sequence)
{
    if (d->n_line == d->depth) {
        d->dropped++;
        if (d->drops_newest) return;
        d->line_first = (d->line_first + 1) % d->depth;
        d->n_line--;
    }
    d->line[(d->line_first + d->n_line++) % d->depth] = sequence;
}

static void take_queue(delay_t *d, int64_t K, int64_t row)
{
    const sample_t *best = NULL, *s;
    while ((s = next_due(d, K))) enter(d, s->sequence);
    if (row <= d->looked) return; /* it has taken already */
    d->looked = row;
    while (d->n_line > 0 && (d->takes_all || !best)) {
        s = find_sample(d, d->line[d->line_first]);
        d->line_first = (d->line_first + 1) % d->depth;
        d->n_line--;
        if (s) best = s;
        else d->forgotten++;
    }
    if (best) hold(d, best);
}

static void take_playout(delay_t *d, int64_t K)
{
    const int64_t back = ticks_up(d, d->buffer - NS * (double)d->phase_ns);
    const sample_t *s = find_sample(d, floor_div(K - back, d->period));
    if (s && s->due <= K) hold(d, s);
}

/* The newest at or before j that has arrived by tick K; else nothing is held, unless that is only
 * because it is kept no more. */
static void hold_older(delay_t *d, int64_t j, int64_t K)
{
    const int64_t oldest = d->newest < d->capacity ? 0 : d->newest - d->capacity + 1;
    for (int64_t i = j; i >= oldest; i--) {
        const sample_t *s = find_sample(d, i);
        if (i == d->held) return;
        if (s && s->due <= K) {
            hold(d, s);
            return;
        }
    }
    if (j < 0 || oldest == 0) d->held = -1;
    else if (j != d->held) d->forgotten++;
}

static void take_signal(delay_t *d, int64_t K, int64_t row)
{
    for (const sample_t *s; (s = next_due(d, K));) {
        if (s->sequence <= d->visible) continue;
        d->visible = s->sequence;
        d->network_ns = network(s->sent_ns, s->arrival_ns);
    }
    const double T = delay_at(d, row) + NS * (double)(d->network_ns - d->phase_ns);
    if (d->visible < 0 || !(T - T == 0.0)) return;
    const int64_t back = floor_of(T / d->h + (0.5 * d->period + TOLERANCE));
    const int64_t j = -floor_div(back - K, d->period);
    hold_older(d, j < d->visible ? j : d->visible, K);
}

int64_t delay_take(delay_t *d, int64_t row, int64_t now_ns)
{
    const int64_t K = row * d->look;
    (void)now_ns;
    switch (d->kind) {
    case DELAY_NONE:
        if (d->newest >= 0) hold(d, find_sample(d, d->newest));
        break;
    case DELAY_SIGNAL: take_signal(d, K, row); break;
    case DELAY_PLAYOUT: take_playout(d, K); break;
    case DELAY_QUEUE: take_queue(d, K, row); break;
    default: take_packets(d, K);
    }
    return d->held;
}

/* ---- lead ---- */

/* The least delay of the law that is no loss, s. */
static double least_delay(const delay_t *d)
{
    double least = d->n_delays > 0 ? FAR : 0.0;
    for (int64_t i = 0; i < d->n_delays; i++)
        if (d->delays[i] < least) least = d->delays[i];
    return least;
}

int64_t delay_lead_ns(const delay_t *d)
{
    const double phase = NS * (double)(0 - d->phase_ns);
    const int64_t h_ns = (int64_t)(d->h / NS + 0.5);
    int64_t ticks;
    switch (d->kind) {
    case DELAY_NONE: return 0;
    case DELAY_SIGNAL: /* of the sample nearest to now - T: half a period after it, at most */
        ticks = floor_of((least_delay(d) + phase) / d->h + (0.5 * d->period + TOLERANCE)) - d->period + 1;
        break;
    case DELAY_PLAYOUT: ticks = ticks_up(d, d->buffer + phase); break;
    default: ticks = ticks_up(d, least_delay(d) + phase);
    }
    if (ticks > FAR_TICKS) ticks = FAR_TICKS;
    const int64_t lead = ticks * h_ns + d->phase_ns;
    return lead > 0 ? lead : 0;
}
