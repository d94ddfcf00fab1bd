/* emulated.c: emulated drives of vendors in a node; see emulated.h. */
#include "emulated.h"

#include <string.h>

#include "send.h"

void emulated_begin(node_t *n, int64_t t_ns)
{
    for (int32_t i = 0; i < n->n_motors; i++) {
        if (n->clock == CLOCK_WALL) vendor_init(&n->motors[i].vendor, t_ns);
        else vendor_brought_up(&n->motors[i].vendor, t_ns);
    }
}

/* Faults whose time has come, before what is heard later. */
static void happen(const node_t *n, motor_t *m, int64_t t_ns)
{
    while (node_started(n) && m->happened < m->n_faults) {
        const motor_fault_t *f = m->faults + m->happened;
        if (f->t_ns + n->start_ns > t_ns) return;
        m->happened++;
        vendor_fault(&m->vendor, f->fault, f->code, f->t_ns + n->start_ns);
    }
}

int32_t emulated_hear(node_t *n, const frame_t *frame)
{
    int32_t asked = 0;
    for (int32_t i = 0; i < n->n_motors; i++) {
        motor_t *m = n->motors + i;
        if (m->bus != frame->bus) continue;
        happen(n, m, frame->t_ns);
        asked |= vendor_take(&m->vendor, frame, frame->t_ns);
    }
    return asked;
}

/* What it has sent, onto its bus. */
static void flush(node_t *n, motor_t *m, int64_t t_ns)
{
    frame_t frame;
    while (vendor_next(&m->vendor, t_ns, &frame)) {
        const int64_t sent_ns = n->clock == CLOCK_WALL ? pace_now() : t_ns;
        frame.t_ns = sent_ns;
        node_send(n, m->bus, &frame, sent_ns - n->start_ns);
    }
}

static int64_t power_of(const vendor_t *v)
{
    int64_t power = v->acts ? MOTOR_ACTS : v->error ? MOTOR_FAULT : 0;
    const int32_t cyclic = v->kind == VENDOR_ODRIVE && v->network;
    for (int32_t part = 0; part < VENDOR_PARTS; part++)
        if (cyclic || v->owed[part] > 0) power |= (int64_t)MOTOR_OWES << part;
    return power;
}

void emulated_step(node_t *n, int64_t t_ns)
{
    const char *row = n->replayed + n->replay_row * n->row_size;
    for (int32_t i = 0; i < n->n_inlets; i++) {
        motor_t *m = n->inlets[i].motor;
        if (!m) continue;
        if (n->clock == CLOCK_REPLAY) {
            m->power = ((const inlet_row_t *)(row + n->inlet_offset))[i].requests;
            continue;
        }
        happen(n, m, t_ns);
        vendor_step(&m->vendor, t_ns);
        flush(n, m, t_ns);
        m->power = power_of(&m->vendor);
    }
}

void emulated_attend(node_t *n, int64_t t_ns)
{
    for (int32_t i = 0; i < n->n_motors; i++) {
        motor_t *m = n->motors + i;
        vendor_step(&m->vendor, t_ns);
        m->power = power_of(&m->vendor);
    }
}

void emulated_flush(node_t *n, int64_t t_ns)
{
    for (int32_t i = 0; i < n->n_motors; i++) flush(n, n->motors + i, t_ns);
}

int32_t emulated_owes(const outlet_t *o) { return (o->motor->power & (int64_t)MOTOR_OWES << o->part) != 0; }

void emulated_say(outlet_t *o, frame_t *frame, int64_t now_ns)
{
    motor_t *m = o->motor;
    const int64_t t_ns = now_ns + o->node->start_ns;
    vendor_say(&m->vendor, (int32_t)o->part, frame, t_ns);
    m->vendor.owed[o->part] = 0; /* commands since its last answer have one */
    flush(o->node, m, t_ns);
}
