/* An FMU of FMI 3.0 that calls back within its steps (3.0.2, 4.2.2), which insists on the rules: two lags
 * x' = u - x in `parts` parts of a step. At both ends of a part it asks for u, and between them it solves
 * the line through the two exactly. `updates` counts the calls, `set` the values set in them. With `slow`
 * 1, a part takes 10 ms, and the FMU returns early if it is asked to; with `fails` 1, it refuses inputs in
 * its second step. Without call-back it holds u.
 */
#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <time.h>

#define FMI __attribute__((visibility("default")))
typedef void (*log_t)(void *, int, const char *, const char *);
typedef void (*within_t)(void *, double, bool, bool, bool, bool, bool *, double *);
enum { U, X = 10, PARTS = 20, SLOW, FAILS, UPDATES = 30, SET, REACHED, N };
enum { MADE, INITIALIZING, STEPPING, WITHIN, IN_STEP };

typedef struct {
    log_t log;
    within_t within;
    void *environment;
    int state;
    bool required, early, can_set;
    double u[2], x[2], value[N];
} fmu_t;

static int refuse(fmu_t *m, const char *why)
{
    m->log(m->environment, 3, "logStatusError", why);
    return 3;
}

FMI void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                      bool visible, bool logging, bool events, bool early,
                                      const uint32_t *required, size_t n, void *environment, log_t log,
                                      within_t within)
{
    fmu_t *m = calloc(1, sizeof *m);
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)events;
    m->log = log, m->environment = environment, m->within = within, m->early = early;
    m->required = n == 1 && required[0] == U;
    m->value[PARTS] = 4.0;
    return m;
}
FMI void fmi3FreeInstance(fmu_t *m) { free(m); }
FMI int fmi3Terminate(fmu_t *m) { return m->state == STEPPING ? 0 : refuse(m, "not in a step"); }
FMI int fmi3EnterInitializationMode(fmu_t *m, bool a, double b, double c, bool d, double e)
{
    (void)a, (void)b, (void)c, (void)d, (void)e;
    m->state = INITIALIZING;
    return 0;
}
FMI int fmi3ExitInitializationMode(fmu_t *m)
{
    m->state = STEPPING;
    return 0;
}

/* Calls back at `time`; returns whether to return early. */
static bool tell(fmu_t *m, double time, bool finished)
{
    bool early = false;
    double until = 0.0;
    m->state = WITHIN, m->can_set = !finished;
    m->value[UPDATES] += 1.0;
    m->within(m->environment, time, !finished, true, finished, m->early && finished, &early, &until);
    m->state = IN_STEP;
    return early;
}
FMI int fmi3DoStep(fmu_t *m, double t, double h, bool prior, bool *event, bool *terminate, bool *early,
                   double *last)
{
    const int parts = (int)m->value[PARTS];
    const double part = h / parts, decay = exp(-part);
    (void)prior;
    if (m->state != STEPPING) return refuse(m, "a step within a step");
    *event = *terminate = *early = false;
    *last = m->value[REACHED] = t + h;
    m->state = IN_STEP;
    for (int k = 0; k < parts; k++) {
        double u[2] = {m->u[0], m->u[1]};
        if (m->within && m->required) {
            tell(m, t + k * part, false);
            u[0] = m->u[0], u[1] = m->u[1];
            tell(m, t + (k + 1) * part, false);
        }
        for (int i = 0; i < 2; i++) {
            const double slope = (m->u[i] - u[i]) / part;
            m->x[i] = u[i] + slope * (part - 1.0) + (m->x[i] - u[i] + slope) * decay;
        }
        if (m->value[SLOW]) {
            const struct timespec moment = {0, 10000000};
            nanosleep(&moment, NULL);
        }
        if (m->within && tell(m, t + (k + 1) * part, true)) {
            *early = true;
            *last = m->value[REACHED] = t + (k + 1) * part;
            break;
        }
    }
    m->state = STEPPING;
    return 0;
}
FMI int fmi3SetFloat64(fmu_t *m, const uint32_t *r, size_t n, const double *v, size_t k)
{
    if (m->state == IN_STEP) return refuse(m, "set in the middle of a step");
    if (m->state == WITHIN) {
        if (!m->can_set) return refuse(m, "set in an update that does not ask for it");
        if (n != 1 || r[0] != U || k != 2) return refuse(m, "set what was not announced");
        if (m->value[FAILS] && m->value[REACHED] > 0.3) return refuse(m, "no such input");
        m->value[SET] += 1.0;
    }
    for (size_t i = 0, at = 0; i < n; i++) {
        if (r[i] == U) m->u[0] = v[at], m->u[1] = v[at + 1], at += 2;
        else m->value[r[i]] = v[at++];
    }
    return 0;
}
FMI int fmi3GetFloat64(fmu_t *m, const uint32_t *r, size_t n, double *v, size_t k)
{
    (void)k;
    if (m->state == IN_STEP) return refuse(m, "got in the middle of a step");
    for (size_t i = 0, at = 0; i < n; i++) {
        if (r[i] == X) v[at] = m->x[0], v[at + 1] = m->x[1], at += 2;
        else if (r[i] == U) v[at] = m->u[0], v[at + 1] = m->u[1], at += 2;
        else v[at++] = m->value[r[i]];
    }
    return 0;
}
#include "saved3.h"
SAVED_FROM(state)
