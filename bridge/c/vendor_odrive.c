/* vendor_odrive.c: an ODrive axis over CANSimple; see vendor.h.
 *
 * Facts: commands and layouts from can_simple_messages.hpp of odriverobotics/ros_odrive; values of errors,
 * states and procedure results from its odrive_enums.h (firmware 0.6); that a request is BUSY until it has
 * its result from odrive_can_node.cpp there; that set-points feed the watchdog from
 * examples/can_simple.py of ODriveResources. Assumed: a request for closed loop with active errors ends in
 * DISARMED, the watchdog runs in closed loop only, a changed heartbeat waits for its time. */
#include "vendor_odrive.h"

enum { IDLE = 1, CLOSED_LOOP = 8 };
enum { SUCCESS = 0, BUSY = 1, CANCELLED = 2, DISARMED = 3, INVALID_STATE = 13 };
enum { TORQUE_CONTROL = 1, POSITION_CONTROL = 3, PASSTHROUGH = 1 };
enum {
    GET_VERSION = 0x00,
    HEARTBEAT = 0x01,
    ESTOP = 0x02,
    GET_ERROR = 0x03,
    SET_AXIS_STATE = 0x07,
    GET_ESTIMATES = 0x09,
    SET_MODE = 0x0B,
    SET_POS = 0x0C,
    SET_VEL = 0x0D,
    SET_TORQUE = 0x0E,
    GET_TEMPERATURE = 0x15,
    REBOOT = 0x16,
    CLEAR_ERRORS = 0x18,
    GET_TORQUES = 0x1C
};
#define E_INVERTER_HOT 0x4000u
#define E_MOTOR_HOT 0x2000u
#define E_WATCHDOG 0x1000000u
#define E_ESTOP 0x2000000u

static void boot(vendor_t *v, int64_t t_ns)
{
    (void)t_ns;
    v->state = IDLE;
    v->mode = POSITION_CONTROL;
    v->input = PASSTHROUGH;
}

static void bring_up(vendor_t *v)
{
    v->state = CLOSED_LOOP;
    v->mode = TORQUE_CONTROL;
}

static int32_t follows(const vendor_t *v)
{
    return v->state == CLOSED_LOOP && v->mode == TORQUE_CONTROL && v->input == PASSTHROUGH;
}

static void leave(vendor_t *v, int32_t result)
{
    v->state = IDLE;
    v->result = result;
    v->acts = 0;
    v->due_ns = INT64_MAX;
}

static void trip(vendor_t *v, uint32_t code, int64_t t_ns)
{
    (void)t_ns;
    v->error |= code;
    v->before = code; /* disarm reason */
    v->trips++;
    leave(v, DISARMED);
}

/* ---- what is due: closed loop at its next cycle, the watchdog ---- */

static int64_t expires(const vendor_t *v)
{
    return v->state == CLOSED_LOOP && v->timeout_ns > 0 ? v->fed_ns + v->timeout_ns + 1 : INT64_MAX;
}

static int64_t due(const vendor_t *v) { return v->due_ns < expires(v) ? v->due_ns : expires(v); }

static void event(vendor_t *v, int64_t t_ns)
{
    if (expires(v) <= t_ns) {
        trip(v, E_WATCHDOG, t_ns);
    } else if (v->state == CLOSED_LOOP) {
        leave(v, CANCELLED); /* it drops */
    } else {
        v->state = CLOSED_LOOP;
        v->result = SUCCESS;
        v->fed_ns = t_ns;
        v->tau = 0.0;
        v->acts = follows(v);
        v->due_ns = v->drops ? t_ns + v->cycle_ns : INT64_MAX;
    }
}

/* ---- requests ---- */

static void axis_state(vendor_t *v, uint32_t wanted, int64_t t_ns)
{
    if (wanted == IDLE) {
        leave(v, v->state == CLOSED_LOOP ? CANCELLED : SUCCESS);
    } else if (wanted != CLOSED_LOOP) {
        leave(v, INVALID_STATE);
    } else if (v->error) {
        leave(v, DISARMED);
    } else if (v->state != CLOSED_LOOP) {
        v->result = BUSY;
        v->due_ns = t_ns + v->cycle_ns;
    }
}

static void clear(vendor_t *v)
{
    static const uint32_t hot[] = {0, E_INVERTER_HOT, E_MOTOR_HOT};
    v->error = v->hot == 1 || v->hot == 2 ? hot[v->hot] : 0;
}

static void set_torque(vendor_t *v, const frame_t *f)
{
    const double tau = (double)vendor_float(f->data);
    v->tau = tau - tau == 0.0 ? tau : 0.0;
    if (v->state != CLOSED_LOOP && tau != 0.0) v->refused++;
}

static void set_mode(vendor_t *v, const frame_t *f)
{
    v->mode = (int32_t)vendor_u32(f->data);
    v->input = (int32_t)vendor_u32(f->data + 4);
    v->acts = follows(v);
}

static void set_point(vendor_t *v, int32_t command, const frame_t *f, int64_t t_ns)
{
    v->fed_ns = t_ns;
    if (command == SET_TORQUE) set_torque(v, f);
}

/* ---- what it is asked by remote frames ---- */

static void answer(vendor_t *v, int32_t command, int64_t t_ns)
{
    static const uint8_t version[8] = {2, 4, 4, 58, 0, 6, 9, 0}; /* protocol, hardware, firmware */
    uint8_t d[8] = {0};
    switch (command) {
    case GET_VERSION: memcpy(d, version, sizeof d); break;
    case GET_ERROR: vendor_put32(d, v->error), vendor_put32(d + 4, v->before); break;
    case GET_TEMPERATURE:
        vendor_put_float(d, v->hot == 1 ? 110.0 : 30.0);
        vendor_put_float(d + 4, v->hot == 2 ? 130.0 : 30.0);
        break;
    case GET_ESTIMATES: v->owed[0]++; return;
    case GET_TORQUES: v->owed[1]++; return;
    default: return;
    }
    vendor_queue(v, (uint32_t)(v->node << 5 | command), 0, d, 8, t_ns);
}

/* Bytes that a command must have. */
static int32_t length_of(int32_t command)
{
    switch (command) {
    case SET_MODE:
    case SET_POS:
    case SET_VEL: return 8;
    case SET_AXIS_STATE:
    case SET_TORQUE: return 4;
    default: return 0;
    }
}

static void obey(vendor_t *v, int32_t command, const frame_t *f, int64_t t_ns)
{
    switch (command) {
    case ESTOP: trip(v, E_ESTOP, t_ns); break;
    case SET_AXIS_STATE: axis_state(v, vendor_u32(f->data), t_ns); break;
    case SET_MODE: set_mode(v, f); break;
    case SET_POS:
    case SET_VEL:
    case SET_TORQUE: set_point(v, command, f, t_ns); break;
    case REBOOT: vendor_reboot(v, t_ns); break;
    case CLEAR_ERRORS: clear(v); break;
    default: break;
    }
}

static int32_t take(vendor_t *v, const frame_t *f, int64_t t_ns)
{
    const int32_t command = (int32_t)(f->id & 31);
    if (f->id >> 5 != (uint32_t)v->node) return 0;
    if (f->flags & (FRAME_FD | FRAME_EXTENDED)) v->unheard++;
    else if (f->flags & FRAME_REMOTE) answer(v, command, t_ns);
    else if (f->length < length_of(command)) v->unheard++;
    else obey(v, command, f, t_ns);
    return command != SET_TORQUE;
}

/* ---- what it says ---- */

static void mark(const vendor_t *v, int32_t part, frame_t *f) /* estimates and torques have no state */
{
    (void)v;
    (void)part;
    (void)f;
}

static void beat(vendor_t *v, int64_t t_ns)
{
    uint8_t d[8] = {0};
    vendor_put32(d, v->error);
    d[4] = (uint8_t)v->state;
    d[5] = (uint8_t)v->result;
    vendor_queue(v, (uint32_t)(v->node << 5 | HEARTBEAT), 0, d, 8, t_ns);
}

const vendor_kind_t vendor_odrive = {
    boot, bring_up, take, due, event, mark, beat, trip, {E_INVERTER_HOT, E_MOTOR_HOT}};
