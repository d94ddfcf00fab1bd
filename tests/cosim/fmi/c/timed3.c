/* An FMU of FMI 3.0 with clocks that have no period, which insists on the rules: intervals are
 * asked for at the start, then of `pulse` (changing) when it has ticked, of `delay` (counting
 * down) in every Event Mode; a clock ticks when it was said to, and no step goes beyond that.
 *
 * pulse: after 0.2 s, then 0.1, 0.25, 0, 0.15 s and so on; y_pulse sums up what it takes, at_pulse
 * is when it ticked. start: triggered from outside; it arms `delay`, which ticks `wait` s later.
 * done: an output clock that ticks with it; at_done is when, y_done what `start` had taken, and
 * `said` the same. With `lenient` 1, ticks may be late; with 2, intervals are wrong.
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#define FMI __attribute__((visibility("default")))
typedef void (*log_t)(void *, int, const char *, const char *);
enum {
    PULSE = 1,
    START,
    DELAY,
    DONE,
    CLOCKS,
    U_PULSE = 10,
    U_START,
    WAIT,
    LENIENT,
    Y_PULSE = 20,
    AT_PULSE,
    Y_DONE,
    AT_DONE,
    TIME
};
enum { NOT_YET_KNOWN, UNCHANGED, CHANGED };

typedef struct {
    log_t log;
    void *environment;
    bool on[CLOCKS], initializing, in_event, asked_pulse, asked_delay, armed, pulsed;
    double time, next_pulse, next_delay, u[4], sum, taken;
    int pulses;
    char text[32];
} fmu_t;

static const double INTERVALS[] = {0.2, 0.1, 0.25, 0.0, 0.15};

static int refuse(fmu_t *x, const char *why)
{
    x->log(x->environment, 3, "logStatusError", why);
    return 3;
}

FMI void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                      bool visible, bool logging, bool events, bool early,
                                      const uint32_t *required, size_t n, void *environment, log_t log,
                                      void *update)
{
    fmu_t *x = calloc(1, sizeof *x);
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)required, (void)n;
    (void)update, (void)early;
    x->log = log, x->environment = environment, x->next_delay = INFINITY, x->u[2] = 0.15;
    if (events) return x;
    free(x);
    return NULL;
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
    if (!x->asked_pulse || !x->asked_delay) return refuse(x, "intervals were not asked for");
    x->initializing = x->asked_delay = false;
    x->in_event = true;
    return 0;
}
FMI int fmi3EnterEventMode(fmu_t *x)
{
    if (x->in_event) return refuse(x, "in Event Mode already");
    x->in_event = true;
    x->asked_delay = false;
    return 0;
}
FMI int fmi3EnterStepMode(fmu_t *x)
{
    if (x->on[PULSE] || x->on[START] || x->on[DELAY]) return refuse(x, "a clock is still active");
    if (!x->asked_pulse) return refuse(x, "pulse ticked, and nobody asked when it does again");
    if (!x->asked_delay) return refuse(x, "nobody asked for the delay in this Event Mode");
    x->in_event = false;
    return 0;
}
FMI int fmi3SetClock(fmu_t *x, const uint32_t *r, size_t n, const bool *v)
{
    for (size_t i = 0; i < n; i++) {
        const double next = r[i] == PULSE ? x->next_pulse : r[i] == DELAY ? x->next_delay : x->time;
        const double late = x->time - next;
        if (!x->in_event || r[i] > DELAY || !v[i]) return refuse(x, "no clock to set");
        if (late < -1e-9) return refuse(x, "a tick before its time");
        if (late > 1e-9 && !x->u[LENIENT - U_PULSE]) return refuse(x, "a tick after its time");
        x->on[r[i]] = true;
    }
    return 0;
}
FMI int fmi3GetClock(fmu_t *x, const uint32_t *r, size_t n, bool *v)
{
    for (size_t i = 0; i < n; i++) {
        if (!x->in_event || r[i] != DONE) return refuse(x, "no clock to get");
        if (!x->on[DELAY]) return refuse(x, "done belongs to delay, which is not active");
        v[i] = x->on[DONE] = true;
    }
    return 0;
}
FMI int fmi3UpdateDiscreteStates(fmu_t *x, bool *again, bool *terminate, bool *nominals, bool *values,
                                 bool *defined, double *next)
{
    if (!x->in_event) return refuse(x, "not in Event Mode");
    if (x->on[DELAY] && !x->on[DONE]) return refuse(x, "nobody asked whether it is done");
    if (x->on[PULSE]) {
        x->sum += x->u[0];
        x->next_pulse = x->time + INTERVALS[++x->pulses % 5];
        x->pulsed = true, x->asked_pulse = false;
    }
    if (x->on[DELAY]) x->next_delay = INFINITY;
    if (x->on[START]) {
        x->taken = x->u[1], x->next_delay = x->time + x->u[2];
        x->armed = true;
    }
    for (int i = 0; i < CLOCKS; i++) x->on[i] = false;
    *again = *terminate = *nominals = *values = *defined = false;
    *next = 0.0;
    return 0;
}
FMI int fmi3GetIntervalDecimal(fmu_t *x, const uint32_t *r, size_t n, double *v, int *qualifiers)
{
    if (!x->initializing && !x->in_event) return refuse(x, "intervals are not for Step Mode");
    for (size_t i = 0; i < n; i++) {
        const bool pulse = r[i] == PULSE;
        if (!pulse && r[i] != DELAY) return refuse(x, "this clock has no interval");
        v[i] = pulse ? x->next_pulse - x->time : x->armed ? x->u[2] : -1.0;
        qualifiers[i] = pulse                  ? CHANGED
                        : x->armed             ? CHANGED
                        : isinf(x->next_delay) ? NOT_YET_KNOWN
                                               : UNCHANGED;
        if (pulse && x->initializing) v[i] = x->next_pulse = INTERVALS[0];
        if (pulse && !x->initializing && !x->pulsed) qualifiers[i] = UNCHANGED;
        if (pulse && !x->initializing && x->u[LENIENT - U_PULSE] == 2) v[i] = -1.0, qualifiers[i] = CHANGED;
        if (pulse) x->pulsed = false, x->asked_pulse = true;
        else x->armed = false, x->asked_delay = true;
    }
    return 0;
}
/* The same in multiples of 1/20 s, or of 1 ns for the delay. */
FMI int fmi3GetIntervalFraction(fmu_t *x, const uint32_t *r, size_t n, uint64_t *counters,
                                uint64_t *resolutions, int *qualifiers)
{
    for (size_t i = 0; i < n; i++) {
        double v;
        if (fmi3GetIntervalDecimal(x, r + i, 1, &v, qualifiers + i)) return 3;
        resolutions[i] = r[i] == PULSE ? 20 : 1000000000;
        counters[i] = v > 0.0 ? (uint64_t)(v * (double)resolutions[i] + 0.5) : 0;
        if (v < 0.0) resolutions[i] = 0;
    }
    return 0;
}
FMI int fmi3DoStep(fmu_t *x, double t, double h, bool prior, bool *event, bool *terminate, bool *early,
                   double *last)
{
    const double next = x->next_pulse < x->next_delay ? x->next_pulse : x->next_delay;
    (void)prior;
    if (x->in_event) return refuse(x, "no step in Event Mode");
    if (fabs(t - x->time) > 1e-9) return refuse(x, "a step begins where the last one ended");
    if (next < t + h - 1e-9 && !x->u[LENIENT - U_PULSE]) return refuse(x, "a step over a tick");
    *last = x->time = t + h;
    *event = *terminate = *early = false;
    return 0;
}

/* Whether a variable may be accessed now. */
static bool open(const fmu_t *x, uint32_t r)
{
    if (x->initializing || r == TIME || ((r == WAIT || r == LENIENT) && !x->in_event)) return true;
    if (r == U_PULSE || r == Y_PULSE || r == AT_PULSE) return x->on[PULSE];
    return r == U_START ? x->on[START] : x->on[DONE];
}

FMI int fmi3SetFloat64(fmu_t *x, const uint32_t *r, size_t n, const double *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++) {
        if (!open(x, r[i])) return refuse(x, "set without a clock");
        x->u[r[i] - U_PULSE] = v[i];
    }
    return 0;
}
FMI int fmi3GetFloat64(fmu_t *x, const uint32_t *r, size_t n, double *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++) {
        if (!open(x, r[i])) return refuse(x, "got without a clock");
        v[i] = r[i] >= WAIT && r[i] <= LENIENT ? x->u[r[i] - U_PULSE]
               : x->initializing               ? -1.0
               : r[i] == Y_PULSE               ? x->sum + x->u[0]
               : r[i] == Y_DONE                ? x->taken
                                               : x->time;
    }
    return 0;
}
FMI int fmi3GetString(fmu_t *x, const uint32_t *r, size_t n, const char **v, size_t m)
{
    (void)r, (void)n, (void)m;
    if (!x->on[DONE]) return refuse(x, "got without a clock");
    snprintf(x->text, sizeof x->text, "%g", x->taken);
    v[0] = x->text;
    return 0;
}

/* What a complete FMU has as well, and nobody calls. */
#include "unused3.h"
#include "saved3.h"
SAVED_FROM(on)
UNUSED(GetInt32)
UNUSED(GetShiftDecimal)
UNUSED(SetIntervalDecimal)
