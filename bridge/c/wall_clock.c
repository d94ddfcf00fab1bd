/* wall_clock.c: slots on the wall clock; see wall_clock.h. */
#include "wall_clock.h"

#include "shutdown.h"
#include "idle.h"
#include "slot.h"
#include "start.h"

enum {
    SETTLE_NS = 500000000 /* peers that received the same START run by then */,
    HEARD_NS = 2000000 /* before t = 0: the last positions from before the start */
};

/* A restarted node, whose start time has passed, begins at a later slot in which all its components are
 * due. They are initialized for it with the time of the run. Nonzero: the initialization failed. */
static int32_t begin(node_t *n, int32_t joins)
{
    const int64_t now = pace_now() - n->start_ns - n->phase_ns;
    if (joins) {
        int64_t align = n->first > 0 ? n->first : 1; /* `first` comes in as what slots are a multiple of */
        n->slot = ((now + n->lead_ns) / n->h_ns / align + 2) * align;
        if (n->joined && n->slot < n->slots && n->joined(n->slot)) return 1;
    } else {
        n->slot = 0;
    }
    n->first = n->slot;
    for (int32_t i = 0; i < n->n_inlets; i++) n->inlets[i].heard_ns = n->slot * n->h_ns;
    for (int32_t i = 0; i < n->n_peers; i++) {
        watchdog_reset(&n->peers[i].heartbeat, n->slot * n->h_ns + n->h_ns);
        n->peers[i].state = -1;
    }
    watchdog_reset(&n->sync_watchdog, n->slot * n->h_ns);
    n->epoch.due_ns = pace_now() + SETTLE_NS;
    node_enable(n, n->slot * n->h_ns);
    return 0;
}

/* A late slot is done as if it had been in time; one later than it may be is a fault. */
static int32_t late_slot(node_t *n, int64_t late, uint32_t *flags)
{
    histogram_add(&n->late, late);
    if (late < n->h_ns) return 0;
    n->missed++;
    *flags |= ROW_BURST;
    if (n->overrun_ns > 0 && late > n->overrun_ns) n->life.now |= WHY_OVERRUN;
    return 1;
}

/* Where real drives are meant, the last slot has no torque any more. */
static void prepare_end(node_t *n)
{
    if (n->simulated || n->ending || n->slot < n->slots - n->life.ramp_ticks) return;
    for (int32_t i = 0; i < n->n_outlets; i++)
        if (n->outlets[i].guard && n->life.state == LIFE_ACTIVE) n->ending = 1;
    if (n->ending) n->life.commands = commands_add(n->life.commands, COMMAND_STOP);
}

API int32_t node_live(node_t *n)
{
    const int32_t waited = node_wait(n);
    if (waited != LIVE_FINISHED) return waited;
    const int32_t joins = pace_now() - n->start_ns - n->phase_ns > 0;
    const int32_t drives = n->n_commanded > 0 || n->n_motors > 0;
    if (drives) node_stand_by(n, n->start_ns - HEARD_NS, 1);
    if (begin(n, joins)) return LIVE_NOT_JOINED;
    if (drives) node_stand_by(n, n->start_ns + n->phase_ns + n->slot * n->h_ns, 0);
    n->host_due_ns = n->slot * n->h_ns; /* from here on by the clock of the run */
    int64_t woke = pace_now();
    while (n->slot < n->slots) {
        const int64_t deadline = n->start_ns + n->phase_ns + n->slot * n->h_ns;
        uint32_t flags = 0;
        if (woke < deadline) woke = node_idle(n, deadline);
        if (*(volatile int32_t *)&n->quit) break;
        const int32_t missed = late_slot(n, woke - deadline, &flags);
        prepare_end(n);
        const int32_t result =
            node_slot(n, (missed ? deadline : woke) - n->start_ns, woke - n->start_ns, flags);
        if (result) {
            node_ramp_down(n);
            return result;
        }
        woke = n->done_ns + n->start_ns;
        if (n->stopping && n->life.state != LIFE_STOPPING) break;
    }
    return node_end(n);
}
