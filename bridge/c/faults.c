/* faults.c: see faults.h */
#include "faults.h"

#include <string.h>

#include "hostile.h"

#define SECOND 1e9

/* What becomes of one frame on its way through the rules. */
typedef struct {
    frame_t frame;  /* t_ns: when it gets through */
    int32_t copies; /* 0: dropped */
    int32_t rule;   /* the first that did something, -1: none */
    uint32_t kinds;
    uint32_t tag;   /* frame.reserved while it waits for the next one: rule + 1 */
    double a, b;    /* of duplicates, s */
    uint64_t draws; /* of duplicates */
    int32_t added;  /* by hostile peers, already waiting */
} passage_t;

static int64_t between_ns(double a, double b, uint64_t *draws)
{
    return (int64_t)((a + (b - a) * faults_unit(draws)) * SECOND + 0.5);
}

/* CRC-32 of IEEE 802.3, as zlib has it. */
static uint32_t crc32_of(const uint8_t *data, size_t n)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < n; i++) {
        crc ^= data[i];
        for (int k = 0; k < 8; k++) crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return ~crc;
}

static size_t length_of(const frame_t *frame)
{
    return frame->length < FRAME_DATA ? frame->length : FRAME_DATA;
}

/* ---- waiting: a circle, sorted by t_ns, first in first out where equal ---- */

static frame_t *at(faults_t *f, int64_t i) { return &f->waiting[(f->first + i) & (f->capacity - 1)]; }

static void insert(faults_t *f, const frame_t *frame)
{
    if (f->n_waiting == f->capacity) {
        f->overflow++;
        return;
    }
    int64_t i = f->n_waiting++;
    for (; i > 0 && at(f, i - 1)->t_ns > frame->t_ns; i--) *at(f, i) = *at(f, i - 1);
    *at(f, i) = *frame;
}

/* Where the one waits that has this tag; -1: nowhere. */
static int64_t tagged(faults_t *f, uint32_t tag)
{
    int64_t i = f->n_waiting - 1;
    while (i >= 0 && at(f, i)->reserved != tag) i--;
    return i;
}

static frame_t take_out(faults_t *f, int64_t i)
{
    const frame_t frame = *at(f, i);
    for (; i < f->n_waiting - 1; i++) *at(f, i) = *at(f, i + 1);
    f->n_waiting--;
    return frame;
}

/* ---- rules ---- */

static int fits(const fault_t *r, const frame_t *frame)
{
    return frame_accepted(&r->accept, frame) && (r->bus < 0 || r->bus == frame->bus);
}

/* Floyd's choice of `count` different bits; 0: there is nothing to flip. */
static int corrupt(frame_t *frame, int32_t count, uint64_t *draws)
{
    uint8_t mask[FRAME_DATA] = {0};
    const int32_t bits = 8 * (int32_t)length_of(frame);
    for (int32_t i = bits - (count < bits ? count : bits); i < bits; i++) {
        int32_t bit = (int32_t)(faults_next(draws) % (uint64_t)(i + 1));
        if (mask[bit / 8] >> bit % 8 & 1) bit = i;
        mask[bit / 8] |= (uint8_t)(1 << bit % 8);
    }
    for (int32_t k = 0; k < bits / 8; k++) frame->data[k] ^= mask[k];
    return bits > 0 && count > 0;
}

/* ---- hostile peers ---- */

static void add(faults_t *f, passage_t *p, const frame_t *frame, int64_t later_ns)
{
    frame_t more = *frame;
    more.t_ns = p->frame.t_ns + later_ns;
    more.reserved = 0;
    insert(f, &more);
    p->added++;
}

static int forge(faults_t *f, const fault_t *r, passage_t *p, uint64_t *draws)
{
    frame_t frame = p->frame;
    if (!hostile_remake(r, &frame, (uint32_t)r->count, draws)) return 0;
    add(f, p, &frame, 0);
    return 1;
}

/* What was recorded, over and over. */
static int replay(faults_t *f, fault_t *r, passage_t *p)
{
    const frame_t *frame = hostile_again(r);
    if (frame) add(f, p, frame, 0);
    return frame != NULL;
}

static int flood(faults_t *f, fault_t *r, passage_t *p, int64_t t, uint64_t *draws)
{
    const int64_t n = hostile_flood(r, t), apart = (int64_t)(r->a * SECOND);
    for (int64_t i = 1; i <= n; i++) {
        frame_t frame = p->frame;
        if (!hostile_remake(r, &frame, (uint32_t)i, draws)) return 0;
        add(f, p, &frame, i * apart);
    }
    return n > 0;
}

/* What a rule does to a frame that it hits; 0: nothing. */
static int strike(faults_t *f, fault_t *r, int64_t number, passage_t *p, int64_t t, uint64_t draws)
{
    switch (r->kind) {
    case FAULT_FORGE: return forge(f, r, p, &draws);
    case FAULT_REPLAY: return replay(f, r, p);
    case FAULT_ABSURD: return hostile_remake(r, &p->frame, 0, &draws);
    case FAULT_FLOOD: return flood(f, r, p, t, &draws);
    case FAULT_DROP:
    case FAULT_BURST: p->copies = 0; return 1;
    case FAULT_DELAY:
    case FAULT_JITTER: p->frame.t_ns += between_ns(r->a, r->b, &draws); return 1;
    case FAULT_DUPLICATE:
        p->copies += r->count;
        p->a = r->a;
        p->b = r->b;
        p->draws = draws;
        return r->count > 0;
    case FAULT_REORDER:
        p->tag = (uint32_t)number + 1;
        p->frame.t_ns += (int64_t)(r->b * SECOND);
        return 1;
    default: return corrupt(&p->frame, r->count, &draws);
    }
}

/* Whether a rule hits a frame that fits, in its time; the generator is asked, once. */
static int hit(fault_t *r, uint64_t *draws)
{
    *draws = faults_next(&r->random);
    r->asked++;
    const int drawn = faults_share(*draws) < r->probability;
    if (r->kind != FAULT_BURST) return drawn;
    if (r->left == 0 && drawn) r->left = r->count;
    return r->left > 0 && r->left--;
}

/* One rule for one frame that arrived at t. */
static void apply(faults_t *f, int64_t number, passage_t *p, int64_t t)
{
    fault_t *r = f->rules + number;
    uint64_t draws = 0;
    if (!fits(r, &p->frame)) return;
    if (r->kind == FAULT_REPLAY && t < r->t0_ns) hostile_remember(r, &p->frame);
    int struck = t >= r->t0_ns && t < r->t1_ns && hit(r, &draws);
    if (p->copies == 0) return;
    if (r->kind == FAULT_REORDER && struck) struck = tagged(f, (uint32_t)number + 1) < 0;
    if (struck && strike(f, r, number, p, t, draws)) {
        r->hits++;
        p->kinds |= 1u << r->kind;
        if (p->rule < 0) p->rule = (int32_t)number;
    }
    if (r->kind == FAULT_DELAY) {
        if (p->frame.t_ns < r->last_ns) p->frame.t_ns = r->last_ns;
        r->last_ns = p->frame.t_ns;
    }
}

/* Those that waited for this frame come right behind it. */
static void release(faults_t *f, const passage_t *p)
{
    for (int64_t i = 0; i < f->n_rules; i++) {
        const uint32_t tag = (uint32_t)i + 1;
        if (f->rules[i].kind != FAULT_REORDER || p->tag == tag || !fits(f->rules + i, &p->frame)) continue;
        const int64_t place = tagged(f, tag);
        if (place < 0) continue;
        frame_t frame = take_out(f, place);
        frame.t_ns = p->frame.t_ns;
        frame.reserved = 0;
        insert(f, &frame);
    }
}

static void record(faults_t *f, const frame_t *was, const passage_t *p, int64_t start_ns)
{
    const size_t n = length_of(was);
    const int changed = p->copies > 0 && memcmp(was->data, p->frame.data, n) != 0;
    f->injected++;
    f->dropped += p->copies == 0;
    f->corrupted += changed;
    injected_t *row = f->journal ? journal_next(f->journal) : NULL;
    if (!row) return;
    memset(row, 0, sizeof *row);
    row->t_ns = was->t_ns - start_ns;
    row->through_ns = p->copies > 0 ? p->frame.t_ns - start_ns : -1;
    row->id = was->id;
    row->sequence = was->sequence;
    row->crc = crc32_of(was->data, n);
    row->crc_after = p->copies > 0 ? crc32_of(p->frame.data, n) : 0;
    row->rule = p->rule;
    row->kinds = p->kinds;
    row->length = was->length;
    row->flags = was->flags;
    row->bus = was->bus;
    row->copies = p->copies + p->added;
    memcpy(row->data, was->data, n < sizeof row->data ? n : sizeof row->data);
    journal_commit(f->journal);
}

static void pass_frame(faults_t *f, const passage_t *p)
{
    frame_t frame = p->frame;
    uint64_t draws = p->draws;
    for (int32_t copy = 0; copy < p->copies; copy++) {
        frame.t_ns = p->frame.t_ns + (copy ? between_ns(p->a, p->b, &draws) : 0);
        frame.reserved = copy ? 0 : p->tag;
        insert(f, &frame);
    }
}

void faults_put(faults_t *f, const frame_t *frame, int64_t start_ns, int32_t started)
{
    passage_t p = {.frame = *frame, .copies = 1, .rule = -1};
    p.frame.reserved = 0;
    f->frames++;
    for (int64_t i = 0; started && i < f->n_rules; i++) apply(f, i, &p, frame->t_ns - start_ns);
    if (p.rule >= 0) record(f, frame, &p, start_ns);
    pass_frame(f, &p);
    if (started) release(f, &p);
}

int32_t faults_get(faults_t *f, frame_t *frame, int64_t now_ns)
{
    if (f->n_waiting == 0 || at(f, 0)->t_ns > now_ns) return 0;
    *frame = *at(f, 0);
    frame->reserved = 0;
    f->first = (f->first + 1) & (f->capacity - 1);
    f->n_waiting--;
    return 1;
}
