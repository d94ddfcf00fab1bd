/* strict2.c for FMI 3.0 (3.0.2, 4.2.1), with event mode if the importer uses it. Here
 *
 * LATER   sets the parameters to their defaults in fmi3EnterInitializationMode
 * JUMPS   gives 0 until the initial Event Mode is left (without one: Initialization Mode)
 * RETURNS its fmi3DoStep at `when` returns `status`
 * ENDS    its fmi3DoStep at `when` asks for the end after half of the step
 * EVENT   an event at `when`, in its step, asks for the end; at when < 0: the one at the start
 * LONG    its fmi3DoStep discards steps longer than `when`
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FMI __attribute__((visibility("default")))
typedef void (*log_t)(void *, int, const char *, const char *);
enum { NORMAL, LATER = 2, IGNORES, JUMPS, RETURNS, ENDS, EVENT, LONG };
enum { MADE = 1, INITIALIZING = 2, STEPPING = 4, IN_EVENT = 8, BROKEN = 16, DEAD = 32, OVER = 64 };
enum { U, GAIN, WHEN, X, Y, RATE, HOW = 10, STATUS };

typedef struct {
    double u, gain, when, x, y, t, rate, promised;
    int32_t how, status;
    int state, saved;
    bool events, ending;
    char name[40];
} fmu_t;

/* Whether STRICT_REFUSES is the name of the instance and of the call. */
static int refuses(const fmu_t *m, const char *call)
{
    const char *wanted = getenv("STRICT_REFUSES");
    char both[80];
    snprintf(both, sizeof both, "%s %s", m->name, call);
    return wanted && !strcmp(wanted, both);
}

static int called(fmu_t *m, const char *name, int allowed)
{
    const char *path = getenv("STRICT_CALLS");
    FILE *file = path ? fopen(path, "a") : NULL;
    const int legal = (m->state & allowed) != 0;
    if (file) {
        fprintf(file, "%s%s\n", name, legal ? "" : " ILLEGAL");
        fclose(file);
    }
    return legal && !refuses(m, name) ? 0 : 3;
}

static void wrote(const char *name, double value)
{
    const char *path = getenv("STRICT_CALLS");
    FILE *file = path ? fopen(path, "a") : NULL;
    if (file) {
        fprintf(file, "%s %.17g\n", name, value);
        fclose(file);
    }
}

FMI void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                      bool visible, bool logging, bool events, bool early,
                                      const uint32_t *required, size_t n, void *environment, log_t log,
                                      void *update)
{
    fmu_t *m = calloc(1, sizeof *m);
    (void)token, (void)resources, (void)visible, (void)logging, (void)early;
    (void)required, (void)n, (void)environment, (void)log, (void)update;
    m->state = MADE, m->gain = 2.0, m->x = 1.0, m->when = 1e9, m->events = events;
    snprintf(m->name, sizeof m->name, "%s", name);
    return called(m, "Instantiate", MADE) ? NULL : m;
}
FMI void fmi3FreeInstance(fmu_t *m)
{
    called(m, m->saved ? "FreeInstance LEAK" : "FreeInstance", ~DEAD);
    if (m->state != DEAD) free(m);
}
FMI int fmi3Terminate(fmu_t *m)
{
    const int result = called(m, "Terminate", STEPPING | IN_EVENT);
    m->state = OVER;
    return result;
}
FMI int fmi3EnterInitializationMode(fmu_t *m, bool a, double tolerance, double t0, bool b, double t1)
{
    const int result = called(m, "EnterInitializationMode", MADE);
    (void)b, (void)t1;
    if (a) wrote("tolerance", tolerance);
    if (m->how == LATER) m->gain = 2.0, m->x = 1.0;
    m->state = INITIALIZING, m->t = t0;
    return result;
}
static void begin(fmu_t *m)
{
    m->y = m->how == JUMPS ? m->gain : m->x;
    m->state = STEPPING;
}
FMI int fmi3ExitInitializationMode(fmu_t *m)
{
    const int result = called(m, "ExitInitializationMode", INITIALIZING);
    begin(m);
    if (m->events) m->state = IN_EVENT, m->y = 0.0, m->ending = m->how == EVENT && m->when < 0.0;
    return result;
}
FMI int fmi3EnterEventMode(fmu_t *m)
{
    const int result = called(m, "EnterEventMode", STEPPING);
    m->state = IN_EVENT;
    return result;
}
FMI int fmi3UpdateDiscreteStates(fmu_t *m, bool *again, bool *terminate, bool *nominals, bool *values,
                                 bool *defined, double *next)
{
    *again = *nominals = *values = *defined = false, *next = 0.0;
    *terminate = m->ending;
    return called(m, "UpdateDiscreteStates", IN_EVENT);
}
FMI int fmi3EnterStepMode(fmu_t *m)
{
    const int result = called(m, "EnterStepMode", IN_EVENT);
    if (m->t > 0.0) m->state = STEPPING;
    else begin(m);
    return result;
}
static int gap(double a, double b) { return a - b > 1e-9 || b - a > 1e-9; }

/* Saved states: how many there are, and whether one may be gone back to. */
FMI int fmi3GetFMUState(fmu_t *m, fmu_t **state)
{
    const int result = called(m, "GetFMUState", MADE | INITIALIZING | STEPPING | IN_EVENT);
    if (!*state) {
        *state = calloc(1, sizeof **state);
        m->saved++;
    }
    **state = *m;
    return result;
}
FMI int fmi3SetFMUState(fmu_t *m, const fmu_t *state)
{
    const int saved = m->saved, early = !state || state->t < m->promised;
    const int result =
        called(m, early ? "SetFMUState ILLEGAL" : "SetFMUState", MADE | INITIALIZING | STEPPING | IN_EVENT);
    if (early) return 3;
    *m = *state;
    m->saved = saved;
    return result;
}
FMI int fmi3FreeFMUState(fmu_t *m, fmu_t **state)
{
    const int result = called(m, "FreeFMUState", MADE | INITIALIZING | STEPPING | IN_EVENT | OVER);
    if (*state) m->saved--;
    free(*state);
    *state = NULL;
    return result;
}
FMI int fmi3DoStep(fmu_t *m, double t, double h, bool prior, bool *event, bool *terminate, bool *early,
                   double *last)
{
    const int result = called(m, gap(t, m->t) ? "DoStep ILLEGAL" : "DoStep", STEPPING);
    if (prior) m->promised = t;
    *event = *terminate = *early = false;
    *last = t + h;
    if (m->how == LONG && h > m->when) return 2;
    if (t >= m->when && m->how == RETURNS) {
        m->state = m->status == 4 ? DEAD : m->status == 2 ? STEPPING : BROKEN;
        return m->status;
    }
    if (t >= m->when && m->how == ENDS) *terminate = true, *last = t + h / 2.0;
    if (t >= m->when && m->how == EVENT) *event = m->ending = true;
    m->x += h * (m->gain * m->u + m->rate);
    m->y = m->x;
    m->t = t + h;
    return result;
}
FMI int fmi3SetFloat64(fmu_t *m, const uint32_t *r, size_t n, const double *v, size_t k)
{
    (void)k;
    for (size_t i = 0; i < n; i++) {
        if (r[i] == RATE) {
            m->rate = v[i];
            if (called(m, "SetFloat64 rate", MADE | INITIALIZING | (m->events ? IN_EVENT : STEPPING)))
                return 3;
            continue;
        }
        const int start = r[i] == GAIN || r[i] == WHEN || r[i] == X;
        if (called(m, start ? "SetFloat64 start" : "SetFloat64",
                   r[i] == U ? MADE | INITIALIZING | STEPPING : MADE | INITIALIZING))
            return 3;
        if (r[i] == GAIN && m->how == IGNORES) continue;
        *(r[i] == U ? &m->u : r[i] == GAIN ? &m->gain : r[i] == WHEN ? &m->when : &m->x) = v[i];
    }
    return 0;
}
FMI int fmi3GetFloat64(fmu_t *m, const uint32_t *r, size_t n, double *v, size_t k)
{
    (void)k;
    for (size_t i = 0; i < n; i++) {
        const double y = m->state == INITIALIZING ? m->how == JUMPS ? 0.0 : m->x : m->y;
        v[i] = r[i] == U      ? m->u
               : r[i] == GAIN ? m->gain
               : r[i] == WHEN ? m->when
               : r[i] == X    ? m->x
               : r[i] == RATE ? m->rate
                              : y;
    }
    return called(m, "GetFloat64", INITIALIZING | STEPPING | IN_EVENT | OVER);
}
FMI int fmi3SetInt32(fmu_t *m, const uint32_t *r, size_t n, const int32_t *v, size_t k)
{
    (void)k;
    for (size_t i = 0; i < n; i++) *(r[i] == HOW ? &m->how : &m->status) = v[i];
    return called(m, "SetInt32", MADE | INITIALIZING);
}
FMI int fmi3GetInt32(fmu_t *m, const uint32_t *r, size_t n, int32_t *v, size_t k)
{
    (void)k;
    for (size_t i = 0; i < n; i++) v[i] = r[i] == HOW ? m->how : m->status;
    return called(m, "GetInt32", INITIALIZING | STEPPING | IN_EVENT | OVER);
}
