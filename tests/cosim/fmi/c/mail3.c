/* An FMU of FMI 3.0 that sends and receives binary values and texts, which insists on the rules.
 *
 * tick: an input clock of 0.2 s; with it the output clock `sent` ticks, and `message` is a byte: how often
 * it has. go: a triggered input clock; it takes `letter`, and `heard` is that and a byte 0xff. Without
 * clocks: `echo` is what `note` is, and `said` is what `word` is, with the number of steps.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FMI __attribute__((visibility("default")))
typedef void (*log_t)(void *, int, const char *, const char *);
enum { TICK = 1, SENT, GO, LETTER = 10, MESSAGE, HEARD, NOTE, ECHO, WORD = 20, SAID };
enum { MADE, INITIALIZING, EVENT, STEP };

typedef struct {
    log_t log;
    void *environment;
    int state, ticks, steps;
    bool events, on[4];
    uint8_t bytes[16][64];
    size_t size[16];
    char word[64], said[80];
} fmu_t;

static int refuse(fmu_t *m, const char *why)
{
    m->log(m->environment, 3, "logStatusError", why);
    return 3;
}

FMI void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                      bool visible, bool logging, bool events, bool early,
                                      const uint32_t *required, size_t n, void *environment, log_t log,
                                      void *update)
{
    fmu_t *m = calloc(1, sizeof *m);
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)early;
    (void)required, (void)n, (void)update;
    m->log = log, m->environment = environment, m->events = events;
    return m;
}
FMI void fmi3FreeInstance(fmu_t *m) { free(m); }
FMI int fmi3Terminate(fmu_t *m)
{
    (void)m;
    return 0;
}
FMI int fmi3EnterInitializationMode(fmu_t *m, bool a, double b, double c, bool d, double e)
{
    (void)a, (void)b, (void)c, (void)d, (void)e;
    m->state = INITIALIZING;
    return 0;
}
FMI int fmi3ExitInitializationMode(fmu_t *m)
{
    m->state = m->events ? EVENT : STEP;
    return 0;
}
FMI int fmi3EnterEventMode(fmu_t *m)
{
    if (m->state != STEP) return refuse(m, "in Event Mode already");
    m->state = EVENT;
    return 0;
}
FMI int fmi3EnterStepMode(fmu_t *m)
{
    m->state = STEP;
    return 0;
}
FMI int fmi3SetClock(fmu_t *m, const uint32_t *r, size_t n, const bool *v)
{
    for (size_t i = 0; i < n; i++) {
        if (m->state != EVENT || r[i] == SENT) return refuse(m, "no clock to set");
        m->on[r[i]] = v[i];
        if (r[i] == TICK) m->bytes[MESSAGE - LETTER][0] = (uint8_t)++m->ticks, m->size[MESSAGE - LETTER] = 1;
    }
    return 0;
}
FMI int fmi3GetClock(fmu_t *m, const uint32_t *r, size_t n, bool *v)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] != SENT || !m->on[TICK]) return refuse(m, "no clock to get");
        v[i] = m->on[SENT] = true;
    }
    return 0;
}
FMI int fmi3UpdateDiscreteStates(fmu_t *m, bool *again, bool *terminate, bool *nominals, bool *values,
                                 bool *defined, double *next)
{
    memset(m->on, 0, sizeof m->on);
    *again = *terminate = *nominals = *values = *defined = false;
    *next = 0.0;
    return 0;
}
FMI int fmi3DoStep(fmu_t *m, double t, double h, bool prior, bool *event, bool *terminate, bool *early,
                   double *last)
{
    (void)prior;
    if (m->state != STEP) return refuse(m, "no step now");
    snprintf(m->said, sizeof m->said, "%s %d", m->word, ++m->steps);
    *event = *terminate = *early = false;
    *last = t + h;
    return 0;
}

static bool closed(const fmu_t *m, uint32_t r)
{
    if (m->state == INITIALIZING) return false;
    if (r == LETTER || r == HEARD) return !m->on[GO];
    if (r == MESSAGE) return !m->on[TICK];
    if (r == NOTE || r == WORD) return m->state != (m->events ? EVENT : STEP);
    return m->state != STEP;
}
FMI int fmi3SetBinary(fmu_t *m, const uint32_t *r, size_t n, const size_t *sizes, const uint8_t *const *v,
                      size_t k)
{
    (void)k;
    for (size_t i = 0; i < n; i++) {
        const int at = (int)r[i] - LETTER;
        if (closed(m, r[i]) || (r[i] != LETTER && r[i] != NOTE)) return refuse(m, "set too early");
        if (sizes[i] > 60) return refuse(m, "too long");
        memcpy(m->bytes[at], v[i], sizes[i]);
        m->size[at] = sizes[i];
        if (r[i] == NOTE) memcpy(m->bytes[ECHO - LETTER], v[i], m->size[ECHO - LETTER] = sizes[i]);
        if (r[i] != LETTER) continue;
        memcpy(m->bytes[HEARD - LETTER], v[i], sizes[i]);
        m->bytes[HEARD - LETTER][sizes[i]] = 0xff;
        m->size[HEARD - LETTER] = sizes[i] + 1;
    }
    return 0;
}
FMI int fmi3GetBinary(fmu_t *m, const uint32_t *r, size_t n, size_t *sizes, const uint8_t **v, size_t k)
{
    (void)k;
    for (size_t i = 0; i < n; i++) {
        if (closed(m, r[i])) return refuse(m, "got too early");
        v[i] = m->bytes[r[i] - LETTER];
        sizes[i] = m->size[r[i] - LETTER];
    }
    return 0;
}
FMI int fmi3SetString(fmu_t *m, const uint32_t *r, size_t n, const char *const *v, size_t k)
{
    (void)k;
    if (n != 1 || closed(m, r[0])) return refuse(m, "set too early");
    snprintf(m->word, sizeof m->word, "%s", v[0]);
    return 0;
}
FMI int fmi3GetString(fmu_t *m, const uint32_t *r, size_t n, const char **v, size_t k)
{
    (void)n, (void)k;
    v[0] = r[0] == WORD ? m->word : m->said;
    return 0;
}
FMI int fmi3SetFloat64(void *m)
{
    (void)m;
    return 3;
} /* never called */
FMI int fmi3GetFloat64(void *m)
{
    (void)m;
    return 3;
}
#include "saved3.h"
SAVED_FROM(state)
