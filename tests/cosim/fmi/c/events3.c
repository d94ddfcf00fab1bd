/* An FMU of FMI 3.0 with event mode, a periodic clock, time events and early return.
 *
 * ticks: of its clock; sampled: its clocked input then; changes: of its discrete input; bells: of
 * its time events, every 0.3 s; integral: of 1 over all steps it did; calls: of doStep.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#define FMI __attribute__((visibility("default")))
enum { CLOCK = 1, SAMPLED_IN, DISCRETE_IN, SAMPLED = 10, TICKS, CHANGES, BELLS, INTEGRAL, CALLS, HALF = 20 };

typedef struct {
    double time, clocked, discrete, sampled, ticks, changes, bells, integral, calls, half;
    bool events, early, started, in_event, ticking, changed, returned;
    int updates;
} fmu_t;

FMI void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                      bool visible, bool logging, bool events, bool early,
                                      const uint32_t *required, size_t n, void *environment, void *log,
                                      void *update)
{
    fmu_t *x = calloc(1, sizeof *x);
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)required, (void)n;
    (void)environment, (void)log, (void)update;
    x->events = events, x->early = early;
    return x;
}
FMI void fmi3FreeInstance(void *x) { free(x); }
FMI int fmi3Terminate(void *x)
{
    (void)x;
    return 0;
}
FMI int fmi3EnterInitializationMode(void *x, bool a, double b, double c, bool d, double e)
{
    (void)x, (void)a, (void)b, (void)c, (void)d, (void)e;
    return 0;
}
FMI int fmi3ExitInitializationMode(fmu_t *x)
{
    x->started = true, x->in_event = x->events;
    return 0;
}
FMI int fmi3EnterEventMode(fmu_t *x)
{
    if (x->in_event) return 3;
    x->in_event = true, x->updates = 0;
    return 0;
}
FMI int fmi3EnterStepMode(fmu_t *x)
{
    if (!x->in_event) return 3;
    x->in_event = false;
    return 0;
}
FMI int fmi3UpdateDiscreteStates(fmu_t *x, bool *again, bool *terminate, bool *nominals, bool *values,
                                 bool *defined, double *next)
{
    if (!x->in_event) return 3;
    if (x->ticking) x->ticks++, x->sampled = x->clocked;
    if (x->changed) x->changes++;
    x->ticking = x->changed = false;
    if (x->time >= (x->bells + 1) * 0.3 - 1e-9) x->bells++;
    *again = x->updates++ == 0; /* twice each time */
    *terminate = *nominals = *values = false;
    *defined = true, *next = (x->bells + 1) * 0.3;
    return 0;
}
FMI int fmi3SetClock(fmu_t *x, const uint32_t *r, size_t n, const bool *v)
{
    if (!x->in_event || n != 1 || *r != CLOCK || !*v) return 3;
    x->ticking = true;
    return 0;
}
FMI int fmi3DoStep(fmu_t *x, double t, double h, bool prior, bool *event, bool *terminate, bool *early,
                   double *last)
{
    (void)prior;
    if (x->in_event) return 3;
    x->calls++;
    *event = *terminate = false;
    *early = x->half && x->early && !x->returned; /* every other call ends half way */
    x->returned = *early;
    *last = *early ? t + h / 2 : t + h;
    x->integral += *last - t;
    x->time = *last;
    *event = *early;
    return 0;
}
FMI int fmi3SetFloat64(fmu_t *x, const uint32_t *r, size_t n, const double *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++)
        if (r[i] == SAMPLED_IN) {
            if (x->started && (!x->in_event || !x->ticking)) return 3;
            x->clocked = v[i];
        } else if (r[i] == DISCRETE_IN) {
            x->changed = true, x->discrete = v[i];
        } else x->half = v[i];
    return 0;
}
FMI int fmi3GetFloat64(fmu_t *x, const uint32_t *r, size_t n, double *v, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++) v[i] = r[i] == HALF ? x->half : (&x->sampled)[r[i] - SAMPLED];
    return 0;
}
#include "saved3.h"
SAVED_FROM(time)
