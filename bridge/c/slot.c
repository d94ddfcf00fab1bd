/* slot.c: one slot of a node: life cycle, plan, journal; see slot.h. */
#include "slot.h"

#include <string.h>

#include "bringup.h"
#include "emulated.h"
#include "dispatch.h"
#include "run_epoch.h"
#include "service.h"

/* At its own end a node ignores the end of its peers. */
static void watch(node_t *n)
{
    for (int32_t i = 0; i < n->n_peers && !n->ending; i++) n->life.now |= peer_check(n->peers + i, n->now_ns);
    if (watchdog_check(&n->sync_watchdog, n->now_ns)) n->life.now |= WHY_SYNC;
    if (n->alarm == ALARM_RAISED) n->life.now |= WHY_ESTOP, n->alarm = ALARM_OURS;
    for (int32_t i = 0; i < n->n_outlets; i++)
        if (n->buses[n->outlets[i].bus].state >= BUS_OFF) n->life.now |= WHY_BUS;
}

/* Emulated drives follow their node: RESET clears them, START enables them, FAULT stops
 * them, and the end of a STOP disables them. */
static void drives(node_t *n, int32_t before)
{
    const int32_t state = n->life.state;
    if (state == before) return;
    /* FAULT -> RESET, ARM, START in one slot: cleared, then enabled */
    for (int32_t i = 0; i < n->n_inlets; i++) {
        drive_t *d = n->inlets[i].drive;
        if (!d || n->inlets[i].motor) continue;
        if (before == LIFE_FAULT) drive_request(d, DRIVE_CLEAR, n->now_ns);
        if (state == LIFE_ACTIVE) drive_request(d, DRIVE_ENABLE, n->now_ns);
        else if (state == LIFE_FAULT && d->state == DRIVE_ENABLED) d->state = DRIVE_FAULT;
        else if (state == LIFE_INACTIVE && d->state == DRIVE_ENABLED)
            drive_request(d, DRIVE_DISABLE, n->now_ns);
    }
}

void node_tell(node_t *n, int32_t command)
{
    uint32_t before = __atomic_load_n(&n->told, __ATOMIC_ACQUIRE);
    while (!__atomic_compare_exchange_n(&n->told, &before, commands_add(before, command), 0, __ATOMIC_ACQ_REL,
                                        __ATOMIC_ACQUIRE)) {}
}

/* The commands of this slot: received ones, then local ones. */
static uint32_t take_commands(node_t *n)
{
    uint32_t found = n->life.commands;
    for (uint32_t told = __atomic_exchange_n(&n->told, 0, __ATOMIC_ACQ_REL); told; told >>= 3)
        found = commands_add(found, (int32_t)(told & 7));
    return found;
}

/* A START waits until the drives that this node commands are ready. */
static uint32_t hold_start(node_t *n, uint32_t commands, int64_t now_ns)
{
    uint32_t kept = 0;
    int32_t armed = n->life.armed;
    if (n->n_commanded == 0) return commands;
    if (n->life.state != LIFE_INACTIVE && n->life.state != LIFE_FAULT) n->deferred = 0;
    if (commands_have(commands, COMMAND_STOP) || commands_have(commands, COMMAND_RESET)) n->deferred = 0;
    for (uint32_t left = commands; left; left >>= 3) {
        const int32_t what = (int32_t)(left & 7);
        armed |= what == COMMAND_ARM;
        if (what == COMMAND_START && armed && !bringup_ready(n, now_ns)) n->deferred = 1;
        else kept = commands_add(kept, what);
    }
    if (n->deferred && n->life.armed && bringup_ready(n, now_ns)) {
        n->deferred = 0;
        kept = commands_add(kept, COMMAND_START);
    }
    return kept;
}

static void live(node_t *n, row_t *row, int64_t limit_ns)
{
    const int32_t before = n->life.state;
    if (n->clock == CLOCK_REPLAY) {
        const row_t *r = (const row_t *)(n->replayed + n->replay_row * n->row_size);
        n->life.now = r->now;
        n->life.commands = r->commands;
        bringup_replay(n, r->serving);
    } else {
        watch(n);
        bringup_watch(n, limit_ns + n->start_ns);
        n->life.commands = hold_start(n, take_commands(n), limit_ns + n->start_ns);
        if (commands_have(n->life.commands, COMMAND_STOP)) n->stopping = 1;
    }
    if (row) {
        row->now = n->life.now;
        row->commands = n->life.commands;
        row->serving = bringup_serving(n);
    }
    life_step(&n->life);
    drives(n, before);
}

static void write_row(node_t *n, row_t *row, int64_t limit_ns, int64_t woke_ns, uint32_t flags)
{
    char *base = (char *)row;
    inlet_row_t *in = (inlet_row_t *)(base + n->inlet_offset);
    double *out = (double *)(base + n->outlet_offset);

    row->slot = n->slot;
    row->deadline_ns = n->now_ns + n->phase_ns;
    row->woke_ns = woke_ns;
    row->send_ns = n->send_ns;
    row->done_ns = n->done_ns;
    row->state = n->life.state;
    row->reasons = n->life.reasons;
    row->scale = n->life.scale;
    row->flags = flags;
    row->guard = 0;
    for (int32_t i = 0; i < n->n_inlets; i++) {
        const inlet_t *x = n->inlets + i;
        in[i].held = x->held;
        in[i].newest = x->newest;
        in[i].transit_ns = x->reception->transit_ns;
        in[i].requests = x->motor ? x->motor->power : x->requests;
        in[i].age_ns =
            x->held < 0 ? -1 : limit_ns - x->held * x->reception->period_ns - x->reception->offset_ns;
    }
    for (int32_t i = 0; i < n->n_outlets; i++) {
        const outlet_t *o = n->outlets + i;
        memcpy(out, o->values, (size_t)o->width * sizeof *out);
        out += o->width;
        if (o->guard) row->guard |= o->guard->bits;
    }
    for (int32_t i = 0; i < n->n_insides; i++) row->guard |= n->insides[i].guard->bits;
}

static void housekeeping(node_t *n, int64_t now_ns)
{
    if (n->clock == CLOCK_REPLAY) return;
    if (n->heartbeat_slots > 0 && n->slot % n->heartbeat_slots == 0) node_heartbeat(n, now_ns);
    node_host(n, now_ns);
    node_host_sync(n, now_ns);
    node_alarm(n, now_ns);
    node_epoch_answer(n);
}

int32_t node_slot(node_t *n, int64_t limit_ns, int64_t woke_ns, uint32_t flags)
{
    row_t *row;
    n->now_ns = n->slot * n->h_ns;
    n->send_ns = 0;
    if (n->clock != CLOCK_REPLAY) {
        if (n->sync_slots > 0 && n->slot % n->sync_slots == 0) node_sync(n, limit_ns);
        node_hear(n, limit_ns);
    }
    emulated_step(n, limit_ns + n->start_ns);
    row = journal_next(n->journal);
    live(n, row, limit_ns);
    if (row) row->received_ns = n->clock == CLOCK_WALL ? pace_now() - n->start_ns : limit_ns;
    *n->record = row ? (double *)((char *)row + n->signals_offset) : 0;
    *n->record_row = 0;
    n->result = n->run(n->engine, 1);
    flags |= bringup_step(n, limit_ns + n->start_ns, 0);
    n->done_ns = n->clock == CLOCK_WALL ? pace_now() - n->start_ns : limit_ns;
    if (row) {
        write_row(n, row, limit_ns, woke_ns, flags | (n->result ? ROW_FAILED : 0));
        journal_commit(n->journal);
    }
    housekeeping(n, limit_ns);
    n->slot++;
    if (n->clock == CLOCK_REPLAY) n->replay_row++;
    return n->result;
}

/* The emulated drives of a node: on and enabled, their watchdogs running; its tables at this slot. */
API void node_enable(node_t *n, int64_t now_ns)
{
    for (int64_t i = 0; i < n->n_played; i++)
        *n->played[i].row = (n->slot + n->played[i].period - 1) / n->played[i].period;
    for (int32_t i = 0; i < n->n_inlets; i++) {
        if (!n->inlets[i].drive || n->inlets[i].motor) continue;
        drive_request(n->inlets[i].drive, DRIVE_POWER_ON, now_ns);
        drive_request(n->inlets[i].drive, DRIVE_ENABLE, now_ns);
    }
    if (n->clock != CLOCK_WALL) {
        bringup_assume(n, now_ns);
        emulated_begin(n, now_ns);
    }
    n->begun = 1;
    n->host_due_ns = now_ns;
    n->alarms = -1;
}
