/* receiver.c: see receiver.h */
#include "receiver.h"

/* Consecutive frames that must agree before an unexpected counter is accepted. */
enum { WINDOW = 3 };
/* Frames in a row that may be numbered one sample ahead of their arrival: no jitter lasts longer. */
enum { AHEAD = 64 };

static int64_t divided(int64_t a, int64_t b) /* towards minus infinity, b > 0 */
{
    return a / b - (a % b < 0);
}

static int64_t turn(const receiver_t *r) { return (int64_t)1 << r->counter_bits; }

/* The number of the sample that is nominally sent last at or before t. */
static int64_t number_at(const receiver_t *r, int64_t t) { return divided(t - r->offset_ns, r->period_ns); }

static int64_t sampled(const receiver_t *r, int64_t number) { return number * r->period_ns + r->offset_ns; }

/* How far the sender's clock is ahead of this one by the fastest frame so far (negative: the frame
 * was on its way so long). Forgotten by 244 ppm, which is more than clocks differ by. */
static int64_t lead(const receiver_t *r, int64_t t)
{
    return r->sequence < 0 || t <= r->arrival_ns ? r->lead_ns : r->lead_ns - (t - r->arrival_ns) / 4096;
}

/* The greatest number that its sender can have sent by t: by nominal times, or by the fastest frame so
 * far if that is greater, and the uncertainty of clocks. */
static int64_t latest(const receiver_t *r, int64_t t)
{
    const int64_t early = r->period_ns > RECEIVE_EARLY_NS ? r->period_ns : RECEIVE_EARLY_NS;
    const int64_t fastest = lead(r, t);
    const int64_t most = number_at(r, t + early + (fastest > 0 ? fastest : 0));
    const int64_t near = number_at(r, t + fastest) + (turn(r) > 4 ? turn(r) / 4 : 1);
    return r->time_bits > 0 || r->counter_bits == 0 || most < near ? most : near;
}

/* The greatest number at or below `top` whose low bits are the counter. */
static int64_t below(const receiver_t *r, uint32_t counter, int64_t top)
{
    const int64_t bits = turn(r) - 1, k = top - ((top - counter - r->shift) & bits);
    return k < 0 ? k + turn(r) : k;
}

/* The number whose low bits are the counter, turned by `shift`, and whose nominal time is that of the
 * stamp `newest` (us) or of a turn of the stamp before it; -1: there is none. *time: its time, ns. */
static int64_t matching(const receiver_t *r, uint32_t counter, int64_t shift, int64_t newest, int64_t *time)
{
    const int64_t span = (int64_t)1 << r->time_bits;
    for (int32_t n = 0; n < RECEIVE_TURNS; n++) {
        const int64_t stamp = newest - n * span, k = number_at(r, stamp * 1000 + 999);
        if (k < 0) break;
        *time = sampled(r, k);
        if (divided(*time, 1000) == stamp && ((k - counter - shift) & (turn(r) - 1)) == 0) return k;
    }
    return -1;
}

/* By the time stamp, which is the nominal time of the sample in us: the number that counter and stamp
 * agree on. A stamp that is not a nominal time (of a foreign sender) gives the nearest number with that
 * counter; where the counter, in its first turn, has not come so far by then, a number that is refused.
 * Where the counter was turned, and WINDOW frames in a row agree without that, it is turned back: it had
 * been turned for frames of another sender. *time: of the stamp, ns. */
static int64_t stamped(receiver_t *r, const header_t *header, int64_t t, int64_t *time)
{
    const int64_t span = (int64_t)1 << r->time_bits, us = divided(t, 1000);
    int64_t newest = ((int64_t)header->t_us - us) & (span - 1);
    newest = us + (newest < span / 4 ? newest : newest - span); /* late rather than early */
    int64_t k = matching(r, header->counter, r->shift, newest, time);
    const int64_t back = k < 0 && r->shift ? matching(r, header->counter, 0, newest, time) : -1;
    r->unturned = back >= 0 ? r->unturned + 1 : 0;
    if (r->unturned >= WINDOW) {
        r->shift = r->unturned = 0;
        k = back;
    }
    if (k >= 0) return k;
    *time = newest * 1000;
    const int64_t sent = number_at(r, *time + r->period_ns / 2);
    k = below(r, header->counter, sent);
    return k > sent ? below(r, header->counter, latest(r, t) + turn(r)) : k;
}

/* Without a counter the arrival alone counts: a sample a period, and one that jitter brings sooner. After a
 * frame that came more than a period late, the following ones would remain one ahead: one of them counts as
 * repeated. */
static int64_t number_by_arrival(receiver_t *r, int64_t t)
{
    const int64_t now = number_at(r, t) < 0 ? 0 : number_at(r, t);
    r->ahead = now == r->sequence ? r->ahead + 1 : 0;
    if (now > r->sequence) return now;
    return now == r->sequence && r->ahead <= AHEAD ? now + 1 : r->sequence;
}

/* Whether a whole turn of the counter may have gone by unseen: then its number is not known. */
static int32_t is_ambiguous(const receiver_t *r, int64_t t, int64_t top)
{
    return r->time_bits <= 0 && r->sequence >= 0 && turn(r) > 1 && top - r->sequence > turn(r) &&
           2 * (t - r->arrival_ns) > turn(r) * r->period_ns;
}

/* 0, or why a frame with number k is not accepted. */
static int64_t refusal(const receiver_t *r, int64_t k, int64_t t, int64_t top)
{
    if (k > top || is_ambiguous(r, t, top)) return RECEIVE_WRONG;
    if (r->sequence >= 0 && k == r->sequence) return RECEIVE_REPEATED;
    return r->sequence >= 0 && k < r->sequence ? RECEIVE_OLDER : 0;
}

/* Whether the last WINDOW frames arrived at their nominal rate. They must not arrive faster than that, so
 * that the previous sender would have sent between them. */
static int32_t frames_agree(receiver_t *r, int64_t k, int64_t t)
{
    const int64_t behind = t - r->trial_ns - (k - r->trial_first) * r->period_ns;
    const int32_t follows = k == r->trial + 1 && behind >= -r->period_ns && behind <= r->period_ns;
    if (r->tried == 0 || !follows) {
        r->tried = 0;
        r->trial_first = k;
        r->trial_ns = t;
    }
    r->trial = k;
    return ++r->tried >= WINDOW;
}

/* Whether this number was accepted before, or is older than what may have been overtaken. */
static int32_t already_received(const receiver_t *r, int64_t k)
{
    const int64_t back = r->sequence - k;
    return back < 0 || back >= 64 || (r->seen >> back & 1);
}

static void see(receiver_t *r, int64_t k)
{
    const int64_t step = k - r->sequence;
    r->seen = r->sequence < 0 || step >= 64 ? 1 : r->seen << step | 1;
}

/* The number with which to continue if enough frames agree, or `why` not. A counter that was restarted, or
 * is ahead of its stamp, is shifted to the present time; the time itself is never shifted: a sample with a
 * stamp older than the accepted one remains refused, and so does an overtaken sample without a stamp. */
static int64_t resynced(receiver_t *r, int64_t k, int64_t why, int64_t time, int64_t t, int64_t top)
{
    const int32_t first = r->sequence < 0;
    if (turn(r) == 1 || (r->time_bits <= 0 && !first && !already_received(r, k)) || !frames_agree(r, k, t))
        return why;
    const int32_t ahead = k > top && (r->time_bits <= 0 || sampled(r, k) != time);
    if (!first && (k <= r->sequence || ahead)) {
        const int64_t at = r->time_bits > 0 ? time : t + lead(r, t);
        const int64_t now = number_at(r, at + r->period_ns / 2);
        if (now <= r->sequence) return why;
        r->shift = (r->shift + now - k) & (turn(r) - 1);
        k = now;
    }
    r->resyncs += !first;
    r->lead_ns = sampled(r, k) - t;
    return k;
}

static int64_t counted(receiver_t *r, int64_t why)
{
    ++*(why == RECEIVE_REPEATED ? &r->repeated : why == RECEIVE_OLDER ? &r->reordered : &r->wrong_sequence);
    return why;
}

/* The fastest frame so far. A clock is assumed to be at most 488 ppm faster than nominal. */
static void update_fastest(receiver_t *r, int64_t k, int64_t t)
{
    const int64_t old = lead(r, t), found = sampled(r, k) - t;
    const int64_t passed = r->sequence < 0 || t < r->arrival_ns ? 0 : t - r->arrival_ns;
    const int64_t most = (old > 0 ? old : 0) + passed / 2048;
    r->lead_ns = found <= old ? old : found < most ? found : most;
}

int64_t receiver_accept(receiver_t *r, const header_t *header, int64_t t_ns)
{
    const int64_t top = latest(r, t_ns);
    int64_t time = t_ns;
    int64_t k = r->time_bits > 0      ? stamped(r, header, t_ns, &time)
                : r->counter_bits > 0 ? below(r, header->counter, top)
                                      : number_by_arrival(r, t_ns);
    const int64_t why = refusal(r, k, t_ns, top);

    r->older = why == RECEIVE_REPEATED || why == RECEIVE_OLDER ? k : r->older;
    if (why) {
        k = resynced(r, k, why, time, t_ns, top);
        if (k < 0) return counted(r, why);
    } else {
        update_fastest(r, k, t_ns);
    }
    if (r->sequence >= 0 && r->counter_bits > 0) r->lost += k - r->sequence - 1;
    r->ok++;
    r->tried = 0;
    see(r, k);
    r->sequence = k;
    r->arrival_ns = t_ns;
    r->sampled_ns = r->time_bits > 0 ? time : sampled(r, k);
    return k;
}
