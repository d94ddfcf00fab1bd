/* The driven van der Pol oscillator of vdp.c for model exchange, FMI 2.0: as little as an importer needs.
 *
 *     x' = v,  v' = mu (1 - x^2) v - omega^2 x + gain u
 */
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#define FMI __attribute__((visibility("default")))
enum { U, X, V, DX, DV, MU, OMEGA2, GAIN };

typedef struct {
    double value[8];
} fmu_t;

typedef struct {
    int needed, end, nominals, values, defined;
    double time;
} event_info_t;

FMI const char *fmi2GetVersion(void) { return "2.0"; }
FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI void *fmi2Instantiate(const char *name, int kind, const char *token, const char *resources,
                          const void *functions, int visible, int logging)
{
    fmu_t *m = calloc(1, sizeof *m);
    (void)name, (void)kind, (void)token, (void)resources, (void)functions, (void)visible;
    (void)logging;
    if (m) m->value[X] = 2.0, m->value[MU] = m->value[OMEGA2] = 1.0, m->value[GAIN] = 0.1;
    return m;
}
FMI void fmi2FreeInstance(void *m) { free(m); }
FMI int fmi2SetDebugLogging(void *m, int on, size_t n, const char *const *categories)
{
    return (void)m, (void)on, (void)n, (void)categories, 0;
}
FMI int fmi2SetupExperiment(void *m, int a, double tolerance, double t0, int b, double t1)
{
    return (void)m, (void)a, (void)tolerance, (void)t0, (void)b, (void)t1, 0;
}
FMI int fmi2EnterInitializationMode(void *m) { return (void)m, 0; }
FMI int fmi2ExitInitializationMode(void *m) { return (void)m, 0; }
FMI int fmi2Terminate(void *m) { return (void)m, 0; }
FMI int fmi2Reset(void *m) { return (void)m, 3; }
FMI int fmi2EnterEventMode(void *m) { return (void)m, 0; }
FMI int fmi2EnterContinuousTimeMode(void *m) { return (void)m, 0; }
FMI int fmi2SetTime(void *m, double t) { return (void)m, (void)t, 0; }
FMI int fmi2NewDiscreteStates(void *m, event_info_t *info)
{
    (void)m;
    info->needed = info->end = info->nominals = info->values = info->defined = 0;
    return 0;
}
FMI int fmi2CompletedIntegratorStep(void *m, int prior, int *event, int *end)
{
    (void)m, (void)prior;
    return *event = *end = 0;
}
FMI int fmi2SetReal(fmu_t *m, const uint32_t *r, size_t n, const double *v)
{
    for (size_t i = 0; i < n; i++) m->value[r[i]] = v[i];
    return 0;
}
static void rates(fmu_t *m)
{
    const double *a = m->value, x = a[X], v = a[V];
    m->value[DX] = v;
    m->value[DV] = a[MU] * (1.0 - x * x) * v - a[OMEGA2] * x + a[GAIN] * a[U];
}
FMI int fmi2GetReal(fmu_t *m, const uint32_t *r, size_t n, double *v)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] == DX || r[i] == DV) rates(m);
        v[i] = m->value[r[i]];
    }
    return 0;
}
FMI int fmi2SetInteger(void *m, const uint32_t *r, size_t n, const int *v)
{
    return (void)m, (void)r, (void)n, (void)v, 0;
}
FMI int fmi2GetInteger(void *m, const uint32_t *r, size_t n, int *v)
{
    return (void)m, (void)r, (void)n, (void)v, 0;
}
FMI int fmi2SetBoolean(void *m, const uint32_t *r, size_t n, const int *v)
{
    return fmi2SetInteger(m, r, n, v);
}
FMI int fmi2GetBoolean(void *m, const uint32_t *r, size_t n, int *v) { return fmi2GetInteger(m, r, n, v); }
FMI int fmi2GetContinuousStates(fmu_t *m, double *x, size_t n)
{
    (void)n;
    return x[0] = m->value[X], x[1] = m->value[V], 0;
}
FMI int fmi2SetContinuousStates(fmu_t *m, const double *x, size_t n)
{
    (void)n;
    return m->value[X] = x[0], m->value[V] = x[1], 0;
}
FMI int fmi2GetDerivatives(fmu_t *m, double *d, size_t n)
{
    (void)n;
    rates(m);
    return d[0] = m->value[DX], d[1] = m->value[DV], 0;
}
FMI int fmi2GetEventIndicators(void *m, double *z, size_t n) { return (void)m, (void)z, (void)n, 0; }
FMI int fmi2GetNominalsOfContinuousStates(void *m, double *x, size_t n)
{
    (void)m, (void)n;
    return x[0] = x[1] = 1.0, 0;
}

/* What it cannot do, but FMPy asks every library for. */
#define ABSENT(name) \
    FMI int name(void) { return 3; }
ABSENT(fmi2GetString)
ABSENT(fmi2SetString)
ABSENT(fmi2GetFMUstate)
ABSENT(fmi2SetFMUstate)
ABSENT(fmi2FreeFMUstate)
ABSENT(fmi2SerializedFMUstateSize)
ABSENT(fmi2SerializeFMUstate)
ABSENT(fmi2DeSerializeFMUstate)
ABSENT(fmi2GetDirectionalDerivative)
