/* receiver.c: see receiver_t in message.h */
#include "message.h"

static int64_t divided(int64_t a, int64_t b)    /* towards minus infinity, b > 0 */
{
    return a / b - (a % b < 0);
}

/* The number in (p - 3/4 M, p + 1/4 M] whose low bits are the counter; the least of all, 0 or more,
 * where that is negative. */
static int64_t unwrapped(const receiver_t *r, uint32_t counter, int64_t p)
{
    int64_t M = (int64_t)1 << r->counter_bits, top = p + M / 4;
    int64_t k = top - ((top - (int64_t)counter) & (M - 1));
    return k < 0 ? (int64_t)counter & (M - 1) : k;
}

static int64_t refused(int64_t *count, int64_t why)
{
    ++*count;
    return why;
}

int64_t receiver_accept(receiver_t *r, const header_t *header, int64_t t_ns, int64_t expected)
{
    int64_t period = r->period_ns > 0 ? r->period_ns : 1;
    int64_t passed = t_ns > r->arrival_ns ? t_ns - r->arrival_ns : 0;
    int32_t first = r->sequence < 0;
    int64_t limit = r->maximum_gap > 0 ? r->maximum_gap : (int64_t)1 << r->counter_bits;
    int32_t silent = first || passed / period > limit;
    int64_t origin = first ? 0 : r->origin_ns + passed / 4096;
    int64_t p = silent ? expected : divided(t_ns - origin + period / 2, period);
    int64_t k = unwrapped(r, header->counter, p);

    r->older = first || k > r->sequence ? r->older : k;
    if (!first && k == r->sequence)
        return refused(&r->repeated, RECEIVE_REPEATED);
    if (!first && k < r->sequence)
        return refused(&r->reordered, RECEIVE_OLDER);
    if (!silent && r->maximum_gap > 0 && k - r->sequence > r->maximum_gap)
        return refused(&r->wrong_sequence, RECEIVE_WRONG);
    if (!first)
        r->lost += k - r->sequence - 1;
    if (silent)     /* this one may be late itself: then `expected` is the fastest way known */
        origin = t_ns - p * period;
    if (t_ns - k * period < origin)
        origin = t_ns - k * period;
    r->ok++;
    r->sequence = k;
    r->arrival_ns = t_ns;
    r->origin_ns = origin;
    return k;
}
