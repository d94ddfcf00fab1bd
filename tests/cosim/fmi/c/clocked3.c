/* An FMU of FMI 3.0 with four clocks that insists on the rules: clocked variables are accessible in
 * Initialization Mode and while one of their clocks is active, which ends with the update of the
 * discrete states; output clocks are asked for in every instant.
 *
 * fast, slow: input clocks; what they take is summed up in y_fast, y_slow. bell: an output clock of
 * its own events, every 0.25 s from 0 on; y_bell counts them, heard is what it takes. echo: an output
 * clock that ticks with `fast` when u_fast is above 2.5; y_echo counts that. y_both: of fast or slow.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#define FMI __attribute__((visibility("default")))
typedef void (*log_t)(void *, int, const char *, const char *);
enum {
    FAST = 1,
    SLOW,
    BELL,
    ECHO,
    CLOCKS,
    U_FAST = 10,
    U_SLOW,
    U_BELL,
    Y_FAST = 20,
    Y_SLOW,
    Y_BELL,
    HEARD,
    Y_BOTH,
    TIME = 30,
    Y_ECHO = 40
};

typedef struct {
    log_t log;
    void *environment;
    bool on[CLOCKS], asked[CLOCKS], initializing, in_event, pending, early;
    double time, u[3], fast, slow;
    int bells, echoes, instants;
} fmu_t;

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
    (void)update;
    x->log = log, x->environment = environment, x->early = early;
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
    x->initializing = false, x->in_event = x->pending = true, x->instants = 0;
    return 0;
}
FMI int fmi3EnterEventMode(fmu_t *x)
{
    if (x->in_event) return refuse(x, "in Event Mode already");
    x->in_event = true, x->instants = 0;
    return 0;
}
FMI int fmi3EnterStepMode(fmu_t *x)
{
    x->in_event = false;
    return 0;
}
FMI int fmi3SetClock(fmu_t *x, const uint32_t *r, size_t n, const bool *v)
{
    for (size_t i = 0; i < n; i++) {
        if (!x->in_event || r[i] > SLOW || !v[i]) return refuse(x, "no clock to set");
        x->on[r[i]] = true;
    }
    return 0;
}
FMI int fmi3GetClock(fmu_t *x, const uint32_t *r, size_t n, bool *v)
{
    for (size_t i = 0; i < n; i++) {
        if (!x->in_event) return refuse(x, "clocks are asked for in Event Mode");
        if (r[i] == ECHO && !x->on[FAST]) return refuse(x, "echo belongs to fast, which is not active");
        if (r[i] == BELL) x->on[BELL] = x->pending;
        if (r[i] == ECHO) x->on[ECHO] = x->u[0] > 2.5;
        x->asked[r[i]] = true;
        v[i] = x->on[r[i]];
    }
    return 0;
}
FMI int fmi3UpdateDiscreteStates(fmu_t *x, bool *again, bool *terminate, bool *nominals, bool *values,
                                 bool *defined, double *next)
{
    if (!x->in_event) return refuse(x, "not in Event Mode");
    if (!x->asked[BELL]) return refuse(x, "nobody asked for the bell");
    if (x->on[FAST] && !x->asked[ECHO]) return refuse(x, "nobody asked for the echo");
    if (x->on[FAST]) x->fast += x->u[0];
    if (x->on[SLOW]) x->slow += x->u[1];
    x->bells += x->on[BELL], x->echoes += x->on[ECHO];
    *again = x->pending && x->instants++ == 0; /* another instant, in which nothing ticks */
    x->pending = false;
    for (int i = 0; i < CLOCKS; i++) x->on[i] = x->asked[i] = false;
    *terminate = *nominals = *values = *defined = false;
    *next = 0.0;
    return 0;
}
FMI int fmi3DoStep(fmu_t *x, double t, double h, bool prior, bool *event, bool *terminate, bool *early,
                   double *last)
{
    const double bell = 0.25 * x->bells;
    (void)prior;
    if (x->in_event) return refuse(x, "no step in Event Mode");
    *event = x->pending = bell <= t + h + 1e-9;
    *early = *event && x->early && bell < t + h - 1e-9;
    *last = x->time = *early ? bell : t + h;
    *terminate = false;
    return 0;
}

/* Whether a variable of these clocks may be accessed now. */
static bool open(const fmu_t *x, uint32_t r)
{
    static const int of[] = {FAST, SLOW, BELL};
    if (x->initializing || r == TIME) return true;
    if (r == Y_BOTH) return x->on[FAST] || x->on[SLOW];
    if (r == HEARD) return x->on[BELL];
    if (r == Y_ECHO) return x->on[ECHO];
    return x->on[of[r % 10]];
}

FMI int fmi3SetFloat64(fmu_t *x, const uint32_t *r, size_t n, const double *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++) {
        if (!open(x, r[i])) return refuse(x, "set without a clock");
        if (v[i] > 1e6) return refuse(x, "this input is too large");
        x->u[r[i] - U_FAST] = v[i];
    }
    return 0;
}
FMI int fmi3GetFloat64(fmu_t *x, const uint32_t *r, size_t n, double *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++) {
        if (!open(x, r[i])) return refuse(x, "got without a clock");
        if (r[i] == TIME && x->in_event) return refuse(x, "time is for Step Mode");
        v[i] = x->initializing  ? -1.0
               : r[i] == Y_FAST ? x->fast + x->u[0]
               : r[i] == Y_SLOW ? x->slow + x->u[1]
               : r[i] == Y_BELL ? x->bells + 1
               : r[i] == HEARD  ? x->u[2]
                                : x->time;
    }
    return 0;
}
FMI int fmi3GetInt32(fmu_t *x, const uint32_t *r, size_t n, int32_t *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++) {
        if (!open(x, r[i])) return refuse(x, "got without a clock");
        v[i] = x->initializing ? -1 : x->echoes + 1;
    }
    return 0;
}

FMI int fmi3GetIntervalDecimal(fmu_t *x, const uint32_t *r, size_t n, double *v, int *qualifiers)
{
    for (size_t i = 0; i < n; i++) {
        if (!x->initializing || r[i] > SLOW) return refuse(x, "this interval is not for now");
        v[i] = r[i] == FAST ? 0.1 : 0.3;
        qualifiers[i] = 2; /* changed: it was not known before */
    }
    return 0;
}
FMI int fmi3SetIntervalDecimal(fmu_t *x, const uint32_t *r, size_t n, const double *v)
{
    for (size_t i = 0; i < n; i++)
        if (!x->initializing || r[i] != FAST || v[i] != 0.2) return refuse(x, "no such interval");
    return 0;
}
FMI int fmi3GetShiftDecimal(fmu_t *x, const uint32_t *r, size_t n, double *v)
{
    (void)x;
    for (size_t i = 0; i < n; i++) v[i] = r[i] == FAST ? 0.0 : 0.1;
    return 0;
}

/* What a complete FMU has as well, and nobody calls. */
#include "unused3.h"
#include "saved3.h"
SAVED_FROM(on)
UNUSED(GetIntervalFraction)
UNUSED(GetString)
