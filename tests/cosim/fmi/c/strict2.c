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
 * The state x starts at 1 (or as it is told) and is an integral: x' = gain u.
 */
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#define FMI __attribute__((visibility("default")))
enum { NORMAL, RESETS, LATER, IGNORES, JUMPS, RETURNS, ENDS };
enum { MADE = 1, INITIALIZING = 2, STEPPING = 4, FAILED = 8, BROKEN = 16, DEAD = 32, OVER = 64 };
enum { U, GAIN, WHEN, X, Y, RATE, HOW = 10, STATUS };

typedef struct {
    double u, gain, when, x, y, t, rate;
    int how, status, state;
} fmu_t;

static int called(fmu_t *m, const char *name, int allowed)
{
    const char *path = getenv("STRICT_CALLS");
    FILE *file = path ? fopen(path, "a") : NULL;
    const int legal = (m->state & allowed) != 0;
    if (file) {
        fprintf(file, "%s%s\n", name, legal ? "" : " ILLEGAL");
        fclose(file);
    }
    return legal ? 0 : 3;
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
    (void)name, (void)kind, (void)token, (void)resources, (void)functions, (void)visible;
    (void)logging;
    m->state = MADE, m->gain = 2.0, m->x = 1.0, m->how = NORMAL, m->when = 1e9;
    called(m, "Instantiate", MADE);
    return m;
}
FMI void fmi2FreeInstance(fmu_t *m)
{
    called(m, "FreeInstance", ~DEAD);
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
FMI int fmi2DoStep(fmu_t *m, double t, double h, int prior)
{
    const int result = called(m, "DoStep", STEPPING);
    (void)prior;
    if (t >= m->when && m->how >= RETURNS) {
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
        v[i] = r[i] == U ? m->u : r[i] == GAIN ? m->gain : r[i] == WHEN ? m->when
             : r[i] == X ? m->x : r[i] == RATE ? m->rate : y;
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
