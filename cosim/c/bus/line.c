/* line.c: what disturbs the bus: scripts, interruptions and random errors. */
#include "internal.h"

static uint64_t next_random(uint64_t *state) /* splitmix64 (S. Vigna, public domain) */
{
    uint64_t z = *state += 0x9E3779B97F4A7C15u;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return z ^ z >> 31;
}

/* The number of undisturbed bits before the next error is geometric. Its binary digits are
 * independent: with q the chance of an undisturbed bit, digit j is 1 with q^(2^j) / (1 + q^(2^j)).
 * So a distance needs no logarithm, and is the same with every compiler. */
static int64_t draw_distance(rate_t *r)
{
    int64_t distance = 0;
    if (r->set.rate <= 0.0) return NEVER;
    for (int32_t j = 0; j < 48; j++)
        if (next_random(&r->random) >> 11 < r->chance[j]) distance |= (int64_t)1 << j;
    return distance;
}

void line_create(bus_t *b)
{
    for (int32_t i = 0; i < b->set.n_rates; i++) {
        rate_t *r = &b->rates[i];
        double q = 1.0 - r->set.rate;
        r->random = b->set.seed + 0xD1B54A32D192ED03u * (uint64_t)(i + 1);
        for (int32_t j = 0; j < 48; j++) {
            r->chance[j] = (uint64_t)(q / (1.0 + q) * 9007199254740992.0);
            q *= q;
        }
        r->distance = draw_distance(r);
    }
}

/* A start of frame: which scripts act in this attempt. */
int32_t line_attempt(bus_t *b, const can_frame_t *f)
{
    int32_t any = 0;
    for (int32_t i = 0; i < b->set.n_scripts; i++) {
        script_t *s = &b->scripts[i];
        s->active = 0;
        if (s->set.id != f->id || s->set.extended != ((f->flags & CAN_EXTENDED) != 0)) continue;
        s->count++;
        s->active = s->set.attempt == 0 || s->set.attempt == s->count;
        any |= s->active;
    }
    return any;
}

/* Those that are over at `t` are not looked at again. They are in the order of their begins. */
static void forget(bus_t *b, int64_t t)
{
    while (b->over < b->set.n_interruptions && b->interruptions[b->over].to <= t) b->over++;
}

/* Whether nothing disturbs `bits` bits between two times. */
int32_t line_calm(bus_t *b, int64_t from, int64_t to, int32_t bits)
{
    forget(b, from);
    for (int32_t i = b->over; i < b->set.n_interruptions && b->interruptions[i].from < to; i++)
        if (b->interruptions[i].to > from) return 0;
    for (int32_t i = 0; i < b->set.n_rates; i++)
        if (b->rates[i].distance < bits || b->rates[i].left) return 0;
    return 1;
}

/* Busy bits that went by undisturbed. */
void line_pass(bus_t *b, int32_t bits)
{
    for (int32_t i = 0; i < b->set.n_rates; i++)
        if (b->rates[i].distance != NEVER) b->rates[i].distance -= bits;
}

/* Whether a script is still to act on bits to come. */
int32_t line_busy(const bus_t *b)
{
    for (int32_t i = 0; i < b->set.n_scripts; i++) {
        const script_t *s = &b->scripts[i];
        if (s->active && b->bit < s->set.bit + s->set.length) return 1;
    }
    return 0;
}

/* When an interruption makes the idle bus, or what a node sees of it, dominant. */
int64_t line_glitch(const bus_t *b)
{
    int64_t first = NEVER;
    for (int32_t i = b->over; i < b->set.n_interruptions; i++) {
        const bus_interruption_t *x = &b->interruptions[i];
        if (x->from > first) break;
        int64_t at = x->from > b->free ? x->from : b->free;
        if (x->level <= LEVEL_DOMINANT && at < x->to && at < first) first = at;
    }
    return first;
}

/* The next interruption of this bit from number `i` on, or n_interruptions. */
static int32_t in_force(const bus_t *b, int32_t i)
{
    while (i < b->set.n_interruptions && b->interruptions[i].to <= b->t) i++;
    return i < b->set.n_interruptions && b->interruptions[i].from <= b->t ? i : b->set.n_interruptions;
}

/* Whether what a node sends is on the bus. */
int32_t line_connected(const bus_t *b, int32_t node)
{
    for (int32_t i = in_force(b, b->over); i < b->set.n_interruptions; i = in_force(b, i + 1))
        if (b->interruptions[i].level == LEVEL_DISCONNECTED && b->interruptions[i].node == node) return 0;
    return 1;
}

/* Draw the random errors of this bit. */
void line_draw(bus_t *b)
{
    forget(b, b->t);
    for (int32_t i = 0; i < b->set.n_rates; i++) {
        rate_t *r = &b->rates[i];
        r->hit = r->left > 0 || r->distance == 0;
        if (r->left > 0) r->left--;
        else if (r->hit) {
            r->left = r->set.length - 1;
            r->distance = draw_distance(r);
        } else if (r->distance != NEVER) r->distance--;
    }
}

static int32_t changed(int32_t bit, int32_t level)
{
    return level == LEVEL_INVERTED ? !bit : level != LEVEL_DOMINANT;
}

/* What becomes of a bit on the bus (node -1) or at a node. */
static int32_t disturbed(const bus_t *b, int32_t node, int32_t bit)
{
    for (int32_t i = 0; i < b->set.n_scripts; i++) {
        const script_t *s = &b->scripts[i];
        if (s->active && s->set.node == node && b->bit >= s->set.bit && b->bit < s->set.bit + s->set.length)
            bit = changed(bit, s->set.level);
    }
    for (int32_t i = 0; i < b->set.n_rates; i++)
        if (b->rates[i].hit && b->rates[i].set.node == node) bit = !bit;
    for (int32_t i = in_force(b, b->over); i < b->set.n_interruptions; i = in_force(b, i + 1))
        if (b->interruptions[i].node == node) bit = changed(bit, b->interruptions[i].level);
    return bit;
}

int32_t line_bus(const bus_t *b, int32_t level) { return disturbed(b, -1, level); }

int32_t line_node(const bus_t *b, int32_t node, int32_t level) { return disturbed(b, node, level); }
