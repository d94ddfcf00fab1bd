/* An FMU of FMI 2.0 that takes slopes of its inputs: x' = u - x, solved for a line u over a step.
 *
 * A slope is for one step and counts from its start; `slope` is what the last step had, `slopes`
 * how many were set. One above `most` is refused.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define FMI __attribute__((visibility("default")))
enum { U, HELD = 2, COUNT, MOST, X = 10, SLOPE = 12, SLOPES = 14 };
typedef void (*log_t)(void *, const char *, int, const char *, const char *, ...);

typedef struct {
    log_t log;
    void *allocate, *free, *finished, *environment;
} functions_t;
typedef struct {
    const functions_t *f;
    double u[3], slope[2], most, y[5]; /* u, held; x, slope, slopes */
    int count;
} fmu_t;

FMI void *fmi2Instantiate(const char *name, int kind, const char *token, const char *resources,
                          const functions_t *f, int visible, int logging)
{
    fmu_t *x = calloc(1, sizeof *x);
    (void)name, (void)kind, (void)token, (void)resources, (void)visible, (void)logging;
    x->f = f, x->most = 1e9;
    return x;
}
FMI void fmi2FreeInstance(void *x) { free(x); }
FMI int fmi2Terminate(void *x)
{
    (void)x;
    return 0;
}
FMI int fmi2SetupExperiment(void *x, int a, double b, double c, int d, double e)
{
    (void)x, (void)a, (void)b, (void)c, (void)d, (void)e;
    return 0;
}
FMI int fmi2EnterInitializationMode(void *x)
{
    (void)x;
    return 0;
}
FMI int fmi2ExitInitializationMode(void *x)
{
    (void)x;
    return 0;
}
FMI int fmi2SetReal(fmu_t *x, const uint32_t *r, size_t n, const double *v)
{
    for (size_t i = 0; i < n; i++)
        if (r[i] == MOST) x->most = v[i];
        else if (r[i] > HELD) return 3;
        else x->u[r[i]] = v[i];
    return 0;
}
FMI int fmi2SetInteger(fmu_t *x, const uint32_t *r, size_t n, const int *v)
{
    (void)r, (void)n;
    x->count = *v;
    return 0;
}
FMI int fmi2GetReal(fmu_t *x, const uint32_t *r, size_t n, double *v)
{
    for (size_t i = 0; i < n; i++) v[i] = r[i] == MOST ? x->most : x->y[r[i] - X];
    return 0;
}
FMI int fmi2SetRealInputDerivatives(fmu_t *x, const uint32_t *r, size_t n, const int *order, const double *v)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= HELD || order[i] != 1) return 3;
        if (fabs(v[i]) > x->most) {
            x->f->log(x->f->environment, "x", 3, "logStatusError", "a slope of %g", v[i]);
            return 3;
        }
        x->slope[r[i]] = v[i];
        x->y[SLOPES - X] += 1.0;
    }
    return 0;
}
FMI int fmi2DoStep(fmu_t *x, double t, double h, int prior)
{
    const double decay = exp(-h);
    (void)t, (void)prior;
    for (int i = 0; i < 2; i++) {
        double *state = x->y + i;
        *state = decay * *state + (1.0 - decay) * x->u[i] + (h - 1.0 + decay) * x->slope[i];
        x->y[SLOPE - X + i] = x->slope[i];
    }
    memset(x->slope, 0, sizeof x->slope);
    return 0;
}

/* What a complete FMU has as well, and nobody calls. */
#define UNUSED(name) \
    FMI int name(void) { return 3; }
UNUSED(fmi2GetTypesPlatform)
UNUSED(fmi2GetVersion)
UNUSED(fmi2SetDebugLogging)
UNUSED(fmi2Reset)
UNUSED(fmi2GetInteger)
UNUSED(fmi2GetBoolean)
UNUSED(fmi2SetBoolean)
UNUSED(fmi2GetString)
UNUSED(fmi2SetString)
UNUSED(fmi2GetFMUstate)
UNUSED(fmi2SetFMUstate)
UNUSED(fmi2FreeFMUstate)
UNUSED(fmi2SerializedFMUstateSize)
UNUSED(fmi2SerializeFMUstate)
UNUSED(fmi2DeSerializeFMUstate)
UNUSED(fmi2GetDirectionalDerivative)
UNUSED(fmi2GetRealOutputDerivatives)
UNUSED(fmi2CancelStep)
UNUSED(fmi2GetStatus)
UNUSED(fmi2GetRealStatus)
UNUSED(fmi2GetIntegerStatus)
UNUSED(fmi2GetBooleanStatus)
UNUSED(fmi2GetStringStatus)
