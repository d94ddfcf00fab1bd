/* tables.c: the rows of tables of links. A row is the sample that a receiver holds at one of its hits;
 * cosim/links/semantics.py says which one that is by which rule. The random numbers are those of NumPy:
 * SeedSequence and PCG64 (M. E. O'Neill, "PCG: A Family of Simple Fast Space-Efficient Statistically
 * Good Algorithms for Random Number Generation", HMC-CS-2014-0905, and "Developing a seed_seq
 * Alternative", 2015). */
#include "tables.h"

/* Rows worked on at once by the rules for packets. */
#define BLOCK 1024
#define TOLERANCE 1e-9 /* ticks, as in cosim/links/semantics.py */

/* ---- random numbers ------------------------------------------------------------------------------ */

typedef struct {
    uint64_t high, low;
} wide_t;

static wide_t product(uint64_t a, uint64_t b)
{
    const uint64_t a0 = a & 0xffffffffu, a1 = a >> 32, b0 = b & 0xffffffffu, b1 = b >> 32;
    const uint64_t low = a0 * b0, cross = a1 * b0 + (low >> 32), other = a0 * b1 + (cross & 0xffffffffu);
    const wide_t r = {a1 * b1 + (cross >> 32) + (other >> 32), (other << 32) | (low & 0xffffffffu)};
    return r;
}

static void advance(pcg_t *g)
{
    static const uint64_t high = 2549297995355413924u, low = 4865540595714422341u;
    const wide_t p = product(g->state[1], low);
    const uint64_t sum = p.low + g->increment[1];
    g->state[0] = p.high + g->state[0] * low + g->state[1] * high + g->increment[0] + (sum < p.low);
    g->state[1] = sum;
}

/* The next number from [0, 1), in steps of 2^-53. */
static double uniform(pcg_t *g)
{
    uint64_t x;
    unsigned turn;
    advance(g);
    x = g->state[0] ^ g->state[1];
    turn = (unsigned)(g->state[0] >> 58);
    x = x >> turn | x << (-turn & 63u);
    return (double)(x >> 11) * (1.0 / 9007199254740992.0);
}

typedef struct {
    uint32_t pool[4], factor;
} mixer_t;

static uint32_t hashed(mixer_t *m, uint32_t x, uint32_t growth)
{
    x ^= m->factor;
    m->factor *= growth;
    x *= m->factor;
    return x ^ x >> 16;
}

static void mix(mixer_t *m, int i, uint32_t x)
{
    const uint32_t r = 0xca01f9ddu * m->pool[i] - 0x4973f715u * hashed(m, x, 0x931e8875u);
    m->pool[i] = r ^ r >> 16;
}

static mixer_t mixed(const uint32_t *words, int64_t n)
{
    mixer_t m = {{0}, 0x43b0d7e5u};
    for (int i = 0; i < 4; i++) m.pool[i] = hashed(&m, i < n ? words[i] : 0, 0x931e8875u);
    for (int from = 0; from < 4; from++)
        for (int to = 0; to < 4; to++)
            if (from != to) mix(&m, to, m.pool[from]);
    for (int64_t k = 4; k < n; k++)
        for (int to = 0; to < 4; to++) mix(&m, to, words[k]);
    return m;
}

static void seed(pcg_t *g, mixer_t m)
{
    uint64_t word[4] = {0};
    m.factor = 0x8b51f9ddu;
    for (int i = 0; i < 8; i++)
        word[i / 2] |= (uint64_t)hashed(&m, m.pool[i % 4], 0x58f38dedu) << 32 * (i % 2);
    g->increment[0] = word[2] << 1 | word[3] >> 63;
    g->increment[1] = word[3] << 1 | 1;
    g->state[0] = g->state[1] = 0;
    advance(g);
    g->state[1] += word[1];
    g->state[0] += word[0] + (g->state[1] < word[1]);
    advance(g);
}

void tables_seed(table_t *tables, int64_t n_tables, const uint32_t *words, const int64_t *ends)
{
    for (int64_t i = 0, first = 0; i < n_tables; first = ends[i++]) {
        mixer_t m = mixed(words + first, ends[i] - first);
        seed(&tables[i].delay, m);
        if (tables[i].lost > 0) {
            for (int to = 0; to < 4; to++) mix(&m, to, 0); /* its place among the children */
            seed(&tables[i].loss, m);
        }
    }
}

/* ---- delays -------------------------------------------------------------------------------------- */

/* The delay of the next sample, s; not finite: it is lost. */
INLINE double next_delay(table_t *t)
{
    if (t->delays) return *t->delays++;
    for (; t->rest >= t->samples; t->rest -= t->samples) {
        const double drawn = t->low + t->width * uniform(&t->delay);
        t->drawn = drawn < t->high ? drawn : t->high;
    }
    t->rest += t->draws;
    return t->lost > 0 && uniform(&t->loss) < t->lost ? NAN : t->drawn;
}

/* ceil(T/h) of a finite T (s), ticks, forgiving 1e-9 tick. */
INLINE int64_t ticks_up(const table_t *t, double T)
{
    const double ticks = T / t->h - TOLERANCE;
    return (int64_t)ticks + (ticks > (double)(int64_t)ticks);
}

INLINE int64_t floor_of(int64_t a, int64_t b) { return a / b - (a % b < 0); }

/* ---- rules --------------------------------------------------------------------------------------- */

static void signal_rows(table_t *t, int32_t *rows, int64_t n)
{
    const int64_t n_s = t->n_s, n_r = t->n_r, each = n_r / n_s;
    const int together = n_r % n_s == 0;            /* the receiver reads when the sender sends */
    const int holds = !t->delays && !(t->lost > 0); /* a draw stays until the next one is due */
    const double half = 0.5 * (double)n_s + TOLERANCE;
    int64_t K = n_r * t->row, newest = K / n_s, i = 0;
    while (i < n) {
        const int64_t back = (int64_t)(next_delay(t) / t->h + half), samples = back / n_s;
        int64_t rest = t->rest;
        for (;; rest += t->draws) {
            int64_t j = newest - samples;
            if (!together) {
                j = -floor_of(back - K, n_s);
                if (j > K / n_s) j = K / n_s; /* not newer than the newest sent */
            }
            rows[i++] = (int32_t)(j < 0 ? -1 : j);
            K += n_r;
            newest += each;
            if (!holds || i == n || rest >= t->samples) break;
        }
        t->rest = rest;
    }
}

/* Take a packet that arrives for one of the looks from `row` on: of those for one look the one with
 * the greatest key counts. */
INLINE void arrive(const table_t *t, int64_t *keys, packet_t p)
{
    const int64_t look = (p.arrival + t->n_r - 1) / t->n_r - t->row;
    int64_t key = p.sample;
    if (t->rule == RULE_LAST_ARRIVAL)
        key += (p.arrival - t->n_r * (t->row + look) + INT32_MAX) * ((int64_t)1 << 32);
    if (key > keys[look]) keys[look] = key;
}

static int packet_rows(table_t *t, int32_t *rows, int64_t n)
{
    const int64_t last = t->n_r * (t->row + n - 1);
    int64_t keys[BLOCK], kept = 0;
    for (int64_t i = 0; i < n; i++) keys[i] = -1;
    for (int64_t i = 0; i < t->n_pending; i++)
        if (t->pending[i].arrival <= last) arrive(t, keys, t->pending[i]);
        else t->pending[kept++] = t->pending[i];
    t->n_pending = kept;
    for (; t->sent * t->n_s <= last; t->sent++) {
        const double T = next_delay(t);
        packet_t p = {t->sent * t->n_s, t->sent};
        if (!isfinite(T)) continue;
        if (T < 0) return 1;
        p.arrival += ticks_up(t, T);
        if (t->rule == RULE_FIFO && p.arrival < t->arrived) p.arrival = t->arrived;
        t->arrived = p.arrival;
        if (p.arrival <= last) arrive(t, keys, p);
        else if (t->n_pending < t->capacity) t->pending[t->n_pending++] = p;
        else return 1;
    }
    for (int64_t i = 0; i < n; i++) {
        const int64_t sample = keys[i] & UINT32_MAX;
        if (keys[i] >= 0 && (t->rule == RULE_LAST_ARRIVAL || sample > t->held)) t->held = sample;
        rows[i] = (int32_t)t->held;
    }
    return 0;
}

/* ---- a queue: the first `waiting` of the pending packets have arrived and wait in it ---------------- */

/* Remove packet i of the pending ones, which begin at `first`. */
INLINE void leave(table_t *t, int64_t *first, int64_t i)
{
    packet_t *const place = t->pending + *first + i;
    t->n_pending--;
    if (i == 0) (*first)++;
    else memmove(place, place + 1, (size_t)(t->n_pending - i) * sizeof *place);
}

/* Samples that arrive up to tick K enter the queue. */
static void enter(table_t *t, int64_t *first, int64_t K)
{
    while (t->waiting < t->n_pending && t->pending[*first + t->waiting].arrival <= K) {
        if (t->waiting < t->depth) t->waiting++;
        else leave(t, first, t->queue & QUEUE_DROP_NEWEST ? t->waiting : 0);
    }
}

/* A packet in its place: behind those that arrive no later. Returns 1 if there is no room. */
static int put(table_t *t, int64_t *first, packet_t p)
{
    packet_t *place;
    if (*first + t->n_pending == t->capacity) {
        if (*first == 0) return 1;
        memmove(t->pending, t->pending + *first, (size_t)t->n_pending * sizeof p);
        *first = 0;
    }
    place = t->pending + *first + t->n_pending++;
    for (; place > t->pending + *first && place[-1].arrival > p.arrival; place--) place[0] = place[-1];
    *place = p;
    return 0;
}

static int queue_rows(table_t *t, int32_t *rows, int64_t n)
{
    int64_t K = t->n_r * t->row, first = 0;
    for (int64_t i = 0; i < n; i++, K += t->n_r) {
        for (; t->sent * t->n_s <= K; t->sent++) {
            const double T = next_delay(t);
            packet_t p = {t->sent * t->n_s, t->sent};
            enter(t, &first, p.arrival - 1);
            if (!isfinite(T)) continue;
            if (T < 0) return 1;
            p.arrival += ticks_up(t, T);
            if (put(t, &first, p)) return 1;
        }
        enter(t, &first, K);
        if (t->waiting > 0) {
            const int64_t taken = t->queue & QUEUE_TAKE_ALL ? t->waiting : 1;
            t->held = t->pending[first + taken - 1].sample;
            first += taken;
            t->n_pending -= taken;
            t->waiting -= taken;
        }
        rows[i] = (int32_t)t->held;
    }
    memmove(t->pending, t->pending + first, (size_t)t->n_pending * sizeof *t->pending);
    return 0;
}

static void playout_rows(table_t *t, int32_t *rows, int64_t n)
{
    int64_t K = t->n_r * t->row;
    for (int64_t i = 0; i < n; i++, K += t->n_r) {
        const int64_t j = floor_of(K - t->buffer, t->n_s); /* to be played */
        for (; t->sent <= j; t->sent++) t->played = next_delay(t);
        if (j >= 0 && isfinite(t->played) && ticks_up(t, t->played) <= K - t->n_s * j) t->held = j;
        rows[i] = (int32_t)t->held;
    }
}

int64_t tables_rows(table_t *tables, int64_t n_tables)
{
    for (table_t *t = tables; t < tables + n_tables; t++) {
        for (int64_t first = 0, n; first < t->n; first += n, t->row += n) {
            int32_t *const rows = t->rows + first;
            n = t->n - first < BLOCK ? t->n - first : BLOCK;
            if (t->rule == RULE_SIGNAL) signal_rows(t, rows, n);
            else if (t->rule == RULE_PLAYOUT) playout_rows(t, rows, n);
            else if (t->rule == RULE_QUEUE ? queue_rows(t, rows, n) : packet_rows(t, rows, n))
                return t - tables;
        }
    }
    return -1;
}
