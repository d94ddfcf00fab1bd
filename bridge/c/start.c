/* start.c: a node before its first slot, on the wall clock: presence of peers, START and ARM. */
#include "start.h"

#include "bringup.h"
#include "emulated.h"
#include "dispatch.h"
#include "outlet.h"
#include "idle.h"
#include "run_epoch.h"
#include "service.h"

enum { IDLE_NS = 5000000, BEAT_NS = 20000000, OBEY_NS = 100000000, REFUSE_NS = 20000000 };
/* ARM waits so long for a peer that is late, on a machine that stood still. */
#define ARM_NS INT64_C(2000000000)

/* The interval in which a received START may be obeyed, and the time until which ARM may; until, arm_until
 * 0: there is none. */
typedef struct {
    int64_t from, until, arm_until;
} pending_t;

static int32_t peer_present(const peer_t *peer, int64_t now)
{
    const int32_t well = peer->state == LIFE_INACTIVE || peer->state == LIFE_ACTIVE;
    return well && now - peer->heartbeat.last_ns <= peer->heartbeat.timeout_ns;
}

static int32_t has_received(const reception_t *r)
{
    return r->previewed_ns >= 0 || r->newest >= 0 || r->of_fault || !tells_life(r->message);
}

API int32_t node_unheard(const node_t *n, int32_t i)
{
    return n->receptions[i].awaited && !has_received(n->receptions + i);
}

API int32_t node_absent(const node_t *n, int32_t i, int64_t now)
{
    return n->peers[i].required && !peer_present(n->peers + i, now);
}

static int32_t too_far_apart(const apart_t *x)
{
    for (int32_t k = 0; k < x->count; k++) {
        const double d = x->a->values[x->first_a + k] - x->b->values[x->first_b + k];
        if (!(d <= x->within && d >= -x->within)) return 1;
    }
    return 0;
}

/* WHY_ bits of what is in the way of a start. */
static uint32_t missing_bits(const node_t *n, int64_t now)
{
    uint32_t why = 0;
    for (int32_t i = 0; i < n->n_peers; i++)
        if (node_absent(n, i, now)) why |= WHY_PEER;
    for (int32_t i = 0; i < n->n_receptions; i++)
        if (node_unheard(n, i)) why |= WHY_STALE;
    for (int32_t i = 0; i < n->n_inlets; i++) {
        const inlet_t *in = n->inlets + i;
        if (in->drive && in->drive->watchdog.timeout_ns <= 0) why |= WHY_WATCHDOG;
    }
    for (int32_t i = 0; i < n->n_aparts; i++) {
        const apart_t *x = n->aparts + i;
        if (!has_received(x->a) || !has_received(x->b)) why |= WHY_STALE;
        else if (too_far_apart(x)) why |= WHY_APART;
    }
    return why;
}

/* One step of the life cycle with a command, and with what is in its way. */
static void command(node_t *n, int32_t what, uint32_t why)
{
    n->life.commands = (uint32_t)what;
    n->life.now |= why;
    life_step(&n->life);
    if (!n->life.refused) return;
    n->refused = n->life.refused | n->life.reasons;
    n->refusals++;
}

/* Nothing is missing for a run that is over: whoever joins it then has nothing to do. */
static int32_t run_is_over(const node_t *n, int64_t now)
{
    return n->start_ns != 0 && now - n->start_ns >= n->slots * n->h_ns;
}

/* START waits for its time. A received START does not change one that is already pending. */
static void schedule_start(node_t *n, pending_t *start, int64_t start_ns, int64_t now)
{
    n->start_ns = start_ns;
    start->from = start_ns - OBEY_NS;
    start->until = start_ns > now ? start_ns - REFUSE_NS : now + n->patience_ns;
}

/* ARM, as soon as nothing is in its way. */
static void arm_if_free(node_t *n, pending_t *start, int64_t now)
{
    if (!start->arm_until) return;
    const uint32_t why = missing_bits(n, now);
    if (why && now < start->arm_until) return;
    start->arm_until = 0;
    command(n, COMMAND_ARM, why);
}

static void schedule_arm(node_t *n, pending_t *start, int64_t now)
{
    start->arm_until = now + (n->patience_ns < ARM_NS ? n->patience_ns : ARM_NS);
    arm_if_free(n, start, now);
}

/* Commands in their order; a STOP or an emergency stop has cancelled others. */
static void follow(node_t *n, pending_t *start, uint32_t commands, int64_t start_ns, int64_t now)
{
    for (; commands; commands >>= 3) {
        const int32_t what = (int32_t)(commands & 7);
        if (what == COMMAND_START) schedule_start(n, start, start_ns, now);
        else if (what == COMMAND_ARM) schedule_arm(n, start, now);
        else command(n, what, 0);
        if (what == COMMAND_RESET) start->arm_until = 0;
    }
}

/* Commands of the process's owner: a START is also sent to the other nodes, which may wait for it. */
static void follow_told(node_t *n, pending_t *start, uint32_t commands, int64_t now)
{
    follow(n, start, commands, n->asked_ns, now);
    if (!commands_have(commands, COMMAND_START)) return;
    n->epoch.run = node_run_of(n, n->start_ns, 1);
    if (n->start_ns > now) node_epoch(n);
}

static void follow_heard(node_t *n, pending_t *start, uint32_t commands, int64_t now)
{
    const int32_t waits = start->until != 0;
    follow(n, start, commands, waits ? n->start_ns : n->nmt_ns, now);
    if (!waits && start->until) n->epoch.run = node_run_of(n, n->start_ns, 0);
}

/* An active run is joined as by a START whose time has passed; with real drives after ARM. */
static void join(node_t *n, pending_t *start, int64_t now)
{
    epoch_t *e = &n->epoch;
    const int32_t may = e->follows && n->life.state == LIFE_INACTIVE && (n->simulated || n->life.armed);
    if (e->running && may && !start->until) {
        schedule_start(n, start, e->origin_ns, now);
        e->run = e->told;
    }
    e->running = 0;
}

/* START, when it is time: what has come until then is what the first slot holds. */
static void start_if_due(node_t *n, pending_t *start, int64_t now)
{
    if (!start->until) return;
    if (n->simulated && n->n_commanded > 0 && !n->life.armed && !missing_bits(n, now))
        command(n, COMMAND_ARM, 0);
    if (now < start->from) return;
    const uint32_t why =
        run_is_over(n, now) ? 0 : missing_bits(n, now) | (bringup_ready(n, now) ? 0 : WHY_DRIVE);
    if ((why || start->arm_until) && now < start->until) return;
    if (why & WHY_DRIVE) bringup_keep_lacks(n, now);
    if (n->simulated && !n->life.armed && !why) command(n, COMMAND_ARM, 0);
    command(n, COMMAND_START, why);
    start->until = 0;
}

/* What has been commanded, on the bus or by the process's owner. */
static void obey(node_t *n, pending_t *start, int64_t now)
{
    const uint32_t heard = n->life.commands;
    const uint32_t told = __atomic_exchange_n(&n->told, 0, __ATOMIC_ACQ_REL);
    const int32_t stop = commands_have(heard, COMMAND_STOP) || commands_have(told, COMMAND_STOP);
    n->life.commands = 0;
    n->life.now &= ~(uint32_t)WHY_NOT_YET;
    if (stop || (n->life.now & WHY_ESTOP && (heard || told))) {
        start->until = start->arm_until = 0;
        n->epoch.follows &= !stop;
        command(n, stop ? COMMAND_STOP : COMMAND_START, 0);
    } else {
        follow_heard(n, start, heard, now);
        follow_told(n, start, told, now);
        join(n, start, now);
    }
    life_step(&n->life);
    arm_if_free(n, start, now);
    start_if_due(n, start, now);
    /* t = 0 is known while a START waits, and when it was obeyed; not when it was refused or cancelled */
    if (n->life.state != LIFE_ACTIVE && !start->until) n->start_ns = 0;
}

/* Once every IDLE_NS: drives are brought up and fed, and hear the services that they need. */
static void attend_drives(node_t *n, int64_t now)
{
    emulated_attend(n, now);
    for (int32_t i = 0; i < n->n_outlets; i++)
        if (n->outlets[i].motor) outlet_tell(n->outlets + i, now - n->start_ns);
    emulated_flush(n, now);
    bringup_step(n, now, 1);
    node_host(n, now);
    node_host_sync_early(n, now);
}

/* Waits until `wake_ns` and returns the time at which the node continues. If the machine stood still
 * meanwhile, the drives are excused for that time. */
static int64_t rest_until(node_t *n, int64_t next, int64_t wake_ns)
{
    node_idle(n, wake_ns);
    const int64_t now = pace_now();
    if (now <= next + IDLE_NS) return next;
    bringup_excuse(n, now - next);
    return now;
}

void node_stand_by(node_t *n, int64_t until_ns, int32_t hears)
{
    int64_t next = pace_now();
    while (next < until_ns && !*(volatile int32_t *)&n->quit) {
        if (hears) {
            const int64_t t = pace_now() - n->start_ns;
            node_hear(n, t < 0 ? t : -1);
            bringup_watch(n, next);
        }
        attend_drives(n, next);
        next += IDLE_NS;
        next = rest_until(n, next, next < until_ns ? next : until_ns);
    }
}

int32_t node_wait(node_t *n)
{
    pending_t start = {0, 0, 0};
    int64_t next = pace_now(), beat = 0;
    n->life.state = LIFE_INACTIVE;
    n->alarms = -1;
    emulated_begin(n, next);
    for (;;) {
        if (*(volatile int32_t *)&n->quit) {
            if (n->life.armed) bringup_rest(n, next);
            return LIVE_NEVER_STARTED;
        }
        n->now_ns = 0;
        node_hear(n, n->start_ns ? pace_now() - n->start_ns : INT64_MAX);
        if (n->alarm == ALARM_RAISED) n->life.now |= WHY_ESTOP, n->alarm = ALARM_OURS;
        bringup_watch(n, next);
        obey(n, &start, next);
        if (n->life.state == LIFE_ACTIVE) return LIVE_FINISHED;
        if (next >= beat) {
            node_heartbeat(n, 0);
            node_preview(n, 0);
            beat = next + BEAT_NS;
        }
        attend_drives(n, next);
        node_alarm(n, next);
        next += IDLE_NS;
        next = rest_until(n, next, next);
    }
}
