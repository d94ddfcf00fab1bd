/* vendor_cia402.c: a CiA 402 drive in cyclic synchronous torque mode; see vendor.h.
 *
 * Facts: boot-up, NMT, PDO, SYNC, heartbeat and emergency objects of CiA 301; states, control and status
 * word of CiA 402-2 as ros-industrial/ros_canopen (canopen_402) and the manuals of several vendors print
 * them. PDOs are mapped as bridge/drives/cia402.py configures them. Assumed: lost heartbeats end in a fault
 * (0x6007 = 1) and in pre-operational (0x1029:1 = 0), and so does NMT when it ends operational under power;
 * quick stop and fault reaction take 20 ms and 5 ms. */
#include "vendor_cia402.h"

enum {
    NOT_READY,
    SWITCH_ON_DISABLED,
    READY_TO_SWITCH_ON,
    SWITCHED_ON,
    OPERATION_ENABLED,
    QUICK_STOP,
    FAULT_REACTION,
    FAULT
};
enum { STOPPED = 4, OPERATIONAL = 5, PRE_OPERATIONAL = 127 };
enum { NMT_START = 1, NMT_STOP = 2, NMT_PRE = 128, NMT_RESET_NODE = 129, NMT_RESET_COMMUNICATION = 130 };
enum { TORQUE_MODE = 10, RPDO_BYTES = 5, QUICK_STOP_NS = 20000000, REACTION_NS = 5000000 };
enum {
    HOT_DEVICE = 0x4210,
    HOT_DRIVE = 0x4310,
    E_LINK = 0x8100,
    E_HEARTBEAT = 0x8130,
    E_SHORT = 0x8210,
    E_LONG = 0x8220
};
enum { RESET = 0x80, VOLTAGE_ENABLED = 0x10, REMOTE = 0x200, FOLLOWS = 0x1000 };

/* ---- emergencies and faults ---- */

/* Error register 0x1001 for the class of a code. */
static uint8_t error_register(uint32_t code)
{
    switch (code >> 12) {
    case 0: return 0;
    case 2: return 0x03; /* current */
    case 3: return 0x05; /* voltage */
    case 4: return 0x09; /* temperature */
    case 8: return 0x11; /* communication */
    default: return 0x01;
    }
}

static void emergency(vendor_t *v, uint32_t code, int64_t t_ns)
{
    uint8_t d[8] = {0};
    d[0] = (uint8_t)code;
    d[1] = (uint8_t)(code >> 8);
    d[2] = error_register(code);
    if (v->network != STOPPED) vendor_queue(v, 0x80u + (uint32_t)v->node, 0, d, 8, t_ns);
}

static void enter(vendor_t *v, int32_t state)
{
    v->state = state;
    v->acts = state == OPERATION_ENABLED && v->mode == TORQUE_MODE && v->network == OPERATIONAL;
}

static void trip(vendor_t *v, uint32_t code, int64_t t_ns)
{
    v->error = code;
    emergency(v, code, t_ns);
    if (v->state == FAULT_REACTION || v->state == FAULT) return;
    v->trips++;
    v->ramp_ns = t_ns + REACTION_NS;
    enter(v, FAULT_REACTION);
}

/* ---- power and NMT ---- */

static void boot(vendor_t *v, int64_t t_ns)
{
    static const uint8_t up[1] = {0};
    v->network = PRE_OPERATIONAL;
    v->word = v->before = 0;
    v->mode = TORQUE_MODE;
    v->input = 0; /* 1: heartbeats of the host are awaited, after the first one */
    v->ramp_ns = INT64_MAX;
    enter(v, SWITCH_ON_DISABLED);
    vendor_queue(v, 0x700u + (uint32_t)v->node, 0, up, 1, t_ns);
}

static void bring_up(vendor_t *v)
{
    v->network = OPERATIONAL;
    v->word = v->before = 0x0F;
    v->input = v->host != 0;
    enter(v, OPERATION_ENABLED);
}

static int32_t under_power(const vendor_t *v) { return v->state >= SWITCHED_ON && v->state <= QUICK_STOP; }

static void network(vendor_t *v, int32_t state, int64_t t_ns)
{
    const int32_t left = v->network == OPERATIONAL && state != OPERATIONAL;
    if (left && under_power(v)) trip(v, E_LINK, t_ns);
    v->network = state;
    enter(v, v->state);
    if (state != OPERATIONAL) memset(v->owed, 0, sizeof v->owed);
}

static void nmt(vendor_t *v, const frame_t *f, int64_t t_ns)
{
    if (f->length != 2 || (f->data[1] != 0 && f->data[1] != v->node)) return;
    switch (f->data[0]) {
    case NMT_START: network(v, OPERATIONAL, t_ns); break;
    case NMT_STOP: network(v, STOPPED, t_ns); break;
    case NMT_PRE: network(v, PRE_OPERATIONAL, t_ns); break;
    case NMT_RESET_NODE:
    case NMT_RESET_COMMUNICATION: vendor_reboot(v, t_ns); break;
    default: break;
    }
}

/* ---- the state machine: at most one transition a cycle, by the control word of then ---- */

static int32_t commanded(const vendor_t *v)
{
    const uint32_t c = v->word;
    if (c & RESET) /* no other command has this bit */
        return v->state == FAULT && !(v->before & RESET) && !v->hot ? SWITCH_ON_DISABLED : v->state;
    const int32_t no_voltage = !(c & 2), quick = (c & 6) == 2, shut = (c & 7) == 6;
    const int32_t on = (c & 7) == 7, go = (c & 15) == 15;
    switch (v->state) {
    case SWITCH_ON_DISABLED: return shut ? READY_TO_SWITCH_ON : v->state;
    case READY_TO_SWITCH_ON: return no_voltage || quick ? SWITCH_ON_DISABLED : on ? SWITCHED_ON : v->state;
    case SWITCHED_ON:
        if (no_voltage || quick) return SWITCH_ON_DISABLED;
        return shut ? READY_TO_SWITCH_ON : go ? OPERATION_ENABLED : v->state;
    case OPERATION_ENABLED:
        if (no_voltage || v->drops) return SWITCH_ON_DISABLED;
        if (quick) return QUICK_STOP;
        return shut ? READY_TO_SWITCH_ON : go ? v->state : SWITCHED_ON;
    case QUICK_STOP: return no_voltage ? SWITCH_ON_DISABLED : v->state;
    default: return v->state;
    }
}

static int64_t next_cycle(const vendor_t *v, int64_t t_ns)
{
    if (v->cycle_ns <= 0) return t_ns + 1;
    return v->booted_ns + ((t_ns - v->booted_ns) / v->cycle_ns + 1) * v->cycle_ns;
}

static void cycle(vendor_t *v, int64_t t_ns)
{
    const int32_t was = v->state, next = commanded(v);
    v->before = v->word;
    v->due_ns = next != was ? next_cycle(v, t_ns) : INT64_MAX;
    if (next == was) return;
    if (was == FAULT) {
        v->error = 0;
        emergency(v, 0, t_ns);
    }
    if (next == QUICK_STOP) v->ramp_ns = t_ns + QUICK_STOP_NS;
    enter(v, next);
}

/* Standstill: quick stop and fault reaction are over. */
static void stand_still(vendor_t *v)
{
    v->ramp_ns = INT64_MAX;
    if (v->state == QUICK_STOP) enter(v, SWITCH_ON_DISABLED);
    if (v->state == FAULT_REACTION) enter(v, FAULT);
}

/* ---- what is due ---- */

static int64_t silent_at(const vendor_t *v)
{
    return v->input && v->timeout_ns > 0 ? v->fed_ns + v->timeout_ns + 1 : INT64_MAX;
}

static int64_t due(const vendor_t *v)
{
    int64_t next = silent_at(v);
    if (v->ramp_ns < next) next = v->ramp_ns;
    return v->due_ns < next ? v->due_ns : next;
}

static void event(vendor_t *v, int64_t t_ns)
{
    if (silent_at(v) <= t_ns) {
        v->input = 0; /* until it hears the host again */
        trip(v, E_HEARTBEAT, t_ns);
        if (v->network == OPERATIONAL) network(v, PRE_OPERATIONAL, t_ns);
    } else if (v->ramp_ns <= t_ns) {
        stand_still(v);
    } else {
        cycle(v, t_ns);
    }
}

/* ---- what it hears ---- */

static void command(vendor_t *v, const frame_t *f, int64_t t_ns)
{
    if (v->network != OPERATIONAL) return;
    if (f->length != RPDO_BYTES) emergency(v, f->length < RPDO_BYTES ? E_SHORT : E_LONG, t_ns);
    if (f->length < RPDO_BYTES) return;
    const int32_t torque = (int16_t)(f->data[3] | f->data[4] << 8);
    v->word = (uint32_t)f->data[0] | (uint32_t)f->data[1] << 8;
    v->mode = (int8_t)f->data[2];
    v->tau = torque * 1e-3 * v->rated;
    if (torque && v->state != OPERATION_ENABLED) v->refused++;
    enter(v, v->state); /* in another mode this torque does not act */
    if (v->due_ns == INT64_MAX) v->due_ns = next_cycle(v, t_ns);
}

static void host_heard(vendor_t *v, int64_t t_ns)
{
    v->input = 1;
    v->fed_ns = t_ns;
}

static void sync(vendor_t *v)
{
    if (v->network != OPERATIONAL) return;
    for (int32_t part = 0; part < VENDOR_PARTS; part++) v->owed[part]++;
}

static int32_t take(vendor_t *v, const frame_t *f, int64_t t_ns)
{
    const int32_t mine = f->id == 0x200u + (uint32_t)v->node, all = f->id == 0 || f->id == 0x80;
    const int32_t host = v->host && f->id == 0x700u + (uint32_t)v->host;
    if (!mine && !all && !host) return 0;
    if (!vendor_plain(f) || f->flags & FRAME_FD) v->unheard++;
    else if (mine) command(v, f, t_ns);
    else if (host) host_heard(v, t_ns);
    else if (f->id == 0) nmt(v, f, t_ns);
    else sync(v);
    return !mine || f->length != RPDO_BYTES || (f->data[0] & 15) != 15;
}

/* ---- what it says ---- */

static uint32_t status_word(const vendor_t *v)
{
    static const uint32_t of[] = {0x00, 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08};
    uint32_t word = of[v->state] | VOLTAGE_ENABLED;
    if (v->network == OPERATIONAL) word |= REMOTE;
    return v->acts ? word | FOLLOWS : word;
}

static void mark(const vendor_t *v, int32_t part, frame_t *f)
{
    if (part != 0) return;
    f->data[0] = (uint8_t)status_word(v);
    f->data[1] = (uint8_t)(status_word(v) >> 8);
}

static void beat(vendor_t *v, int64_t t_ns)
{
    const uint8_t state[1] = {(uint8_t)v->network};
    vendor_queue(v, 0x700u + (uint32_t)v->node, 0, state, 1, t_ns);
}

const vendor_kind_t vendor_cia402 = {
    boot, bring_up, take, due, event, mark, beat, trip, {HOT_DEVICE, HOT_DRIVE}};
