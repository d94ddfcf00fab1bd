/* An FMU of FMI 2.0 for model exchange whose values follow from its parameter `par`: the state x starts
 * at par and decays, the calculated parameter is 2 par. Both are computed when initialization ends.
 * Value references: par 0, twice 1, x 2, der(x) 3, y = x 4. */
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#define FMI __attribute__((visibility("default")))

typedef struct {
    int again, terminate, nominals, values, defined;
    double next;
} info_t;

FMI void *fmi2Instantiate(const char *name, int kind, const char *token, const char *resources,
                          const void *functions, int visible, int logging)
{
    double *v = calloc(5, sizeof *v);
    (void)name, (void)token, (void)resources, (void)functions, (void)visible, (void)logging, (void)kind;
    v[0] = 1.0;
    return v;
}
FMI const char *fmi2GetVersion(void) { return "2.0"; }
FMI void fmi2FreeInstance(void *v) { free(v); }
FMI int fmi2SetupExperiment(void *v, int a, double b, double c, int d, double e)
{
    (void)v, (void)a, (void)b, (void)c, (void)d, (void)e;
    return 0;
}
FMI int fmi2EnterInitializationMode(void *v)
{
    (void)v;
    return 0;
}
FMI int fmi2ExitInitializationMode(double *v)
{
    v[1] = 2.0 * v[0];
    v[2] = v[0];
    return 0;
}
FMI int fmi2EnterEventMode(void *v)
{
    (void)v;
    return 0;
}
FMI int fmi2EnterContinuousTimeMode(void *v)
{
    (void)v;
    return 0;
}
FMI int fmi2Terminate(void *v)
{
    (void)v;
    return 0;
}
FMI int fmi2NewDiscreteStates(void *v, info_t *info)
{
    *info = (info_t){0, 0, 0, 0, 0, 0.0};
    (void)v;
    return 0;
}
FMI int fmi2CompletedIntegratorStep(void *v, int no_set, int *event, int *terminate)
{
    (void)v, (void)no_set;
    return *event = *terminate = 0;
}
FMI int fmi2SetTime(void *v, double t)
{
    (void)v, (void)t;
    return 0;
}
FMI int fmi2SetContinuousStates(double *v, const double *x, size_t n)
{
    (void)n;
    v[2] = x[0];
    return 0;
}
FMI int fmi2GetContinuousStates(const double *v, double *x, size_t n)
{
    (void)n;
    x[0] = v[2];
    return 0;
}
FMI int fmi2GetDerivatives(const double *v, double *d, size_t n)
{
    (void)n;
    d[0] = -v[2];
    return 0;
}
FMI int fmi2GetNominalsOfContinuousStates(void *v, double *x, size_t n)
{
    (void)v, (void)n;
    x[0] = 1.0;
    return 0;
}
FMI int fmi2GetEventIndicators(void *v, double *z, size_t n)
{
    (void)v, (void)z, (void)n;
    return 0;
}
FMI int fmi2SetReal(double *v, const uint32_t *r, size_t n, const double *x)
{
    for (size_t i = 0; i < n; i++) v[r[i]] = x[i];
    return 0;
}
FMI int fmi2GetReal(const double *v, const uint32_t *r, size_t n, double *x)
{
    for (size_t i = 0; i < n; i++) x[i] = r[i] == 3 ? -v[2] : r[i] == 4 ? v[2] : v[r[i]];
    return 0;
}
/* What this FMU cannot do. */
#define REFUSES(name) \
    FMI int name(void) { return 3; }
REFUSES(fmi2SetDebugLogging)
REFUSES(fmi2Reset)
REFUSES(fmi2GetFMUstate)
REFUSES(fmi2SetFMUstate)
REFUSES(fmi2FreeFMUstate)
REFUSES(fmi2SerializedFMUstateSize)
REFUSES(fmi2SerializeFMUstate)
REFUSES(fmi2DeSerializeFMUstate)
REFUSES(fmi2GetDirectionalDerivative)
REFUSES(fmi2GetTypesPlatform)
REFUSES(fmi2GetInteger)
REFUSES(fmi2GetBoolean)
REFUSES(fmi2GetString)
REFUSES(fmi2SetInteger)
REFUSES(fmi2SetBoolean)
REFUSES(fmi2SetString)
