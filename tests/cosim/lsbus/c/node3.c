/* A node of a CAN bus by FMI-LS-BUS 1.0, which insists on the rules of FMI 3.0. Bytes are written
 * here by hand, independent of the importer's.
 *
 * It sends `count` frames `id` of `bytes` bytes, the first at `first` s, then every `period` s; before,
 * at its first tick, its configuration: `baud`, and with `discard` that lost frames are discarded. It counts errors by
 * what the bus tells it (TEC), says its status when that changes, and is silent when bus-off.
 * Bytes of the data of frame k: k + SMOOTH + JUMP, and one more each. SMOOTH is a continuous input, JUMP
 * a discrete one, HEARD is the first byte of the last frame received, and TICKED is the time of the last
 * tick of Rx_Clock.
 * kind: 0 Tx_Clock is triggered (by the FMU), 1 counts down, 2 is changing, 3 has a period.
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define FMI __attribute__((visibility("default")))
typedef void (*log_t)(void *, int, const char *, const char *);
enum {
    TX_CLOCK = 1,
    RX_CLOCK,
    TX_DATA,
    RX_DATA,
    KIND = 10,
    ID,
    BYTES,
    COUNT,
    FIRST,
    PERIOD,
    BAUD,
    DISCARD,
    BAD,
    NOTIFY,
    TEC = 20,
    SENT,
    HEARD,
    TICKED,
    SMOOTH = 30,
    JUMP
};
enum { TRIGGERED, COUNTDOWN, CHANGING, PERIODIC };
enum { NOT_YET_KNOWN, UNCHANGED, CHANGED };

typedef struct {
    log_t log;
    void *environment;
    bool initializing, in_event, tx_on, rx_on, notify, announced, asked, asked_change;
    double time, p[10], inputs[2], heard, ticked;
    uint8_t tx[8192], rx[8192];
    size_t n_tx, n_rx;
    int tec, sent, status;
} fmu_t;

static int refuse(fmu_t *x, const char *why)
{
    x->log(x->environment, 3, "logStatusError", why);
    return 3;
}

static double p(const fmu_t *x, int which) { return x->p[which - KIND]; }

static void put(fmu_t *x, uint32_t value, int bytes)
{
    for (int i = 0; i < bytes; i++) x->tx[x->n_tx++] = (uint8_t)(value >> 8 * i);
}

static void head(fmu_t *x, uint32_t code, uint32_t length) { put(x, code, 4), put(x, length, 4); }

static double next(const fmu_t *x) { return p(x, FIRST) + x->sent * p(x, PERIOD); }

static bool more(const fmu_t *x) { return x->sent < (int)p(x, COUNT) && x->status != 3; }

/* Write the frames that are due. */
static void produce(fmu_t *x)
{
    while (more(x) && x->time >= next(x) - 1e-12) {
        const uint32_t n = (uint32_t)p(x, BYTES);
        head(x, 0x10, 16 + n), put(x, (uint32_t)p(x, ID), 4), put(x, 0, 2), put(x, n, 2);
        for (uint32_t i = 0; i < n; i++) put(x, (uint32_t)(x->sent + x->inputs[0] + x->inputs[1]) + i, 1);
        x->sent++;
    }
}

/* What it says of itself at the start. */
static void configure(fmu_t *x)
{
    if (p(x, BAUD) > 0) head(x, 0x40, 13), put(x, 1, 1), put(x, (uint32_t)p(x, BAUD), 4);
    if (p(x, DISCARD) > 0) head(x, 0x40, 10), put(x, 4, 1), put(x, 2, 1);
    if (p(x, BAD) > 0) head(x, 0x77, 8);
}

static uint32_t word(const uint8_t *b) { return b[0] | b[1] << 8 | b[2] << 16 | (uint32_t)b[3] << 24; }

/* Count errors; say the status where it changes. */
static void hear(fmu_t *x)
{
    for (size_t at = 0; at + 8 <= x->n_rx; at += word(x->rx + at + 4)) {
        const uint8_t *op = x->rx + at;
        if (word(op) == 0x31 && op[14]) x->tec += 8;
        if (word(op) == 0x20 && x->tec) x->tec--;
        if (word(op) == 0x10) x->heard = op[16];
        const int status = x->tec > 255 ? 3 : x->tec > 127 ? 2 : 1;
        if (status != x->status) head(x, 0x41, 9), put(x, (uint32_t)status, 1);
        x->status = status;
    }
    x->n_rx = 0;
}

FMI void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                      bool visible, bool logging, bool events, bool early,
                                      const uint32_t *required, size_t n, void *environment, log_t log,
                                      void *update)
{
    fmu_t *x = calloc(1, sizeof *x);
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)required, (void)n;
    (void)update, (void)early, (void)events;
    x->log = log, x->environment = environment, x->status = 1;
    return x;
}
FMI void fmi3FreeInstance(void *x) { free(x); }
FMI int fmi3Terminate(void *x)
{
    (void)x;
    return 0;
}
FMI int fmi3EnterInitializationMode(fmu_t *x, bool a, double b, double c, bool d, double e)
{
    (void)a, (void)b, (void)c, (void)d, (void)e;
    x->initializing = true;
    return 0;
}
FMI int fmi3ExitInitializationMode(fmu_t *x)
{
    x->initializing = false, x->in_event = true;
    configure(x);
    return 0;
}
FMI int fmi3EnterEventMode(fmu_t *x)
{
    if (x->in_event) return refuse(x, "in Event Mode already");
    x->in_event = true, x->asked = false;
    return 0;
}
FMI int fmi3EnterStepMode(fmu_t *x)
{
    if (!x->in_event || x->tx_on || x->rx_on) return refuse(x, "no Event Mode to leave");
    if (p(x, KIND) == COUNTDOWN && !x->asked) return refuse(x, "nobody asked when to tick");
    x->in_event = false;
    return 0;
}
FMI int fmi3SetClock(fmu_t *x, const uint32_t *r, size_t n, const bool *v)
{
    if (!x->in_event || n != 1 || !v[0]) return refuse(x, "no clock to set");
    if (r[0] == RX_CLOCK) {
        x->rx_on = true, x->ticked = x->time;
        return 0;
    }
    if (r[0] != TX_CLOCK || p(x, KIND) == TRIGGERED) return refuse(x, "no clock of this FMU to set");
    x->tx_on = true, x->announced = false, x->asked_change = false;
    produce(x);
    return 0;
}
FMI int fmi3GetClock(fmu_t *x, const uint32_t *r, size_t n, bool *v)
{
    if (!x->in_event || n != 1 || r[0] != TX_CLOCK || p(x, KIND) != TRIGGERED)
        return refuse(x, "no clock to get");
    produce(x);
    v[0] = x->tx_on = x->n_tx > 0;
    return 0;
}
FMI int fmi3SetBinary(fmu_t *x, const uint32_t *r, size_t n, const size_t *sizes, const uint8_t *const *v,
                      size_t m)
{
    if (!x->rx_on || n != 1 || m != 1 || r[0] != RX_DATA) return refuse(x, "Rx without its clock");
    memcpy(x->rx, v[0], x->n_rx = sizes[0]);
    return 0;
}
FMI int fmi3GetBinary(fmu_t *x, const uint32_t *r, size_t n, size_t *sizes, const uint8_t **v, size_t m)
{
    if (!x->tx_on || n != 1 || m != 1 || r[0] != TX_DATA) return refuse(x, "Tx without its clock");
    sizes[0] = x->n_tx, v[0] = x->tx;
    return 0;
}
FMI int fmi3UpdateDiscreteStates(fmu_t *x, bool *again, bool *terminate, bool *nominals, bool *values,
                                 bool *defined, double *time)
{
    if (!x->in_event) return refuse(x, "not in Event Mode");
    if (x->tx_on) x->n_tx = 0;
    if (x->rx_on) hear(x);
    x->tx_on = x->rx_on = false;
    *again = p(x, KIND) == TRIGGERED && x->n_tx > 0;
    *terminate = *nominals = *values = *defined = false;
    *time = 0.0;
    return 0;
}
FMI int fmi3GetIntervalDecimal(fmu_t *x, const uint32_t *r, size_t n, double *v, int *q)
{
    if (!x->initializing && !x->in_event) return refuse(x, "intervals are not for Step Mode");
    if (n != 1 || r[0] != TX_CLOCK) return refuse(x, "this clock has no interval");
    x->asked = true, q[0] = CHANGED;
    if (p(x, KIND) == COUNTDOWN) {
        v[0] = x->n_tx ? 0.0 : next(x) - x->time;
        if (!x->n_tx && (x->announced || !more(x))) q[0] = x->announced ? UNCHANGED : NOT_YET_KNOWN;
        if (!x->n_tx && more(x)) x->announced = true;
    } else if (p(x, KIND) == CHANGING) {
        if (x->asked_change) return refuse(x, "asked twice for an interval");
        v[0] = p(x, x->initializing ? FIRST : PERIOD), x->asked_change = true;
    } else {
        v[0] = p(x, PERIOD);
    }
    return 0;
}
FMI int fmi3GetShiftDecimal(fmu_t *x, const uint32_t *r, size_t n, double *v)
{
    (void)r, (void)n;
    v[0] = p(x, FIRST);
    return 0;
}
FMI int fmi3DoStep(fmu_t *x, double t, double h, bool prior, bool *event, bool *terminate, bool *early,
                   double *last)
{
    (void)prior;
    if (x->in_event) return refuse(x, "no step in Event Mode");
    if (fabs(t - x->time) > 1e-12) return refuse(x, "a step begins where the last one ended");
    if (p(x, KIND) != TRIGGERED && more(x) && next(x) < t + h - 1e-12) return refuse(x, "a step over a tick");
    *last = x->time = t + h;
    *event = p(x, KIND) == TRIGGERED && more(x) && x->time >= next(x) - 1e-12;
    *terminate = *early = false;
    return 0;
}
FMI int fmi3SetFloat64(fmu_t *x, const uint32_t *r, size_t n, const double *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++) {
        if (r[i] == JUMP && !x->in_event && !x->initializing) return refuse(x, "a jump in a step");
        if (r[i] >= SMOOTH) x->inputs[r[i] - SMOOTH] = v[i];
        else x->p[r[i] - KIND] = v[i];
    }
    return 0;
}
FMI int fmi3GetFloat64(fmu_t *x, const uint32_t *r, size_t n, double *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++)
        v[i] = r[i] >= SMOOTH   ? x->inputs[r[i] - SMOOTH]
               : r[i] == HEARD  ? x->heard
               : r[i] == TICKED ? x->ticked
               : r[i] == TEC    ? x->tec
               : r[i] == SENT   ? x->sent
                                : x->p[r[i] - KIND];
    return 0;
}
FMI int fmi3SetBoolean(fmu_t *x, const uint32_t *r, size_t n, const bool *v, size_t m)
{
    (void)r, (void)n, (void)m;
    x->notify = v[0];
    return 0;
}
FMI int fmi3GetBoolean(fmu_t *x, const uint32_t *r, size_t n, bool *v, size_t m)
{
    (void)r, (void)n, (void)m;
    v[0] = x->notify;
    return 0;
}
