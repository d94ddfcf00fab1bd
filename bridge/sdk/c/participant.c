/* participant.c: see participant.h. Each rule of the protocol is a function; the page docs/participants.md has
 * them in the same order. */
#include "participant.h"

#include <stdio.h>
#include <string.h>

/* Values of services, in this order. */
enum { NMT_COMMAND, NMT_NODE, NMT_VALUES };
enum { ESTOP_NODE, ESTOP_REASONS, ESTOP_VALUES };
enum { BEAT_STATE, BEAT_REASONS, BEAT_BOOTS, BEAT_ARMED, BEAT_VALUES };
enum { EPOCH_RUN, EPOCH_HOST, EPOCH_KEPT, EPOCH_ORIGIN, EPOCH_IDENTITY, EPOCH_VALUES = EPOCH_IDENTITY + 4 };
enum { NMT_START = 1, NMT_STOP = 2, NMT_ARM = 128, NMT_RESET = 129 };
enum { BOOTS = 4096, RUNS = 63, DATE_HOST = 0, DATE_RUN = 63, SYNCS = 240 };
enum { ESTOPS = 10 /* frames that pass an emergency stop on */ };

#define MS INT64_C(1000000)
static const int64_t IDLE_NS = 5 * MS;                  /* between two looks before the start */
static const int64_t BEAT_NS = 20 * MS;                 /* between two heartbeats before the start */
static const int64_t LEAD_NS = 100 * MS;                /* from a START without EPOCH to t = 0 */
static const int64_t OBEY_NS = 100 * MS;                /* before t = 0: START is obeyed from then on, */
static const int64_t REFUSE_NS = 20 * MS;               /* and refused then */
static const int64_t ARM_NS = 2000 * MS;                /* ARM waits so long for what is missing */
static const int64_t FRESH_NS = 1000 * MS;              /* an EPOCH belongs to a START that comes so soon */
static const int64_t SETTLE_NS = 500 * MS;              /* no EPOCH is sent so early in a life */
static const int64_t APART_NS = 100 * MS;               /* between two EPOCHs of this node */
static const int64_t ALARM_NS = 10 * MS;                /* between two ESTOPs */
static const int64_t JOIN_NS = 50 * MS;                 /* from joining a run to the first slot */
static const int64_t BELIEVED_NS = 2000 * MS;           /* two dates may differ by so much */
static const int64_t AHEAD_NS = 5000 * MS;              /* the latest t = 0 of a host without an identity */
static const int64_t TURN_NS = INT64_C(85899345920000); /* of EPOCH's origin: 2^33 units of 10 us */
static const int64_t FUTURE_NS = 300000 * MS;           /* the latest origin that an EPOCH can mean */

/* ---- sending ---- */

static void send_frame(participant_t *p, int32_t bus, frame_t *frame, const char *key)
{
    frame->bus = (uint8_t)bus;
    frame->t_ns = p->now_ns;
    p->send(p->context, bus, frame, key);
}

static void send_service(participant_t *p, int32_t bus, const message_t *m, const char *key,
                         const double *values, uint32_t counter, uint32_t status)
{
    frame_t frame;
    header_t header = {counter, status, 0, 0};
    if (!m) return;
    memset(&frame, 0, sizeof frame);
    message_encode(m, values, &header, &frame);
    send_frame(p, bus, &frame, key);
}

/* Status: life cycle, armed, why it stopped, simulated. After a stop within the run it is STOPPING, so that
 * samples are never taken for previews. */
static uint32_t status(const participant_t *p)
{
    const int32_t idle = p->begun && p->life.state == LIFE_INACTIVE;
    uint32_t s = (uint32_t)(idle ? LIFE_STOPPING : p->life.state) & STATUS_LIFE;
    if (p->life.armed) s |= STATUS_DEADMAN;
    if (p->life.reasons & WHY_ESTOP) s |= STATUS_ESTOP;
    if (p->life.reasons & WHY_STALE) s |= STATUS_STALE;
    if (p->table->simulated) s |= STATUS_SIMULATED;
    return s;
}

/* Torques are limited, and scaled by the life cycle: 1 ACTIVE, falling STOPPING, else 0. */
static void guard(const participant_t *p, const sent_t *m, double *values)
{
    for (int32_t k = 0; k < m->torques; k++) {
        double *tau = values + m->first_torque + k;
        const double most = m->tau_max ? m->tau_max[k] : 0.0;
        if (*tau - *tau != 0.0) *tau = 0.0;
        if (m->tau_max && *tau > most) *tau = most;
        if (m->tau_max && *tau < -most) *tau = -most;
        *tau = p->life.scale > 0.0 ? *tau * p->life.scale : 0.0;
    }
}

/* Sample `number` of a message: its counter, and its nominal time as the stamp. */
static void send_sample(participant_t *p, int32_t i, int64_t number)
{
    const participant_table_t *t = p->table;
    const sent_t *m = t->sent + i;
    double values[PARTICIPANT_VALUES];
    frame_t frame;
    header_t header = {0, 0, 0, 0};
    memcpy(values, p->outputs[i].values, sizeof values);
    guard(p, m, values);
    memset(&frame, 0, sizeof frame);
    header.counter = (uint32_t)number;
    header.status = status(p);
    header.t_us = (uint32_t)((number * m->every * t->h_ns + t->phase_ns) / 1000);
    message_encode(&m->layout, values, &header, &frame);
    p->outputs[i].frames++;
    p->outputs[i].saturated += header.saturated != 0;
    send_frame(p, m->bus, &frame, m->key);
}

/* A status of 8 bits has the state of its sender; one of 4 bits (classic CAN) has not. */
static int32_t tells_life(const message_t *m) { return m->status >= 0 && m->header[m->status].scale == 1.0; }

/* Before the start: sample 0 with the first values, in messages that tell that their sender waits. */
static void send_previews(participant_t *p)
{
    for (int32_t i = 0; i < p->table->n_sent; i++) {
        if (!tells_life(&p->table->sent[i].layout)) continue;
        send_sample(p, i, 0);
        p->outputs[i].frames = 0;
    }
}

static void send_heartbeat(participant_t *p)
{
    const double v[BEAT_VALUES] = {p->life.state, p->life.reasons, p->boots % BOOTS, p->life.armed};
    uint32_t s = p->table->simulated ? STATUS_SIMULATED : 0;
    if (p->life.reasons & WHY_ESTOP) s |= STATUS_ESTOP;
    if (p->life.reasons & WHY_STALE) s |= STATUS_STALE;
    for (int32_t b = 0; b < p->table->n_buses; b++) {
        const bus_table_t *bus = p->table->buses + b;
        send_service(p, b, bus->heartbeat, bus->heartbeat_key, v, p->beats, s);
    }
    p->beats++;
}

static void send_sync(participant_t *p)
{
    const double counter = 1.0 + p->syncs++ % SYNCS;
    for (int32_t b = 0; b < p->table->n_buses; b++)
        send_service(p, b, p->table->buses[b].sync, 0, &counter, 0, 0);
}

/* ---- emergency stop ---- */

static void send_estop(participant_t *p)
{
    const double v[ESTOP_VALUES] = {p->table->number, p->life.reasons | WHY_ESTOP};
    for (int32_t b = 0; b < p->table->n_buses; b++)
        send_service(p, b, p->table->buses[b].estop, p->table->buses[b].estop_key, v, 0, 0);
}

/* One that was received is passed on ten times; its own is repeated until RESET. */
static void pass_estop_on(participant_t *p)
{
    if (!(p->life.reasons & WHY_ESTOP)) {
        p->alarms = -1;
        p->alarm_own = 0;
        return;
    }
    if (p->alarms < 0) {
        p->alarms = ESTOPS;
        p->alarm_ns = p->now_ns;
    }
    if ((p->alarms > 0 || p->alarm_own) && p->now_ns >= p->alarm_ns) {
        send_estop(p);
        p->alarms -= p->alarms > 0;
        p->alarm_ns = p->now_ns + ALARM_NS;
    }
}

/* On CAN every data frame with the identifier counts, of any length, classic or FD. On Zenoh its checksum
 * must be right. */
static int32_t is_estop(const message_t *m, const frame_t *frame)
{
    double v[ESTOP_VALUES];
    header_t header;
    const accept_t any = {m ? m->id : 0, UINT32_MAX, m ? m->flags & FRAME_EXTENDED : 0,
                          FRAME_FORMAT & ~FRAME_FD};
    if (!m || !frame_accepted(&any, frame)) return 0;
    return m->e2e == E2E_NONE || message_decode(m, frame, v, &header) == DECODE_OK;
}

/* ---- EPOCH: the run, and the date of its t = 0 ---- */

static int64_t origin_us(int64_t date_ns) { return (date_ns + 5000) % TURN_NS / 10000 * 10; }

/* t = 0, on the participant's clock, of an EPOCH with this origin that came at arrival_ns. */
static int64_t origin_of(const participant_t *p, double us, int64_t arrival_ns)
{
    int64_t since = (arrival_ns + p->host.date_offset_ns - (int64_t)us * 1000) % TURN_NS;
    if (since < 0) since += TURN_NS;
    if (since > TURN_NS - FUTURE_NS) since -= TURN_NS;
    return arrival_ns - since;
}

/* On CAN a HOST and a DATE go before each EPOCH. */
static void send_epoch(participant_t *p)
{
    const participant_host_t *h = &p->host;
    const uint32_t s = p->table->simulated ? STATUS_SIMULATED : 0;
    const double date = (double)origin_us(p->now_ns + h->date_offset_ns);
    double v[EPOCH_VALUES] = {p->run, h->number, h->kept, (double)origin_us(p->start_ns + h->date_offset_ns)};
    const double host[EPOCH_VALUES] = {h->number & DATE_RUN, DATE_HOST, 1, h->identity[0] * 10.0};
    const double now[EPOCH_VALUES] = {h->number & DATE_RUN, DATE_HOST, 0, date};
    memcpy(v + EPOCH_IDENTITY, h->identity, sizeof h->identity);
    p->epoch_due_ns = p->now_ns + APART_NS;
    for (int32_t b = 0; b < p->table->n_buses; b++) {
        const bus_table_t *bus = p->table->buses + b;
        if (bus->epoch && !bus->prefix) {
            send_service(p, b, bus->epoch, 0, host, p->epochs++, s);
            send_service(p, b, bus->epoch, 0, now, p->epochs++, s);
        }
        if (bus->epoch) send_service(p, b, bus->epoch, bus->epoch_key, v, p->epochs++, s);
    }
}

/* 1: its sender is this host by the HOST that came before it; -1: another; 0: none came. */
static int32_t named(const participant_t *p, const double *v, int64_t arrival_ns)
{
    const int32_t number = (int32_t)v[EPOCH_HOST] & DATE_RUN;
    if (!p->named_ns || number != p->named_host || arrival_ns - p->named_ns > FRESH_NS) return 0;
    return p->host.identity[0] == 0.0 ? 0 : p->named == p->host.identity[0] * 10.0 ? 1 : -1;
}

/* The same by the message, or on CAN by the HOST before it. */
static int32_t identified(const participant_t *p, const message_t *m, const double *v, int64_t arrival_ns)
{
    int32_t same = 1, said = 0;
    for (int32_t i = 0; m->n_fields >= EPOCH_VALUES && i < 4; i++) {
        same &= v[EPOCH_IDENTITY + i] == p->host.identity[i];
        said |= v[EPOCH_IDENTITY + i] != 0.0;
    }
    if (!said) return named(p, v, arrival_ns);
    return same ? 1 : -1;
}

/* The same by the DATE that came before it. */
static int32_t dated(const participant_t *p, const double *v, int64_t arrival_ns)
{
    const int32_t number = (int32_t)v[EPOCH_HOST] & DATE_RUN;
    if (!p->date_ns || number != p->date_host || arrival_ns - p->date_ns > FRESH_NS) return 0;
    return p->date_apart_ns < -BELIEVED_NS || p->date_apart_ns > BELIEVED_NS ? -1 : 1;
}

/* Samples of a run that is on tell its t = 0 to some ms: 1 they agree; -1 they do not; 0 none came, and some
 * will; 1 also where none can tell. */
static int32_t sampled(const participant_t *p, int64_t origin)
{
    int32_t telling = 0;
    for (int32_t i = 0; i < p->table->n_received; i++) {
        const input_t *in = p->inputs + i;
        if (in->receiver.time_bits < 32) continue;
        telling = 1;
        if (!in->early) continue;
        const int64_t turn = (INT64_C(1) << 32) * 1000; /* of a stamp */
        int64_t late = (in->early_ns - origin) % turn;
        if (late > turn / 2) late -= turn;
        if (late < -turn / 2) late += turn;
        return late < -BELIEVED_NS || late > BELIEVED_NS + p->table->received[i].max_age_ns ? -1 : 1;
    }
    return !telling;
}

/* True if this t = 0 is of our clock: the sender is on this host, or time servers keep both dates. */
static int32_t believed(const participant_t *p, const message_t *m, const double *v, int64_t origin,
                        int64_t arrival_ns)
{
    const int32_t kept = v[EPOCH_KEPT] != 0.0 && p->host.kept, begun = origin <= arrival_ns;
    const int32_t who = identified(p, m, v, arrival_ns), date = dated(p, v, arrival_ns);
    if (!kept && ((int32_t)v[EPOCH_HOST] != p->host.number || who < 0)) return 0;
    if (date < 0 || (begun && sampled(p, origin) < 0)) return 0;
    if (kept || who > 0 || date > 0) return 1;
    return begun ? sampled(p, origin) > 0 : origin - arrival_ns <= AHEAD_NS;
}

static void take_epoch(participant_t *p, const frame_t *frame)
{
    double v[EPOCH_VALUES] = {0};
    header_t header = {0, 0, 0, 0};
    const message_t *m = p->table->buses[frame->bus].epoch;
    if (message_decode(m, frame, v, &header) != DECODE_OK) {
        p->damaged++;
        return;
    }
    const int64_t origin = origin_of(p, v[EPOCH_ORIGIN], frame->t_ns);
    if ((int32_t)v[EPOCH_HOST] == DATE_HOST && v[EPOCH_KEPT] != 0.0) {
        p->named = v[EPOCH_ORIGIN];
        p->named_ns = frame->t_ns;
        p->named_host = (int32_t)v[EPOCH_RUN];
        p->date_ns = 0; /* a DATE before it belongs to another EPOCH */
        return;
    }
    if ((int32_t)v[EPOCH_HOST] == DATE_HOST) {
        p->date_apart_ns = origin - frame->t_ns;
        p->date_ns = frame->t_ns;
        p->date_host = (int32_t)v[EPOCH_RUN];
        return;
    }
    p->epoch_due_ns = frame->t_ns + APART_NS; /* another node has announced it */
    if (p->begun) return;
    const int32_t running = origin <= frame->t_ns;
    if (running && !p->table->simulated && header.status & STATUS_SIMULATED) return;
    const int32_t is_believed = believed(p, m, v, origin, frame->t_ns);
    p->named_ns = 0; /* a HOST is that of one EPOCH */
    if (!is_believed) return;
    p->origin_ns = origin;
    p->epoch_ns = frame->t_ns;
    p->told = (int32_t)v[EPOCH_RUN];
    p->running = running;
}

/* A running node tells a peer that waits which run is on. */
static void answer_epoch(participant_t *p)
{
    if (p->asked && p->life.state == LIFE_ACTIVE && p->now_ns >= p->epoch_due_ns) send_epoch(p);
    p->asked = 0;
}

/* ---- receiving ---- */

static int32_t command_of(int32_t nmt)
{
    switch (nmt) {
    case NMT_START: return COMMAND_START;
    case NMT_STOP: return COMMAND_STOP;
    case NMT_ARM: return COMMAND_ARM;
    case NMT_RESET: return COMMAND_RESET;
    default: return COMMAND_NONE;
    }
}

/* t = 0 is that of the EPOCH before START, or else 100 ms after its arrival. */
static void take_nmt(participant_t *p, const frame_t *frame)
{
    double v[NMT_VALUES];
    header_t header;
    if (message_decode(p->table->buses[frame->bus].nmt, frame, v, &header) != DECODE_OK) {
        p->damaged++;
        return;
    }
    if (v[NMT_NODE] != 0.0 && (int32_t)v[NMT_NODE] != p->table->number) return;
    const int32_t command = command_of((int32_t)v[NMT_COMMAND]);
    if (command == COMMAND_START) {
        const int32_t fresh = p->origin_ns && frame->t_ns - p->epoch_ns <= FRESH_NS;
        p->nmt_ns = fresh ? p->origin_ns : frame->t_ns + LEAD_NS;
    }
    if (command != COMMAND_NONE) p->life.commands = commands_add(p->life.commands, command);
}

/* A peer that has started again (boots) may count anew. */
static int32_t take_heartbeat(participant_t *p, const frame_t *frame)
{
    for (int32_t i = 0; i < p->table->n_neighbours; i++) {
        const neighbour_t *other = p->table->neighbours + i;
        peer_t *peer = p->peers + i;
        double v[BEAT_VALUES];
        header_t header = {0, 0, 0, 0};
        if (other->bus != frame->bus || !message_is(&other->heartbeat, frame)) continue;
        if (message_decode(&other->heartbeat, frame, v, &header) != DECODE_OK) {
            p->damaged++;
            return 1;
        }
        if (!p->table->simulated && header.status & STATUS_SIMULATED) return 1;
        const uint32_t boots = (uint32_t)v[BEAT_BOOTS];
        for (int32_t k = 0; peer->state >= 0 && boots != peer->boots && k < p->table->n_received; k++)
            if (p->table->received[k].sender == other->number) p->inputs[k].receiver.sequence = -1;
        p->life.now |= peer_heartbeat(peer, (int32_t)v[BEAT_STATE], boots, frame->t_ns);
        p->asked |= p->begun && peer->state == LIFE_INACTIVE;
        return 1;
    }
    return 0;
}

/* Length, checksum, invalid and range; a simulated sample moves no real drive. */
static int32_t refuses(participant_t *p, int32_t i, const frame_t *frame, double *values, header_t *header)
{
    const received_t *m = p->table->received + i;
    receiver_t *r = &p->inputs[i].receiver;
    switch (message_decode(&m->layout, frame, values, header)) {
    case DECODE_OK: break;
    case DECODE_LENGTH: r->length++; return 1;
    case DECODE_CRC: r->crc++; return 1;
    case DECODE_INVALID: r->invalid++; return 1;
    default: r->range++; return 1;
    }
    if (m->layout.status >= 0 && header->status & STATUS_SIMULATED && !p->table->simulated) {
        r->simulated++;
        return 1;
    }
    if (limits_range(m->limits, m->layout.n_fields, values)) return 0;
    r->range++;
    return 1;
}

/* True for a sample of the run, not a preview: by the state of its sender, else from t = 0 on. */
static int32_t is_of_run(const participant_t *p, const received_t *m, const header_t *header, int64_t t)
{
    const int32_t life = (int32_t)(header->status & STATUS_LIFE);
    if (!tells_life(&m->layout)) return p->start_ns != 0 && t >= 0;
    return life != LIFE_UNCONFIGURED && life != LIFE_INACTIVE;
}

/* No faster than it can change since the last sample, or in a period. */
static int32_t too_fast(const participant_t *p, int32_t i, const double *values, int64_t t)
{
    const received_t *m = p->table->received + i;
    const input_t *in = p->inputs + i;
    const int64_t since = t - in->arrival_ns < m->period_ns ? m->period_ns : t - in->arrival_ns;
    return in->newest >= 0 &&
           !limits_rate(m->limits, m->layout.n_fields, values, in->values, (double)since * 1e-9);
}

static void keep(input_t *in, const received_t *m, const double *values, uint32_t tells)
{
    memcpy(in->values, values, (size_t)m->layout.n_fields * sizeof *values);
    in->status = tells;
}

/* A sample of FAULT stops the peer before its heartbeat does. */
static void take_fault(participant_t *p, const received_t *m, const header_t *header)
{
    if (!tells_life(&m->layout) || (header->status & STATUS_LIFE) != LIFE_FAULT) return;
    for (int32_t i = 0; i < p->table->n_neighbours; i++)
        if (p->table->neighbours[i].number == m->sender) p->peers[i].state = LIFE_FAULT;
}

static void take_sample(participant_t *p, int32_t i, const frame_t *frame)
{
    const received_t *m = p->table->received + i;
    input_t *in = p->inputs + i;
    double values[PARTICIPANT_VALUES];
    header_t header = {0, 0, 0, 0};
    if (refuses(p, i, frame, values, &header)) return;
    const int64_t t = frame->t_ns - p->start_ns;
    if (!is_of_run(p, m, &header, t)) {
        keep(in, m, values, header.status);
        in->previewed_ns = frame->t_ns;
        return;
    }
    if (p->start_ns == 0) {
        in->early++;
        in->early_ns = frame->t_ns - (int64_t)header.t_us * 1000;
        return;
    }
    if (too_fast(p, i, values, t)) {
        in->receiver.rate++;
        return;
    }
    const int64_t number = receiver_accept(&in->receiver, &header, t);
    if (number < 0) return;
    take_fault(p, m, &header);
    if (m->max_age_ns > 0 && t - in->receiver.sampled_ns > m->max_age_ns) {
        in->receiver.stale++;
        return;
    }
    /* torque of a node in FAULT is 0, and feeds no watchdog */
    if (m->torque && (header.status & STATUS_LIFE) == LIFE_FAULT && tells_life(&m->layout)) return;
    if (number <= in->newest) return;
    keep(in, m, values, header.status);
    in->newest = number;
    in->arrival_ns = t;
}

API void participant_hear(participant_t *p, const frame_t *frame)
{
    const participant_table_t *t = p->table;
    if (frame->bus >= t->n_buses || p->over) return;
    const bus_table_t *bus = t->buses + frame->bus;
    for (int32_t i = 0; i < t->n_received; i++) {
        if (t->received[i].bus != frame->bus || !message_is(&t->received[i].layout, frame)) continue;
        take_sample(p, i, frame);
        return;
    }
    if (is_estop(bus->estop, frame)) p->life.now |= WHY_ESTOP;
    else if (bus->nmt && message_is(bus->nmt, frame)) take_nmt(p, frame);
    else if (bus->epoch && message_is(bus->epoch, frame)) take_epoch(p, frame);
    else if (!take_heartbeat(p, frame)) p->unknown++;
}

/* ---- before the start ---- */

static int32_t has_received(const participant_t *p, int32_t i)
{
    return p->inputs[i].previewed_ns >= 0 || p->inputs[i].newest >= 0 ||
           !tells_life(&p->table->received[i].layout);
}

static int32_t is_present(const peer_t *peer, int64_t now_ns)
{
    const int32_t well = peer->state == LIFE_INACTIVE || peer->state == LIFE_ACTIVE;
    return well && now_ns - peer->heartbeat.last_ns <= peer->heartbeat.timeout_ns;
}

/* WHY_ bits of what is in the way of a start: a heartbeat of each required peer, a preview of each message
 * that it needs. */
static uint32_t missing(const participant_t *p)
{
    uint32_t why = 0;
    for (int32_t i = 0; i < p->table->n_neighbours; i++)
        if (p->table->neighbours[i].required && !is_present(p->peers + i, p->now_ns)) why |= WHY_PEER;
    for (int32_t i = 0; i < p->table->n_received; i++)
        if (p->table->received[i].awaited && !has_received(p, i)) why |= WHY_STALE;
    return why;
}

API int32_t participant_ready(const participant_t *p) { return missing(p) == 0; }

static void obey(participant_t *p, int32_t command, uint32_t why)
{
    p->life.commands = (uint32_t)command;
    p->life.now |= why;
    life_step(&p->life);
    if (!p->life.refused) return;
    p->refused = p->life.refused | p->life.reasons;
    p->refusals++;
}

static int32_t run_is_over(const participant_t *p)
{
    return p->start_ns != 0 && p->now_ns - p->start_ns >= p->table->slots * p->table->h_ns;
}

/* START waits for its time; one whose time has passed waits for what is missing. */
static void schedule_start(participant_t *p, int64_t start_ns, int32_t run)
{
    p->start_ns = start_ns;
    p->run = run;
    p->start_from = start_ns - OBEY_NS;
    p->start_until = start_ns > p->now_ns ? start_ns - REFUSE_NS : p->now_ns + p->table->patience_ns;
}

static void arm_if_free(participant_t *p)
{
    const uint32_t why = missing(p);
    if (!p->arm_until || (why && p->now_ns < p->arm_until)) return;
    p->arm_until = 0;
    obey(p, COMMAND_ARM, why);
}

/* Commands in their order; a START that waits is not changed by another one. */
static void follow(participant_t *p, uint32_t commands)
{
    for (; commands; commands >>= 3) {
        const int32_t what = (int32_t)(commands & 7);
        if (what == COMMAND_START) {
            const int64_t start_ns = p->start_until ? p->start_ns : p->nmt_ns;
            schedule_start(p, start_ns, p->origin_ns == start_ns ? p->told : 0);
        } else if (what == COMMAND_ARM) {
            p->arm_until = p->now_ns + (p->table->patience_ns < ARM_NS ? p->table->patience_ns : ARM_NS);
            arm_if_free(p);
        } else {
            obey(p, what, 0);
        }
        if (what == COMMAND_RESET) p->arm_until = 0;
    }
}

/* An EPOCH of a run that is on: it is joined, with real drives after ARM only. */
static void join(participant_t *p)
{
    const int32_t may = p->life.state == LIFE_INACTIVE && (p->table->simulated || p->life.armed);
    if (p->running && p->follows && may && !p->start_until) schedule_start(p, p->origin_ns, p->told);
    p->running = 0;
}

/* START from 100 ms to 20 ms before t = 0, as soon as nothing is missing. A rehearsal arms itself. */
static void start_if_due(participant_t *p)
{
    if (!p->start_until || p->now_ns < p->start_from) return;
    const uint32_t why = run_is_over(p) ? 0 : missing(p);
    if ((why || p->arm_until) && p->now_ns < p->start_until) return;
    if (p->table->simulated && !p->life.armed && !why) obey(p, COMMAND_ARM, 0);
    obey(p, COMMAND_START, why);
    p->start_until = 0;
}

static void attend(participant_t *p)
{
    const uint32_t heard = p->life.commands;
    const int32_t stop = commands_have(heard, COMMAND_STOP);
    p->life.commands = 0;
    p->life.now &= ~(uint32_t)WHY_NOT_YET;
    if (p->alarm_own && !(p->life.reasons & WHY_ESTOP)) p->life.now |= WHY_ESTOP;
    if (stop || (p->life.now & WHY_ESTOP && heard)) {
        p->start_until = p->arm_until = 0;
        p->follows &= !stop; /* after STOP it joins only by START */
        obey(p, stop ? COMMAND_STOP : COMMAND_START, 0);
    } else {
        follow(p, heard);
        join(p);
    }
    life_step(&p->life);
    arm_if_free(p);
    start_if_due(p);
    if (p->life.state != LIFE_ACTIVE && !p->start_until) p->start_ns = 0;
}

/* The first slot: 0, or where the run is. */
static void begin(participant_t *p)
{
    const participant_table_t *t = p->table;
    const int64_t now = p->now_ns - p->start_ns - t->phase_ns;
    p->slot = now > 0 ? (now + JOIN_NS) / t->h_ns + 2 : 0;
    p->first_slot = p->slot;
    p->begun = 1;
    p->epoch_due_ns = p->now_ns + SETTLE_NS;
    p->alarms = -1;
    for (int32_t i = 0; i < t->n_neighbours; i++) {
        const int64_t at = p->start_ns + t->phase_ns + (p->slot + 1) * t->h_ns;
        watchdog_reset(&p->peers[i].heartbeat, at);
        p->peers[i].state = -1;
    }
}

static int64_t wait(participant_t *p)
{
    attend(p);
    if (p->life.state == LIFE_ACTIVE) {
        begin(p);
        return p->start_ns + p->table->phase_ns + p->slot * p->table->h_ns;
    }
    if (p->now_ns >= p->beat_ns) {
        send_heartbeat(p);
        send_previews(p);
        p->beat_ns = p->now_ns + BEAT_NS;
    }
    pass_estop_on(p);
    return p->now_ns + IDLE_NS;
}

/* ---- in the run ---- */

/* Silence of a message or a peer stops the node. */
static void watch(participant_t *p)
{
    const int64_t t = p->slot * p->table->h_ns, first = p->first_slot * p->table->h_ns;
    for (int32_t i = 0; i < p->table->n_neighbours; i++) p->life.now |= peer_check(p->peers + i, p->now_ns);
    for (int32_t i = 0; i < p->table->n_received; i++) {
        const received_t *m = p->table->received + i;
        const int64_t last = p->inputs[i].arrival_ns > first ? p->inputs[i].arrival_ns : first;
        const int64_t silence = t - last;
        if (m->stop_ns > 0 && silence > m->stop_ns) p->life.now |= WHY_STALE;
        if (m->watchdog_ns > 0 && silence > m->watchdog_ns) p->life.now |= WHY_WATCHDOG;
    }
    if (p->alarm_own && !(p->life.reasons & WHY_ESTOP)) p->life.now |= WHY_ESTOP;
}

static void send_outputs(participant_t *p)
{
    for (int32_t i = 0; i < p->table->n_sent; i++) {
        const int32_t every = p->table->sent[i].every;
        if (p->slot % every == 0) send_sample(p, i, p->slot / every);
    }
}

/* One slot, at phase + slot * h: life cycle, law, messages, heartbeat. A late one is done at once. */
static void do_slot(participant_t *p)
{
    const participant_table_t *t = p->table;
    const int64_t late = p->now_ns - (p->start_ns + t->phase_ns + p->slot * t->h_ns);
    p->missed += late >= t->h_ns;
    if (t->overrun_ns > 0 && late > t->overrun_ns) p->life.now |= WHY_OVERRUN;
    if (t->sync_slots > 0 && p->slot % t->sync_slots == 0) send_sync(p);
    watch(p);
    p->stopping |= commands_have(p->life.commands, COMMAND_STOP);
    life_step(&p->life);
    p->step(p->context, p, (double)(p->slot * t->h_ns) * 1e-9, (double)t->h_ns * 1e-9);
    send_outputs(p);
    if (t->heartbeat_slots > 0 && p->slot % t->heartbeat_slots == 0) send_heartbeat(p);
    pass_estop_on(p);
    answer_epoch(p);
    p->slot++;
}

/* The end: torque 0, and a heartbeat with the last state. */
API void participant_end(participant_t *p)
{
    if (p->over) return;
    const int32_t done = p->begun && p->slot >= p->table->slots;
    const int32_t at_once = p->life.state == LIFE_ACTIVE || p->life.state == LIFE_STOPPING;
    if (done && p->life.state == LIFE_ACTIVE) p->life.state = LIFE_FINISHED;
    else if (at_once) p->life.state = LIFE_FAULT, p->life.reasons |= WHY_COMMAND;
    p->life.armed = 0;
    p->life.scale = 0.0;
    for (int32_t i = 0; p->begun && i < p->table->n_sent; i++) {
        const sent_t *m = p->table->sent + i;
        if (m->torques) send_sample(p, i, p->slot > 0 ? (p->slot - 1) / m->every + 1 : 0);
    }
    send_heartbeat(p);
    p->over = 1;
}

API int64_t participant_poll(participant_t *p, int64_t now_ns)
{
    const participant_table_t *t = p->table;
    if (p->over) return -1;
    p->now_ns = now_ns;
    if (!p->begun) return wait(p);
    for (;;) {
        const int64_t deadline = p->start_ns + t->phase_ns + p->slot * t->h_ns;
        if (now_ns < deadline) return deadline;
        const int32_t stopped = p->stopping && p->life.state != LIFE_STOPPING;
        if (p->slot >= t->slots || stopped) {
            participant_end(p);
            return -1;
        }
        do_slot(p);
    }
}

/* ---- its owner ---- */

API void participant_init(participant_t *p, const participant_table_t *table, participant_send_t send,
                          participant_step_t step, void *context)
{
    memset(p, 0, sizeof *p);
    p->table = table;
    p->send = send;
    p->step = step;
    p->context = context;
    p->follows = 1;
    p->alarms = -1;
    p->life.state = LIFE_INACTIVE;
    p->life.ramp_ticks = (int32_t)table->ramp_slots;
    for (int32_t i = 0; i < table->n_received; i++) {
        const received_t *m = table->received + i;
        receiver_t *r = &p->inputs[i].receiver;
        static const int32_t BITS[] = {0, 0, 4, 0, 16, 8}; /* of the counter, by profile */
        r->sequence = -1;
        r->period_ns = m->period_ns;
        r->offset_ns = m->offset_ns;
        r->counter_bits = BITS[m->layout.e2e];
        r->time_bits = m->layout.time >= 0 ? m->layout.header[m->layout.time].length : 0;
        p->inputs[i].newest = p->inputs[i].previewed_ns = -1;
    }
    for (int32_t i = 0; i < table->n_sent; i++)
        memcpy(p->outputs[i].values, table->sent[i].start,
               (size_t)table->sent[i].layout.n_fields * sizeof(double));
    for (int32_t i = 0; i < table->n_neighbours; i++) {
        const neighbour_t *other = table->neighbours + i;
        p->peers[i].state = -1;
        p->peers[i].number = (uint32_t)other->number;
        p->peers[i].required = other->required;
        p->peers[i].takes = other->takes;
        p->peers[i].heartbeat.timeout_ns = other->within_ns;
    }
}

API void participant_command(participant_t *p, int32_t command)
{
    p->life.commands = commands_add(p->life.commands, command);
}

API void participant_begin(participant_t *p, int64_t start_ns)
{
    if (p->begun || p->start_until) return;
    schedule_start(p, start_ns, (int32_t)((start_ns + p->host.date_offset_ns) / 1000 % RUNS) + 1);
    if (start_ns > p->now_ns) send_epoch(p);
}

API void participant_estop(participant_t *p) { p->alarm_own = 1; }

API const double *participant_input(const participant_t *p, int32_t i) { return p->inputs[i].values; }

API double *participant_output(participant_t *p, int32_t i) { return p->outputs[i].values; }

API double participant_scale(const participant_t *p) { return p->life.scale; }

API int32_t participant_size(void) { return (int32_t)sizeof(participant_t); }

API participant_host_t *participant_host(participant_t *p) { return &p->host; }

/* ---- Zenoh ---- */

API const char *participant_subscription(const participant_t *p, int32_t i, int32_t *bus, uint32_t *id)
{
    const participant_table_t *t = p->table;
    if (i < t->n_received) {
        *bus = t->received[i].bus, *id = t->received[i].layout.id;
        return t->received[i].key ? t->received[i].key : "";
    }
    i -= t->n_received;
    if (i < t->n_neighbours) {
        *bus = t->neighbours[i].bus, *id = t->neighbours[i].heartbeat.id;
        return t->neighbours[i].key ? t->neighbours[i].key : "";
    }
    i -= t->n_neighbours;
    if (i >= 3 * t->n_buses) return 0;
    const bus_table_t *b = t->buses + i / 3;
    const message_t *const m[] = {b->nmt, b->estop, b->epoch};
    const char *const keys[] = {b->nmt_key, b->estop_key, b->epoch_key};
    *bus = i / 3;
    *id = m[i % 3] ? m[i % 3]->id : 0;
    return keys[i % 3] ? keys[i % 3] : "";
}

static const char *state_name(int32_t state)
{
    static const char *const NAMES[] = {"unconfigured", "inactive", "active",
                                        "stopping",     "fault",    "finished"};
    return state >= 0 && state <= LIFE_FINISHED ? NAMES[state] : "fault";
}

/* `cosim tell start` needs host, kept, date_ns and running; a node that joins also run and origin_ns. */
static int32_t answer_clock(const participant_t *p, char *text, size_t size)
{
    const int64_t offset = p->host.date_offset_ns;
    char error[32] = "null";
    if (p->host.kept) snprintf(error, sizeof error, "%.9g", p->host.error);
    return snprintf(text, size,
                    "{\"node\": \"%s\", \"host\": \"%s\", \"kept\": %s, \"error\": %s, \"date_ns\": %lld, "
                    "\"running\": %s, \"run\": %d, \"origin_ns\": %lld}",
                    p->table->node, p->host.text, p->host.kept ? "true" : "false", error,
                    (long long)(p->now_ns + offset),
                    p->begun && p->life.state == LIFE_ACTIVE ? "true" : "false", p->run,
                    (long long)(p->start_ns ? p->start_ns + offset : 0));
}

static int32_t answer_state(const participant_t *p, char *text, size_t size)
{
    const participant_table_t *t = p->table;
    int32_t n =
        snprintf(text, size,
                 "{\"node\": \"%s\", \"state\": \"%s\", \"armed\": %s, \"reasons\": \"%s\", \"boots\": %u, "
                 "\"slot\": %lld, \"slots\": %lld, \"t\": %.9g, \"missed\": %lld, \"unheard\": [",
                 t->node, state_name(p->life.state), p->life.armed ? "true" : "false",
                 p->life.reasons ? "stopped" : "", (unsigned)p->boots, (long long)p->slot,
                 (long long)t->slots, (double)(p->slot * t->h_ns) * 1e-9, (long long)p->missed);
    const char *comma = "";
    for (int32_t i = 0; i < t->n_received && n < (int32_t)size; i++) {
        if (!t->received[i].awaited || has_received(p, i)) continue;
        n += snprintf(text + n, size - (size_t)n, "%s\"%s\"", comma, t->received[i].name);
        comma = ", ";
    }
    for (int32_t i = 0; i < t->n_neighbours && n < (int32_t)size; i++) {
        if (!t->neighbours[i].required || is_present(p->peers + i, p->now_ns)) continue;
        n += snprintf(text + n, size - (size_t)n, "%s\"a heartbeat of %s\"", comma, t->neighbours[i].name);
        comma = ", ";
    }
    if (n < (int32_t)size) n += snprintf(text + n, size - (size_t)n, "], \"messages\": {");
    for (int32_t i = 0; i < t->n_received && n < (int32_t)size; i++)
        n += snprintf(text + n, size - (size_t)n, "%s\"%s\": {\"ok\": %lld, \"lost\": %lld}", i ? ", " : "",
                      t->received[i].name, (long long)p->inputs[i].receiver.ok,
                      (long long)p->inputs[i].receiver.lost);
    return n < (int32_t)size ? n + snprintf(text + n, size - (size_t)n, "}}") : n;
}

static int32_t answer_parameters(const participant_t *p, char *text, size_t size)
{
    const participant_table_t *t = p->table;
    int32_t n = snprintf(
        text, size, "{\"node\": \"%s\", \"number\": %d, \"h\": %.9g, \"components\": {}, \"messages\": {",
        t->node, t->number, (double)t->h_ns * 1e-9);
    for (int32_t i = 0; i < t->n_sent && n < (int32_t)size; i++)
        n +=
            snprintf(text + n, size - (size_t)n, "%s\"%s\": {\"bytes\": %d, \"period\": %.9g}", i ? ", " : "",
                     t->sent[i].name, t->sent[i].layout.length, (double)(t->sent[i].every * t->h_ns) * 1e-9);
    return n < (int32_t)size ? n + snprintf(text + n, size - (size_t)n, "}}") : n;
}

API int32_t participant_answer(const participant_t *p, const char *what, char *text, int32_t size)
{
    if (!strcmp(what, "clock")) return answer_clock(p, text, (size_t)size);
    if (!strcmp(what, "parameters")) return answer_parameters(p, text, (size_t)size);
    return answer_state(p, text, (size_t)size);
}
