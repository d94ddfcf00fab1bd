/* inlet.c: received values as inputs of a node's components; see inlet.h. */
#include "inlet.h"

#include <string.h>

static const inlet_row_t *recorded(const inlet_t *in)
{
    const node_t *n = in->node;
    const char *row = n->replayed + n->replay_row * n->row_size;
    return (const inlet_row_t *)(row + n->inlet_offset) + (in - n->inlets);
}

/* Replay: whether the held sample is in the journal of accepted samples; it is, unless that was full. */
static int32_t is_recorded(const history_t *h, int64_t held)
{
    const int64_t k = h ? held - h->first : -1;
    return h && (held < 0 || (k >= 0 && k < h->capacity && h->there[k] == SAMPLE_THERE));
}

/* The input as it was recorded; where a row is written before the input is passed, in the next. */
static void as_recorded(const inlet_t *in, double *signals)
{
    const node_t *n = in->node;
    const int64_t row = n->replay_row + in->later;
    if (row >= n->replayed_rows) return;
    memcpy(signals + in->target,
           (const double *)(n->replayed + row * n->row_size + n->signals_offset) + in->target,
           (size_t)in->count * sizeof(double));
    if (in->drive) memcpy(in->drive->tau, signals + in->target, (size_t)in->count * sizeof(double));
}

/* The newest sample that has been received, or will be although it counts already. */
static int64_t newest(const reception_t *r) { return r->promised > r->newest ? r->promised : r->newest; }

/* The sample held now: from the delay line, or as recorded; NULL: none yet. */
static const double *take(inlet_t *in)
{
    node_t *n = in->node;
    if (n->clock == CLOCK_REPLAY) {
        const history_t *h = in->reception->history;
        in->held = recorded(in)->held;
        in->newest = recorded(in)->newest;
        if (in->held < 0 || !is_recorded(h, in->held)) return 0;
        return h->values + (in->held - h->first) * h->width + in->first;
    }
    in->held = delay_take(in->delay, n->slot / in->period, n->now_ns);
    in->newest = newest(in->reception);
    return in->held < 0 ? 0 : delay_values(in->delay, in->held);
}

static void give(const inlet_t *in, const double *value, double *target)
{
    for (int32_t k = 0; k < in->count; k++) target[k] = in->gain * value[k] + in->offset;
}

/* Age of the held sample by the nominal times of its sender's slot and of this slot, ns. */
static int64_t age_ns(const inlet_t *in)
{
    const int64_t held = in->held < 0 ? 0 : in->held;
    const int64_t sent = held * in->reception->period_ns + in->reception->offset_ns;
    return in->node->now_ns + in->node->phase_ns - sent;
}

static void ask(inlet_t *in, int32_t request) { in->asked = commands_add(in->asked, request); }

/* Faults of the drive as requests, which are recorded. */
static void suffer(inlet_t *in)
{
    const int32_t state = in->drive->state;
    while (in->happened < in->n_faults && in->faults[in->happened].t_ns <= in->node->now_ns) {
        const motor_fault_t *f = in->faults + in->happened++;
        if (f->fault == VENDOR_HOT) in->hot = f->code;
        if (f->fault == VENDOR_DROP) in->drops = f->code;
        if (f->fault == VENDOR_TRIP) ask(in, DRIVE_TRIP);
        if (f->fault == VENDOR_REBOOT) ask(in, f->code ? DRIVE_POWER_OFF : DRIVE_POWER_ON);
    }
    if (in->hot && state != DRIVE_FAULT) ask(in, DRIVE_TRIP);
    if (in->drops && state == DRIVE_ENABLED) ask(in, DRIVE_DISABLE);
}

/* A drive of our own protocol follows its node, but not in what it does of itself. */
static void obey(inlet_t *in)
{
    const node_t *n = in->node;
    if (n->clock != CLOCK_REPLAY) suffer(in);
    in->requests = n->clock == CLOCK_REPLAY ? recorded(in)->requests : (int64_t)in->asked;
    in->asked = 0;
    for (int64_t left = in->requests; left; left >>= 3) {
        const int32_t what = (int32_t)(left & 7);
        drive_request(in->drive, what, n->now_ns);
        in->tripped |= what == DRIVE_TRIP;
    }
    in->tripped &= in->drive->state == DRIVE_FAULT;
}

/* Why its node has to stop for a drive of our own protocol. */
static uint32_t why_off(const inlet_t *in)
{
    const int32_t state = in->drive->state, life = in->node->life.state;
    if (in->motor || life == LIFE_FAULT) return 0;
    if (state == DRIVE_FAULT) return in->tripped ? WHY_DRIVE : WHY_WATCHDOG;
    return life == LIFE_ACTIVE && state != DRIVE_ENABLED ? WHY_DRIVE : 0;
}

/* The vendor's state machine has decided whether torque acts in this slot; until it does, there is none. */
static void follow_motor(inlet_t *in)
{
    const int64_t power = in->motor->power;
    drive_t *d = in->drive;
    const int32_t before = d->state;
    d->state = power & MOTOR_ACTS ? DRIVE_ENABLED : power & MOTOR_FAULT ? DRIVE_FAULT : DRIVE_READY;
    d->faults += d->state == DRIVE_FAULT && before != DRIVE_FAULT;
    watchdog_reset(&d->watchdog, in->node->now_ns); /* the vendor has its own */
}

/* A torque that came before the drive was enabled does not act. */
static void forget_torque(inlet_t *in)
{
    in->ignored = in->newest;
    memset(in->command, 0, (size_t)in->count * sizeof(double));
}

/* Torque commands pass through the drive. A command without a valid value also resets its watchdog; a
 * command that is too old (also by the law of its link) neither moves it nor resets the watchdog. */
static void write_through_drive(inlet_t *in, const double *value, int32_t fresh, double *signals)
{
    node_t *n = in->node;
    if (in->motor) follow_motor(in);
    else obey(in);
    if (in->drive->state != DRIVE_ENABLED) forget_torque(in);
    const int32_t old = in->max_age_ns > 0 && in->held >= 0 && age_ns(in) > in->max_age_ns;
    if (old && fresh) in->reception->receiver->stale++;
    if (value && !old && in->held > in->ignored) give(in, value, in->command);
    drive_step(in->drive, in->command, fresh && in->held >= 0 && !old, signals + in->dq, n->now_ns,
               signals + in->target);
    n->life.now |= why_off(in);
}

/* What is held; a link of the law `signal` may go back to what there was before the first. */
static void write_signal(inlet_t *in, const double *value, double *signals)
{
    double *target = signals + in->target;
    if (value) give(in, value, target);
    else if (in->begun && in->held < 0) memcpy(target, in->initial, (size_t)in->count * sizeof *target);
}

/* A drive that is not enabled may tell no position: some only answer commands. A start waits for one. */
static int32_t awaits(const inlet_t *in)
{
    const int32_t drive = in->reception->drive;
    return drive < 0 || in->node->commanded[drive].phase == DRIVE_SERVING;
}

API int32_t inlet_pass(void *context, int64_t tick, double *signals)
{
    inlet_t *in = context;
    node_t *n = in->node;
    const double *value = take(in);
    const int32_t fresh = in->newest != in->last_newest;
    (void)tick;

    if (fresh) in->heard_ns = n->now_ns;
    in->last_newest = in->newest;
    if (in->drive) write_through_drive(in, value, fresh, signals);
    else write_signal(in, value, signals);
    if (n->clock == CLOCK_REPLAY && !is_recorded(in->reception->history, in->held)) as_recorded(in, signals);
    if (!in->begun) {
        memcpy(in->initial, signals + in->target, (size_t)in->count * sizeof *signals);
        in->begun = 1;
    }
    const int64_t silence = n->now_ns - in->heard_ns;
    if (in->link_age >= 0) signals[in->link_age] = (double)age_ns(in) * 1e-9;
    if (in->age >= 0) signals[in->age] = (double)silence * 1e-9;
    if (in->stop_ns > 0 && silence > in->stop_ns && awaits(in)) n->life.now |= WHY_STALE;
    return 0;
}
