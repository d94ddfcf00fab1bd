/* run_epoch.c: sending and accepting EPOCH on the buses of a node; see epoch.h and run_epoch.h. */
#include "run_epoch.h"

#include <string.h>

#include "forward.h"
#include "send.h"

enum { APART_NS = 100000000 /* between two of them on a bus */, LONG_STAMP = 32 /* bits */ };
static const int64_t STAMP_TURN_NS = ((int64_t)1 << 32) * 1000;
static const int64_t BELIEVED_NS = 2000000000;  /* a date may differ so much from what samples say */
static const int64_t FRESH_NS = 1000000000;     /* START belongs to the EPOCH that came so long before */

void node_epoch(node_t *n)
{
    epoch_t *e = &n->epoch;
    const double origin = (double)epoch_origin_us(n->start_ns + pace_date());
    const double v[EPOCH_VALUES] = {e->run, e->host, e->kept, origin};
    const header_t header = {e->said++, n->simulated ? STATUS_SIMULATED : 0, 0, 0};
    e->due_ns = pace_now() + APART_NS;
    for (int32_t b = 0; b < n->n_buses; b++)
        node_service(n, b, n->services[b].epoch, v, header, pace_now() - n->start_ns);
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

void node_epoch_heard(node_t *n, const frame_t *frame)
{
    double v[EPOCH_VALUES];
    header_t header;
    epoch_t *e = &n->epoch;
    memset(&header, 0, sizeof header);
    if (message_decode(n->services[frame->bus].epoch, frame, v, &header) != DECODE_OK) return;
    if (n->gateway) node_pass(n, offsetof(services_t, epoch), v, header, frame);
    e->due_ns = frame->t_ns + APART_NS;     /* a waiting node has received it */
    if (n->begun || n->clock != CLOCK_WALL) return;
    if ((int32_t)v[EPOCH_HOST] != e->host && !(v[EPOCH_KEPT] != 0.0 && e->kept)) {
        e->unshared++;
        return;
    }
    const int64_t origin = epoch_origin_ns(v[EPOCH_ORIGIN], frame->t_ns);
    const int32_t running = origin <= frame->t_ns;
    if (running && !n->simulated && header.status & STATUS_SIMULATED) return;
    if (running && contradicted(n, origin)) {
        e->unshared++;
        return;
    }
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
