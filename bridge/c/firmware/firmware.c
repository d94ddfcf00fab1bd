/* firmware.c - one node of a deployment on a microcontroller; see firmware.h. */
#include "firmware.h"

#include "bus_wait.h"
#include "hal.h"
#include "slot.h"
#include "wall_clock.h"

enum {
    BOOTS = 4095 /* numbers of lives in heartbeats, from 1 */,
    LEAD_NS = 50000000 /* to the first slot of a life that joins a run */
};

static portable_t core;
/* The lives since power-on: a reset of the processor keeps this memory. */
static uint32_t lives __attribute__((section(".noinit")));

/* --- in place of the parts of a node that know systems ------------------------------------------- */

int32_t bus_receive(bus_t *bus, frame_t *frame)
{
    if (!hal_can_receive((int32_t)bus->number, frame)) return 0;
    bus->received++;
    return 1;
}

int32_t bus_send(bus_t *bus, frame_t *frame)
{
    const int32_t full = hal_can_send((int32_t)bus->number, frame);
    bus->sent += !full, bus->send_failed += full != 0;
    return full;
}

int64_t pace_now(void) { return hal_time_ns(); }

int64_t pace_date(void) { return core.memory.node.epoch.date_ns; }

__attribute__((weak)) void hal_idle(int64_t until_ns) { (void)until_ns; }

/* Torques of all outlets, as they were limited last. */
static void drive(const node_t *n)
{
    for (int32_t i = 0; i < n->n_outlets; i++) {
        const outlet_t *o = n->outlets + i;
        if (o->guard) hal_torque(i, o->values + o->guarded, o->joints);
    }
}

/* A component that has failed is ramped down without slots. */
int64_t pace_wait(int64_t deadline_ns, int64_t spin_ns, const volatile int32_t *stop)
{
    int64_t now;
    (void)spin_ns;
    if (core.memory.node.result) drive(&core.memory.node);
    while ((now = hal_time_ns()) < deadline_ns && !(stop && *stop)) hal_idle(deadline_ns);
    return now;
}

/* Only gateways, which no firmware is, wait so. */
void bus_wait(const bus_t *buses, int32_t n, int64_t deadline_ns)
{
    (void)buses, (void)n;
    pace_wait(deadline_ns, 0, 0);
}

/* --- a life ------------------------------------------------------------------------------------- */

static int32_t run(void *context, int64_t ticks)
{
    const int32_t result = plan_run(context, ticks);
    drive(&core.memory.node);
    return result;
}

/* Components that join a run are at their start already. */
static int32_t joined(int64_t slot)
{
    (void)slot;
    return 0;
}

static int64_t common(int64_t a, int64_t b)
{
    int64_t x = a;
    while (x % b) x += a;
    return x;
}

const char *firmware_begin(int32_t clock)
{
    node_t *n = &core.memory.node;
    portable_reset(&core);
    n->clock = clock, n->run = run, n->joined = joined;
    n->epoch.adopts = n->epoch.follows = clock == CLOCK_WALL;
    n->lead_ns = LEAD_NS;
    if (clock == CLOCK_WALL) n->boots = (++lives + (uint32_t)(hal_time_ns() / 1000000)) % BOOTS + 1;
    n->first = 1;
    for (int32_t i = 0; i < N_OPERATIONS; i++)
        if (node_operations[i].code == PLAN_STEP) n->first = common(n->first, node_operations[i].period);
    core.why = plan_begin(&core);
    if (core.why || clock == CLOCK_WALL) return core.why;
    n->life.state = LIFE_ACTIVE, n->life.armed = 1;
    node_enable(n, 0);
    return NULL;
}

static void let_go(const node_t *n)
{
    static const double none[SAFETY_JOINTS];
    for (int32_t i = 0; i < n->n_outlets; i++)
        if (n->outlets[i].guard) hal_torque(i, none, n->outlets[i].joints);
}

int32_t firmware_live(void)
{
    if (firmware_begin(CLOCK_WALL)) {
        hal_log(core.why);
        return 1;
    }
    const int32_t result = node_live(&core.memory.node);
    let_go(&core.memory.node);
    return result;
}

int32_t firmware_slot(int64_t limit_ns) { return node_slot(&core.memory.node, limit_ns, limit_ns, 0); }
const char *firmware_who(void) { return core.who; }
const char *firmware_why(void) { return core.why; }
void firmware_lived(uint32_t before) { lives = before; }
node_t *firmware_node(void) { return &core.memory.node; }
