/* run_epoch.c: sending and accepting EPOCH on the buses of a node; see epoch.h and run_epoch.h. */
#include "run_epoch.h"

#include <string.h>

#include "forward.h"
#include "send.h"

enum { APART_NS = 100000000 /* between two of them on a bus */, LONG_STAMP = 32 /* bits */ };
static const int64_t STAMP_TURN_NS = ((int64_t)1 << 32) * 1000;
static const int64_t BELIEVED_NS = 2000000000; /* a date may differ so much from what samples say */
static const int64_t FRESH_NS = 1000000000;    /* START belongs to the EPOCH that came so long before */
static const int64_t AHEAD_NS = 5000000000;    /* the latest t = 0 of a host that only a number tells */

/* HOST, and DATE if that host has the date of this one, before an EPOCH with these values on a bus whose EPOCH
 * has no room for the identity of the host. */
static void introduce(node_t *n, int32_t bus, const double *v, int32_t dated, header_t header)
{
    const message_t *m = n->services[bus].epoch;
    const int64_t t = pace_now();
    const double date[EPOCH_VALUES] = {(int32_t)v[EPOCH_HOST] & EPOCH_DATE_RUN, EPOCH_DATE_HOST, 0,
                                       (double)epoch_origin_us(t + pace_date())};
    double host[EPOCH_VALUES];
    if (!m || m->n_fields > EPOCH_IDENTITY) return;
    epoch_host_values(v, host);
    header.counter = n->epoch.said++;
    node_service(n, bus, m, host, header, t - n->start_ns);
    if (!dated) return;
    header.counter = n->epoch.said++;
    node_service(n, bus, m, date, header, t - n->start_ns);
}

/* The next EPOCH, with what goes before it. */
static void say(node_t *n, int32_t bus, const double *v)
{
    const message_t *m = n->services[bus].epoch;
    header_t header = {0, n->simulated ? STATUS_SIMULATED : 0, 0, 0};
    if (!m || n->epoch.adopts) return;
    introduce(n, bus, v, 1, header);
    header.counter = n->epoch.said++;
    node_service(n, bus, m, v, header, pace_now() - n->start_ns);
}

void node_epoch(node_t *n)
{
    epoch_t *e = &n->epoch;
    double v[EPOCH_VALUES] = {e->run, e->host, e->kept, (double)epoch_origin_us(n->start_ns + pace_date())};
    memcpy(v + EPOCH_IDENTITY, e->identity, sizeof e->identity);
    e->due_ns = pace_now() + APART_NS;
    for (int32_t b = 0; b < n->n_buses; b++) say(n, b, v);
}

void node_epoch_answer(node_t *n)
{
    epoch_t *e = &n->epoch;
    if (!e->asked || n->clock != CLOCK_WALL) return;
    e->asked = 0;
    if (n->life.state == LIFE_ACTIVE && pace_now() >= e->due_ns) node_epoch(n);
}

/* Whether samples of the run that have come say another t = 0 by their time stamps: then the date is that of
 * another clock, although its host has our number (one in 255 has). Only long stamps tell seconds. */
static int32_t contradicted(const node_t *n, int64_t origin)
{
    for (int32_t i = 0; i < n->n_receptions; i++) {
        const reception_t *r = n->receptions + i;
        if (!r->early || r->receiver->time_bits < LONG_STAMP) continue;
        int64_t late = (r->early_ns - origin) % STAMP_TURN_NS;
        if (late > STAMP_TURN_NS / 2) late -= STAMP_TURN_NS;
        if (late < -STAMP_TURN_NS / 2) late += STAMP_TURN_NS;
        if (late < -BELIEVED_NS || late > BELIEVED_NS + r->max_age_ns) return 1;
    }
    return 0;
}

/* 1: the host of an EPOCH is ours by the HOST before it; -1: it is another; 0: none came. */
static int32_t named(const epoch_t *e, const double *v, int64_t t_ns)
{
    const int32_t number = (int32_t)v[EPOCH_HOST] & EPOCH_DATE_RUN;
    if (!e->named_ns || number != e->named_host || t_ns - e->named_ns > FRESH_NS) return 0;
    return e->named;
}

/* The same by the message, or by the HOST before it where it does not say. */
static int32_t identified(const epoch_t *e, const message_t *m, const double *v, int64_t t_ns)
{
    int32_t same = 1, said = 0;
    for (int32_t i = 0; m->n_fields >= EPOCH_VALUES && i < 4; i++) {
        same &= v[EPOCH_IDENTITY + i] == e->identity[i];
        said |= v[EPOCH_IDENTITY + i] != 0.0; /* a gateway has none from CAN */
    }
    if (!said) return named(e, v, t_ns);
    return same ? 1 : -1;
}

/* Whether both hosts' dates are kept by time servers. */
static int32_t kept_both(const epoch_t *e, const double *v) { return v[EPOCH_KEPT] != 0.0 && e->kept; }

/* A gateway passes it on. The HOST before it is that of its sender, not of the gateway, whose DATE is of use only
 * if both have one clock. An EPOCH from CAN has no identity, and its own HOST and DATE pass like it. */
static void pass(node_t *n, const message_t *m, const double *v, header_t header, const frame_t *came)
{
    const epoch_t *e = &n->epoch;
    const int32_t dated = kept_both(e, v) || identified(e, m, v, came->t_ns) > 0;
    for (int32_t b = 0; b < n->n_buses; b++)
        if (b != came->bus && v[EPOCH_IDENTITY] != 0.0) introduce(n, b, v, dated, header);
    node_pass(n, offsetof(services_t, epoch), v, header, came);
}

/* The same for its date: a DATE of this host came, and it is ours or not. */
static int32_t dated(const epoch_t *e, const double *v, int64_t t_ns)
{
    const int32_t number = (int32_t)v[EPOCH_HOST] & EPOCH_DATE_RUN;
    if (!e->dated_ns || number != e->dated_host || t_ns - e->dated_ns > FRESH_NS) return 0;
    return e->apart_ns < -BELIEVED_NS || e->apart_ns > BELIEVED_NS ? -1 : 1;
}

/* Whether samples of the run tell its date in seconds, none of which has come. */
static int32_t unsampled(const node_t *n)
{
    int32_t telling = 0;
    for (int32_t i = 0; i < n->n_receptions; i++) {
        const reception_t *r = n->receptions + i;
        if (r->receiver->time_bits < LONG_STAMP) continue;
        if (r->early) return 0;
        telling = 1;
    }
    return telling;
}

enum { REFUSED = -1, UNKNOWN, BELIEVED };

/* Whether this origin is believed, or nothing is known that speaks for it or against it. */
static int32_t judged(const node_t *n, const message_t *m, const double *v, int64_t origin, int64_t t_ns)
{
    const epoch_t *e = &n->epoch;
    const int32_t kept = kept_both(e, v);
    const int32_t who = identified(e, m, v, t_ns), date = dated(e, v, t_ns);
    const int32_t ours = (int32_t)v[EPOCH_HOST] == e->host || (e->adopts && date > 0);
    if (!kept && (!ours || who < 0)) return REFUSED;
    if (date < 0 || (origin <= t_ns && contradicted(n, origin))) return REFUSED;
    if (kept || who > 0 || date > 0) return BELIEVED;
    if (origin > t_ns) return origin - t_ns > AHEAD_NS ? REFUSED : BELIEVED;
    return unsampled(n) ? UNKNOWN : BELIEVED;
}

void node_epoch_heard(node_t *n, const frame_t *frame)
{
    double v[EPOCH_VALUES];
    header_t header;
    epoch_t *e = &n->epoch;
    const message_t *m = n->services[frame->bus].epoch;
    memset(&header, 0, sizeof header);
    memset(v, 0, sizeof v);
    if (message_decode(m, frame, v, &header) != DECODE_OK) {
        n->damaged++;
        return;
    }
    e->heard++;
    if (n->gateway) pass(n, m, v, header, frame);
    const int64_t origin = epoch_origin_ns(v[EPOCH_ORIGIN], frame->t_ns);
    if ((int32_t)v[EPOCH_HOST] == EPOCH_DATE_HOST && v[EPOCH_KEPT] != 0.0) {
        e->named = epoch_host_is(e, v);
        e->named_ns = frame->t_ns;
        e->named_host = (int32_t)v[EPOCH_RUN];
        e->dated_ns = 0; /* a DATE before it belongs to another EPOCH */
        return;
    }
    if ((int32_t)v[EPOCH_HOST] == EPOCH_DATE_HOST) {
        e->apart_ns = origin - frame->t_ns;
        e->dated_ns = frame->t_ns;
        e->dated_host = (int64_t)v[EPOCH_RUN];
        if (e->adopts) e->date_ns += e->apart_ns, e->apart_ns = 0;
        return;
    }
    e->due_ns = frame->t_ns + APART_NS; /* a waiting node has received it */
    if (n->begun || n->clock != CLOCK_WALL) return;
    const int32_t running = origin <= frame->t_ns;
    if (running && !n->simulated && header.status & STATUS_SIMULATED) return;
    const int32_t found = judged(n, m, v, origin, frame->t_ns);
    e->named_ns = 0;
    e->unshared += found == REFUSED;
    if (found != BELIEVED) return;
    e->origin_ns = origin;
    e->heard_ns = frame->t_ns;
    e->told = (int32_t)v[EPOCH_RUN];
    e->running = running;
}

API int64_t node_origin(const node_t *n, int64_t arrival_ns, int64_t lead_ns)
{
    const epoch_t *e = &n->epoch;
    if (e->origin_ns && arrival_ns - e->heard_ns <= FRESH_NS) return e->origin_ns;
    return arrival_ns + lead_ns;
}

int32_t node_run_of(const node_t *n, int64_t start_ns, int32_t told)
{
    if (n->epoch.origin_ns && start_ns == n->epoch.origin_ns) return n->epoch.told;
    return told ? epoch_run(start_ns) : 0;
}
