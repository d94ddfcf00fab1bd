/* An FMU of FMI 2.0 that keeps to the state machine (FMI 2.0.5, 4.2.4) and writes down every call.
 *
 * A call that is not allowed in its state is written with "ILLEGAL" behind it. The file is the one
 * that the environment variable STRICT_CALLS names. What it does besides is in `how`:
 *
 * RESETS      sets its parameters to the defaults in fmi2SetupExperiment, as 20-sim's exporter does
 * LATER       does so in fmi2EnterInitializationMode
 * IGNORES     never takes `gain`
 * JUMPS       gives 0 in Initialization Mode, and `gain` once that is left
 * RETURNS     its fmi2DoStep at `when` returns `status`
 * ENDS        the same with discard, and says that it wants to end the simulation
 * LONG        its fmi2DoStep discards steps longer than `when`
 * Besides, the call that STRICT_REFUSES names ("NAME CALL") returns an error.
 * The state x starts at 1 (or as it is told) and is an integral: x' = gain u.
 */
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FMI __attribute__((visibility("default")))
enum { NORMAL, RESETS, LATER, IGNORES, JUMPS, RETURNS, ENDS, LONG = 8 };
enum { MADE = 1, INITIALIZING = 2, STEPPING = 4, FAILED = 8, BROKEN = 16, DEAD = 32, OVER = 64 };
enum { U, GAIN, WHEN, X, Y, RATE, HOW = 10, STATUS };

typedef struct {
    double u, gain, when, x, y, t, rate, promised;
    int how, status, state, saved;
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

FMI const char *fmi2GetVersion(void) { return "2.0"; }
static void wrote(const char *name, double value)
{
    const char *path = getenv("STRICT_CALLS");
    FILE *file = path ? fopen(path, "a") : NULL;
    if (file) {
        fprintf(file, "%s %.17g\n", name, value);
        fclose(file);
    }
}

FMI void *fmi2Instantiate(const char *name, int kind, const char *token, const char *resources,
                          const void *functions, int visible, int logging)
{
    fmu_t *m = calloc(1, sizeof *m);
    (void)kind, (void)token, (void)resources, (void)functions, (void)visible;
    (void)logging;
    m->state = MADE, m->gain = 2.0, m->x = 1.0, m->how = NORMAL, m->when = 1e9;
    snprintf(m->name, sizeof m->name, "%s", name);
    return called(m, "Instantiate", MADE) ? NULL : m;
}
FMI void fmi2FreeInstance(fmu_t *m)
{
    called(m, m->saved ? "FreeInstance LEAK" : "FreeInstance", ~DEAD);
    if (m->state != DEAD) free(m);
}
FMI int fmi2Terminate(fmu_t *m)
{
    const int result = called(m, "Terminate", STEPPING | FAILED);
    m->state = OVER;
    return result;
}
FMI int fmi2SetupExperiment(fmu_t *m, int a, double tolerance, double t0, int b, double t1)
{
    (void)b, (void)t1;
    if (a) wrote("tolerance", tolerance);
    if (m->how == RESETS) m->gain = 2.0, m->x = 1.0;
    m->t = t0;
    return called(m, "SetupExperiment", MADE);
}
FMI int fmi2EnterInitializationMode(fmu_t *m)
{
    const int result = called(m, "EnterInitializationMode", MADE);
    if (m->how == LATER) m->gain = 2.0, m->x = 1.0;
    m->state = INITIALIZING;
    return result;
}
FMI int fmi2ExitInitializationMode(fmu_t *m)
{
    const int result = called(m, "ExitInitializationMode", INITIALIZING);
    m->y = m->how == JUMPS ? m->gain : m->x;
    m->state = STEPPING;
    return result;
}
static int gap(double a, double b) { return a - b > 1e-9 || b - a > 1e-9; }

/* Saved states: how many there are, and whether one may be gone back to. */
FMI int fmi2GetFMUstate(fmu_t *m, fmu_t **state)
{
    const int result = called(m, "GetFMUstate", MADE | INITIALIZING | STEPPING | FAILED);
    if (!*state) {
        *state = calloc(1, sizeof **state);
        m->saved++;
    }
    **state = *m;
    return result;
}
FMI int fmi2SetFMUstate(fmu_t *m, const fmu_t *state)
{
    const int saved = m->saved, early = !state || state->t < m->promised;
    const int result =
        called(m, early ? "SetFMUstate ILLEGAL" : "SetFMUstate", MADE | INITIALIZING | STEPPING | FAILED);
    if (early) return 3;
    *m = *state;
    m->saved = saved;
    return result;
}
FMI int fmi2FreeFMUstate(fmu_t *m, fmu_t **state)
{
    const int result = called(m, "FreeFMUstate", MADE | INITIALIZING | STEPPING | FAILED | OVER);
    if (*state) m->saved--;
    free(*state);
    *state = NULL;
    return result;
}
FMI int fmi2DoStep(fmu_t *m, double t, double h, int prior)
{
    const int result = called(m, gap(t, m->t) ? "DoStep ILLEGAL" : "DoStep", STEPPING);
    if (prior) m->promised = t;
    if (m->how == LONG && h > m->when) {
        m->state = FAILED;
        return 2;
    }
    if (t >= m->when && (m->how == RETURNS || m->how == ENDS)) {
        const int status = m->how == ENDS ? 2 : m->status;
        m->state = status == 4 ? DEAD : status == 2 ? FAILED : BROKEN;
        return status;
    }
    m->x += h * (m->gain * m->u + m->rate);
    m->y = m->x;
    m->t = t + h;
    return result;
}
FMI int fmi2GetBooleanStatus(fmu_t *m, int kind, int *value)
{
    *value = kind == 3 && m->how == ENDS;
    return called(m, "GetBooleanStatus", STEPPING | FAILED | OVER);
}
FMI int fmi2GetRealStatus(fmu_t *m, int kind, double *value)
{
    *value = kind == 2 ? m->t + 0.025 : -1.0;
    return called(m, "GetRealStatus", STEPPING | FAILED | OVER);
}
FMI int fmi2SetReal(fmu_t *m, const uint32_t *r, size_t n, const double *v)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] == RATE) {
            m->rate = v[i];
            if (called(m, "SetReal rate", MADE | INITIALIZING | STEPPING)) return 3;
            continue;
        }
        const int start = r[i] == GAIN || r[i] == WHEN || r[i] == X;
        if (called(m, start ? "SetReal start" : "SetReal",
                   r[i] == U ? MADE | INITIALIZING | STEPPING : MADE | INITIALIZING))
            return 3;
        if (r[i] == GAIN && m->how == IGNORES) continue;
        *(r[i] == U ? &m->u : r[i] == GAIN ? &m->gain : r[i] == WHEN ? &m->when : &m->x) = v[i];
    }
    return 0;
}
FMI int fmi2GetReal(fmu_t *m, const uint32_t *r, size_t n, double *v)
{
    for (size_t i = 0; i < n; i++) {
        const double y = m->state == INITIALIZING ? m->how == JUMPS ? 0.0 : m->x : m->y;
        v[i] = r[i] == U      ? m->u
               : r[i] == GAIN ? m->gain
               : r[i] == WHEN ? m->when
               : r[i] == X    ? m->x
               : r[i] == RATE ? m->rate
                              : y;
    }
    return called(m, "GetReal", INITIALIZING | STEPPING | FAILED | OVER);
}
FMI int fmi2SetInteger(fmu_t *m, const uint32_t *r, size_t n, const int *v)
{
    for (size_t i = 0; i < n; i++) *(r[i] == HOW ? &m->how : &m->status) = v[i];
    return called(m, "SetInteger", MADE | INITIALIZING);
}
FMI int fmi2GetInteger(fmu_t *m, const uint32_t *r, size_t n, int *v)
{
    for (size_t i = 0; i < n; i++) v[i] = r[i] == HOW ? m->how : m->status;
    return called(m, "GetInteger", INITIALIZING | STEPPING | FAILED | OVER);
}
