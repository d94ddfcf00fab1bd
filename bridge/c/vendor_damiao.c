/* vendor_damiao.c: a Damiao drive in MIT mode; see vendor.h.
 *
 * Facts: register numbers, their types and the unit of TIMEOUT (50 us) from the register table of
 * python-damiao-driver; status codes from DAMIAO_Control_Arduino; frames from enactic/openarm_can; that a
 * drive with can_br 4 answers FD frames by classic ones from openarm_teleop issue 8, that FD frames without
 * bit rate switch are not heard from lerobot issue 3178. Assumed: registers feed no watchdog, only FB
 * leaves a fault, other control modes than MIT do not answer (openarm_can issue 64). */
#include "vendor_damiao.h"

enum { DISABLED = 0, ENABLED = 1, HOT_MOS = 0xB, HOT_COIL = 0xC, LOST_COMM = 0xD };
enum { REGISTERS = 0x7FF, READ = 0x33, WRITE = 0x55, SAVE = 0xAA, REFRESH = 0xCC };
enum { ON = 0xFC, OFF = 0xFD, SET_ZERO = 0xFE, CLEAR = 0xFB };
enum {
    R_MST_ID = 7,
    R_ESC_ID,
    R_TIMEOUT,
    R_CTRL_MODE,
    R_HW_VER = 13,
    R_SW_VER,
    R_PMAX = 21,
    R_VMAX,
    R_TMAX,
    R_CAN_BR = 35
};
enum { MIT = 1, MODES = 4, TICK_NS = 50000, CLASSIC_1M = 4, FD_5M = 9 };
enum { HARDWARE = 3, SOFTWARE = 5017, WARM = 25, HOT = 120 };

static void boot(vendor_t *v, int64_t t_ns)
{
    (void)t_ns;
    v->state = DISABLED;
    v->mode = MIT;
    v->saved = (uint32_t)(v->timeout_ns / TICK_NS);
    v->word = v->saved; /* TIMEOUT */
    v->before = DISABLED;
}

static void bring_up(vendor_t *v) { v->state = ENABLED; }

static void trip(vendor_t *v, uint32_t code, int64_t t_ns)
{
    (void)t_ns;
    v->state = (int32_t)(code & 15);
    v->error = code & 15;
    v->acts = 0;
    v->due_ns = INT64_MAX;
    v->trips++;
}

/* ---- what is due: enabled at its next cycle, the watchdog ---- */

static int64_t lost_at(const vendor_t *v)
{
    return v->state == ENABLED && v->word ? v->fed_ns + (int64_t)v->word * TICK_NS + 1 : INT64_MAX;
}

static int64_t due(const vendor_t *v) { return v->due_ns < lost_at(v) ? v->due_ns : lost_at(v); }

static void event(vendor_t *v, int64_t t_ns)
{
    if (lost_at(v) <= t_ns) {
        trip(v, LOST_COMM, t_ns);
        return;
    }
    const int32_t was = v->state;
    v->state = was == DISABLED ? ENABLED : DISABLED;
    v->acts = v->state == ENABLED;
    v->due_ns = v->acts && v->drops ? t_ns + v->cycle_ns : INT64_MAX;
}

/* ---- commands ---- */

static int32_t is_special(const frame_t *f)
{
    for (int32_t k = 0; k < 7; k++)
        if (f->data[k] != 0xFF) return 0;
    return f->data[7] >= CLEAR && f->data[7] != 0xFF;
}

static void disable(vendor_t *v)
{
    if (v->state == ENABLED) v->state = DISABLED;
    v->acts = 0;
    v->due_ns = INT64_MAX;
}

static void request(vendor_t *v, int32_t what, int64_t t_ns)
{
    if (what == ON && v->state == DISABLED && !v->hot) v->due_ns = t_ns + v->cycle_ns;
    if (what == OFF) disable(v);
    if (what == CLEAR && v->state != ENABLED && !v->hot) {
        v->state = DISABLED;
        v->error = 0;
    }
}

static void torque(vendor_t *v, const frame_t *f)
{
    const int32_t code = (f->data[6] & 15) << 8 | f->data[7];
    v->tau = (code / 4095.0 * 2.0 - 1.0) * v->t_max;
    if (v->state != ENABLED && code != 2047 && code != 2048) v->refused++; /* no code is 0 N.m */
}

/* ---- registers ---- */

static int32_t baud(const vendor_t *v) { return v->format & FRAME_FD ? FD_5M : CLASSIC_1M; }

/* Value of a register into 4 bytes; 0: there is no such register. */
static int32_t read_register(const vendor_t *v, int32_t rid, uint8_t *value)
{
    switch (rid) {
    case R_MST_ID: vendor_put32(value, 0x10u + (uint32_t)v->node); break;
    case R_ESC_ID: vendor_put32(value, (uint32_t)v->node); break;
    case R_TIMEOUT: vendor_put32(value, v->word); break;
    case R_CTRL_MODE: vendor_put32(value, (uint32_t)v->mode); break;
    case R_HW_VER: vendor_put32(value, HARDWARE); break;
    case R_SW_VER: vendor_put32(value, SOFTWARE); break;
    case R_PMAX: vendor_put_float(value, v->p_max); break;
    case R_VMAX: vendor_put_float(value, v->v_max); break;
    case R_TMAX: vendor_put_float(value, v->t_max); break;
    case R_CAN_BR: vendor_put32(value, (uint32_t)baud(v)); break;
    default: return 0;
    }
    return 1;
}

/* What is only read, or takes a power-up to count, stays as it is. */
static void write_register(vendor_t *v, int32_t rid, const uint8_t *value)
{
    const uint32_t x = vendor_u32(value);
    const double real = (double)vendor_float(value);
    if (rid == R_TIMEOUT) v->word = x;
    if (rid == R_CTRL_MODE && x >= MIT && x <= MODES) v->mode = (int32_t)x;
    if (!(real > 0.0 && real < 3.4e38)) return;
    if (rid == R_PMAX) v->p_max = real;
    if (rid == R_VMAX) v->v_max = real;
    if (rid == R_TMAX) v->t_max = real;
}

static void registers(vendor_t *v, const frame_t *f, int64_t t_ns)
{
    uint8_t answer[8] = {0};
    const int32_t what = f->data[2], rid = f->data[3];
    if ((f->data[0] | f->data[1] << 8) != v->node) return;
    if (what == REFRESH) {
        v->owed[0]++;
        return;
    }
    if (what == WRITE) write_register(v, rid, f->data + 4);
    if (what == SAVE && v->state != ENABLED) v->timeout_ns = (int64_t)v->word * TICK_NS;
    if (what != SAVE && what != READ && what != WRITE) return;
    memcpy(answer, f->data, 4);
    if (what != SAVE && !read_register(v, rid, answer + 4)) return;
    vendor_queue(v, 0x10u + (uint32_t)v->node, v->format, answer, 8, t_ns);
}

static int32_t take(vendor_t *v, const frame_t *f, int64_t t_ns)
{
    if (f->id != (uint32_t)v->node && f->id != REGISTERS) return 0;
    const int32_t slow = (f->flags & FRAME_FD) && !(f->flags & FRAME_BRS);
    if (!vendor_plain(f) || slow || f->length != 8) {
        v->unheard++;
        return 0;
    }
    if (f->id == REGISTERS) {
        registers(v, f, t_ns);
        return 1;
    }
    const int32_t special = is_special(f);
    if (!special && v->mode != MIT) return 0;
    v->fed_ns = t_ns;
    v->owed[0]++;
    if (special) request(v, f->data[7], t_ns);
    else torque(v, f);
    return special;
}

/* ---- what it says ---- */

static void mark(const vendor_t *v, int32_t part, frame_t *f)
{
    (void)part;
    f->data[0] = (uint8_t)(v->state << 4 | (v->node & 15));
    f->data[6] = v->hot == 1 ? HOT : WARM;
    f->data[7] = v->hot == 2 ? HOT : WARM;
}

static void beat(vendor_t *v, int64_t t_ns) /* it has none: it says nothing unasked */
{
    (void)v;
    (void)t_ns;
}

const vendor_kind_t vendor_damiao = {boot, bring_up, take, due, event, mark, beat, trip, {HOT_MOS, HOT_COIL}};
