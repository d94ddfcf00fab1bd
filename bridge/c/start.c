/* start.c: a node before its first slot, on the wall clock: who is there, and may it start? */
#include "node.h"

enum { IDLE_NS = 5000000, BEAT_NS = 20000000, OBEY_NS = 100000000, REFUSE_NS = 20000000,
       PATIENCE_NS = 1000000000 };

/* A START that has come: when, and until when it may be obeyed; 0: none. */
typedef struct { int64_t from, until; } pending_t;

static int32_t there(const peer_t *peer, int64_t now)
{
    const int32_t well = peer->state == LIFE_INACTIVE || peer->state == LIFE_ACTIVE;
    return well && now - peer->heartbeat.last_ns <= peer->heartbeat.timeout_ns;
}

static int32_t heard(const reception_t *r)
{
    return r->previewed || r->newest >= 0 || !tells_life(r->message);
}

static int32_t apart(const apart_t *x)
{
    for (int32_t k = 0; k < x->count; k++) {
        const double d = x->a->values[x->first_a + k] - x->b->values[x->first_b + k];
        if (!(d <= x->within && d >= -x->within)) return 1;
    }
    return 0;
}

/* WHY_ bits of what is in the way of a start. */
static uint32_t missing(const node_t *n, int64_t now)
{
    uint32_t why = 0;
    for (int32_t i = 0; i < n->n_peers; i++)
        if (n->peers[i].required && !there(n->peers + i, now)) why |= WHY_PEER;
    for (int32_t i = 0; i < n->n_inlets; i++) {
        const inlet_t *in = n->inlets + i;
        if (in->stop_ns > 0 && !heard(in->reception)) why |= WHY_STALE;
        if (in->drive && in->drive->watchdog.timeout_ns <= 0) why |= WHY_WATCHDOG;
    }
    for (int32_t i = 0; i < n->n_aparts; i++) {
        const apart_t *x = n->aparts + i;
        if (!heard(x->a) || !heard(x->b)) why |= WHY_STALE;
        else if (apart(x)) why |= WHY_APART;
    }
    return why;
}

/* One step of the life cycle with a command, and with what is in its way. */
static void command(node_t *n, int32_t what, uint32_t why)
{
    n->life.command = what;
    n->life.now |= why;
    life_step(&n->life);
    if (!n->life.refused) return;
    n->refused = n->life.refused | n->life.reasons;
    n->refusals++;
    if (what == COMMAND_START) n->start_ns = 0;
}

/* What has been commanded, by the process's owner or on the bus. START waits for its time. */
static void obey(node_t *n, pending_t *start, int64_t now)
{
    const int32_t given = __atomic_exchange_n(&n->command, COMMAND_NONE, __ATOMIC_ACQ_REL);
    const int32_t what = given != COMMAND_NONE ? given : n->life.command;
    n->life.command = COMMAND_NONE;
    n->life.now &= ~(uint32_t)WHY_NOT_YET;
    if (what == COMMAND_START) {
        start->from = n->start_ns - OBEY_NS;
        start->until = n->start_ns > now ? n->start_ns - REFUSE_NS : now + PATIENCE_NS;
    } else if (what != COMMAND_NONE) {
        if (what == COMMAND_STOP) start->until = 0;
        command(n, what, what == COMMAND_ARM ? missing(n, now) : 0);
    }
    life_step(&n->life);
    if (!start->until || now < start->from) return;
    const uint32_t why = missing(n, now);
    if (why && now < start->until) return;
    if (n->simulated && !n->life.armed && !why) command(n, COMMAND_ARM, 0);
    command(n, COMMAND_START, why);
    start->until = 0;
}

int32_t node_wait(node_t *n)
{
    pending_t start = {0, 0};
    int64_t next = pace_now(), beat = 0;
    n->life.state = LIFE_INACTIVE;
    n->alarms = -1;
    for (;;) {
        if (*(volatile int32_t *)&n->quit) return LIVE_NEVER_STARTED;
        n->now_ns = 0;
        node_hear(n, n->start_ns ? pace_now() - n->start_ns : INT64_MAX);
        if (n->alarm == ALARM_RAISED) n->life.now |= WHY_ESTOP, n->alarm = ALARM_OURS;
        obey(n, &start, next);
        if (n->life.state == LIFE_ACTIVE) return LIVE_FINISHED;
        if (next >= beat) {
            node_heartbeat(n, 0);
            node_preview(n, 0);
            beat = next + BEAT_NS;
        }
        node_alarm(n, next);
        next += IDLE_NS;
        node_rest(n, next);
        if (pace_now() > next + IDLE_NS) next = pace_now();
    }
}
