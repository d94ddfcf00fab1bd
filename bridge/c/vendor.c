/* vendor.c: what the drives of all vendors have in common: power, cable, queue, faults; see vendor.h. */
#include "vendor.h"

#include "vendor_cia402.h"
#include "vendor_damiao.h"
#include "vendor_odrive.h"

enum { TRUE_PART = 0x80 }; /* in `bus` of a queued frame: a feedback frame, of the part in the low bits */

static const vendor_kind_t *kind_of(const vendor_t *v)
{
    switch (v->kind) {
    case VENDOR_DAMIAO: return &vendor_damiao;
    case VENDOR_ODRIVE: return &vendor_odrive;
    default: return &vendor_cia402;
    }
}

/* ---- queue ---- */

/* A number below `range`, the next of its seed (splitmix64). */
static int64_t drawn(vendor_t *v, int64_t range)
{
    if (range <= 0) return 0;
    v->draw += 0x9E3779B97F4A7C15u;
    uint64_t z = v->draw;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return (int64_t)((z ^ z >> 31) % (uint64_t)range);
}

/* Sent in the order in which they were made, at t_ns, and after the time of answer to a request of asked_ns. */
static frame_t *place(vendor_t *v, int64_t asked_ns, int64_t t_ns)
{
    if (v->n_queue == VENDOR_QUEUE) {
        v->lost++;
        return 0;
    }
    frame_t *f = v->queue + v->n_queue++;
    const int64_t answer = asked_ns + v->answer_ns + drawn(v, v->jitter_ns);
    const int64_t due = (answer > t_ns ? answer : t_ns) + v->late_ns;
    v->last_ns = due > v->last_ns ? due : v->last_ns;
    memset(f, 0, sizeof *f);
    f->t_ns = v->last_ns;
    return f;
}

void vendor_queue(vendor_t *v, uint32_t id, int32_t format, const uint8_t *data, int32_t length, int64_t t_ns)
{
    frame_t *f = place(v, t_ns, t_ns);
    if (!f) return;
    f->id = id;
    f->flags = (uint8_t)format;
    f->length = (uint16_t)length;
    memcpy(f->data, data, (size_t)length);
}

API void vendor_say(vendor_t *v, int32_t part, const frame_t *frame, int64_t t_ns)
{
    vendor_step(v, t_ns);
    if (!v->network || !(v->owed[part] > 0 || v->kind == VENDOR_ODRIVE)) return;
    frame_t *f = place(v, v->owed[part] > 0 ? v->asked_ns[part] : t_ns, t_ns);
    if (v->owed[part] > 0) v->owed[part]--;
    if (!f) return;
    const int64_t due = f->t_ns;
    *f = *frame;
    f->t_ns = due;
    f->flags = (uint8_t)((f->flags & ~(FRAME_FD | FRAME_BRS)) | v->format);
    f->bus = (uint8_t)(TRUE_PART | part);
}

/* A drive whose positions stand still repeats what it sent first since then. */
static void repeat_old(vendor_t *v, int32_t part, frame_t *f)
{
    if (!v->old) return;
    if (!(v->old >> (part + 1) & 1)) memcpy(v->kept[part], f->data, sizeof v->kept[part]);
    v->old |= 2 << part;
    memcpy(f->data, v->kept[part], sizeof v->kept[part]);
}

static void remove_frame(vendor_t *v, int32_t i)
{
    v->n_queue--;
    memmove(v->queue + i, v->queue + i + 1, (size_t)(v->n_queue - i) * sizeof *v->queue);
}

/* The first frame that is not sent yet is due: it tells the state of this moment. */
static void send_frame(vendor_t *v)
{
    frame_t *f = v->queue + v->n_ready;
    if (f->bus & TRUE_PART) {
        const int32_t part = f->bus & ~TRUE_PART;
        repeat_old(v, part, f);
        kind_of(v)->mark(v, part, f);
    }
    f->bus = 0;
    f->id += (uint32_t)v->shift;
    if (v->plugged) v->n_ready++;
    else remove_frame(v, v->n_ready);
}

API int32_t vendor_next(vendor_t *v, int64_t t_ns, frame_t *frame)
{
    vendor_step(v, t_ns);
    if (v->n_ready == 0) return 0;
    *frame = v->queue[0];
    v->n_ready--;
    remove_frame(v, 0);
    return 1;
}

/* ---- power ---- */

static void power_up(vendor_t *v, int64_t t_ns)
{
    v->acts = 0;
    v->error = 0;
    v->result = 0;
    v->tau = 0.0;
    v->due_ns = v->ramp_ns = INT64_MAX;
    v->fed_ns = t_ns;
    v->beat_due_ns = v->beat_ns > 0 ? t_ns + v->beat_ns : INT64_MAX;
    v->network = 1;
    kind_of(v)->boot(v, t_ns);
}

void vendor_reboot(vendor_t *v, int64_t t_ns)
{
    v->acts = 0;
    v->network = 0;
    v->n_queue = v->n_ready;
    v->tau = 0.0;
    v->due_ns = v->ramp_ns = v->beat_due_ns = INT64_MAX;
    memset(v->owed, 0, sizeof v->owed);
    v->booted_ns = t_ns + v->boot_ns;
}

API void vendor_init(vendor_t *v, int64_t t_ns)
{
    v->now_ns = v->booted_ns = v->last_ns = t_ns;
    v->draw = v->seed;
    v->plugged = 1;
    power_up(v, t_ns);
    v->n_queue = 0; /* what it said then was long ago */
    memset(v->owed, 0, sizeof v->owed);
}

API void vendor_brought_up(vendor_t *v, int64_t t_ns)
{
    vendor_init(v, t_ns);
    kind_of(v)->bring_up(v);
    v->acts = 1;
    for (int32_t part = 0; part < VENDOR_PARTS; part++) { /* of the last command, SYNC */
        v->owed[part] = 1;
        v->asked_ns[part] = t_ns - v->answer_ns - v->jitter_ns;
    }
}

/* ---- time ---- */

static int64_t next_sending(const vendor_t *v)
{
    return v->n_ready < v->n_queue ? v->queue[v->n_ready].t_ns : INT64_MAX;
}

/* Events at one time: of the drive, its heartbeat, then what it sends. */
static int64_t next_event(const vendor_t *v)
{
    if (!v->network) return v->booted_ns;
    int64_t next = kind_of(v)->due(v);
    if (v->beat_due_ns < next) next = v->beat_due_ns;
    return next_sending(v) < next ? next_sending(v) : next;
}

static void one_event(vendor_t *v, int64_t t_ns)
{
    if (!v->network) {
        power_up(v, t_ns);
    } else if (kind_of(v)->due(v) <= t_ns) {
        kind_of(v)->event(v, t_ns);
    } else if (v->beat_due_ns <= t_ns) {
        v->beat_due_ns += v->beat_ns;
        kind_of(v)->beat(v, t_ns);
    } else {
        send_frame(v);
    }
}

API void vendor_step(vendor_t *v, int64_t t_ns)
{
    for (int64_t t = next_event(v); t <= t_ns; t = next_event(v)) one_event(v, t);
    if (t_ns > v->now_ns) v->now_ns = t_ns;
}

API int32_t vendor_take(vendor_t *v, const frame_t *frame, int64_t t_ns)
{
    vendor_step(v, t_ns);
    if (!v->network || !v->plugged || frame->flags & FRAME_ERROR) return 0;
    for (int32_t part = 0; part < VENDOR_PARTS; part++)
        if (v->owed[part] == 0) v->asked_ns[part] = t_ns;
    return kind_of(v)->take(v, frame, t_ns);
}

/* ---- faults ---- */

static void heat(vendor_t *v, int32_t which, int64_t t_ns)
{
    v->hot = which;
    if (v->network && (which == 1 || which == 2)) kind_of(v)->trip(v, kind_of(v)->hot[which - 1], t_ns);
}

API void vendor_fault(vendor_t *v, int32_t fault, int32_t code, int64_t t_ns)
{
    vendor_step(v, t_ns);
    switch (fault) {
    case VENDOR_TRIP:
        if (v->network) kind_of(v)->trip(v, (uint32_t)code, t_ns);
        break;
    case VENDOR_REBOOT: vendor_reboot(v, t_ns); break;
    case VENDOR_UNPLUG: v->plugged = 0; break;
    case VENDOR_PLUG: v->plugged = 1; break;
    case VENDOR_LATE: v->late_ns = code; break;
    case VENDOR_OTHER_ID: v->shift = code; break;
    case VENDOR_OLD: v->old = code != 0; break;
    case VENDOR_HOT: heat(v, code, t_ns); break;
    case VENDOR_DROP: v->drops = code; break;
    default: break;
    }
}
