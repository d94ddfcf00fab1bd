/* An FMU of FMI 2.0 as small as can be: y_i = u_i + p_i for i < 16, and the time.
 *
 * Value references: u_i = i, p_i = 16 + i, y_i = 32 + i, time = 48. Macros make it behave as FMUs of
 * other tools do: CHDIR changes the working directory, FOREIGN_LOG calls the logger with another
 * environment than it was given, BESIDE calls a function of a second library, REFUSES returns an
 * error where a Real above 100 is set in a step, ANY_TOKEN demands the token ANY_TOKEN.
 */
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#ifdef CHDIR
#include <unistd.h>
#endif

#define FMI __attribute__((visibility("default")))
#ifdef FMI2_FUNCTION_PREFIX
#define PASTE(a, b) a##b
#define PASTED(a, b) PASTE(a, b)
#define NAME(name) PASTED(FMI2_FUNCTION_PREFIX, name)
#else
#define NAME(name) name
#endif
#define TEXT(x) #x
#define TEXT_OF(x) TEXT(x)

typedef void (*log_t)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    log_t log;
    void *allocate, *free, *finished, *environment;
} functions_t;
typedef struct {
    const functions_t *f;
    double v[49];
    int stepping;
} fmu_t;
#ifdef BESIDE
double beside(double x);
#endif

FMI void *NAME(fmi2Instantiate)(const char *name, int kind, const char *token, const char *resources,
                                const functions_t *f, int visible, int logging)
{
    fmu_t *x = calloc(1, sizeof *x);
    (void)name, (void)kind, (void)token, (void)resources, (void)visible, (void)logging;
    x->f = f;
#ifdef ANY_TOKEN
    if (strcmp(token, TEXT_OF(ANY_TOKEN))) return free(x), NULL;
#endif
#ifdef CHDIR
    if (chdir("/")) return free(x), NULL;
#endif
#ifdef FOREIGN_LOG
    static char foreign[8];
    f->log(foreign, name, 0, "logAll", "instantiated %s", "with a foreign pointer");
    f->log((void *)1, name, 0, "logAll", "and with %s", "none at all");
    f->log(NULL, name, 1, "logAll", "and with NULL");
#endif
    return x;
}
FMI void NAME(fmi2FreeInstance)(void *x) { free(x); }
FMI int NAME(fmi2Terminate)(void *x)
{
    (void)x;
    return 0;
}
FMI int NAME(fmi2SetupExperiment)(fmu_t *x, int a, double b, double t, int d, double e)
{
    (void)a, (void)b, (void)d, (void)e;
    x->v[48] = t;
    return 0;
}
FMI int NAME(fmi2EnterInitializationMode)(void *x)
{
    (void)x;
    return 0;
}
FMI int NAME(fmi2ExitInitializationMode)(fmu_t *x)
{
    x->stepping = 1;
    return 0;
}
FMI int NAME(fmi2SetReal)(fmu_t *x, const uint32_t *r, size_t n, const double *v)
{
    for (size_t i = 0; i < n; i++) {
#ifdef REFUSES
        if (x->stepping && v[i] > 100.0) {
            x->f->log(x->f->environment, "x", 3, "logStatusError", "%g is too much", v[i]);
            return 3;
        }
#endif
        x->v[r[i]] = v[i];
    }
    return 0;
}
FMI int NAME(fmi2GetReal)(fmu_t *x, const uint32_t *r, size_t n, double *v)
{
    for (size_t i = 0; i < n; i++) {
        v[i] = x->v[r[i]];
        if (r[i] < 32 || r[i] == 48) continue;
        v[i] = x->v[r[i] - 32] + x->v[r[i] - 16];
#ifdef BESIDE
        v[i] = beside(v[i]);
#endif
    }
    return 0;
}
FMI int NAME(fmi2DoStep)(fmu_t *x, double t, double h, int prior)
{
    (void)prior;
    x->v[48] = t + h;
    return 0;
}

/* What is not called of an FMU with Reals only, but must be there. */
#define ABSENT(name) \
    FMI int NAME(name)(void) { return 3; }
ABSENT(fmi2SetDebugLogging)
ABSENT(fmi2Reset)
ABSENT(fmi2GetInteger)
ABSENT(fmi2GetBoolean)
ABSENT(fmi2GetString)
ABSENT(fmi2SetInteger)
ABSENT(fmi2SetBoolean)
ABSENT(fmi2SetString)
ABSENT(fmi2GetFMUstate)
ABSENT(fmi2SetFMUstate)
ABSENT(fmi2FreeFMUstate)
ABSENT(fmi2SerializedFMUstateSize)
ABSENT(fmi2SerializeFMUstate)
ABSENT(fmi2DeSerializeFMUstate)
ABSENT(fmi2GetDirectionalDerivative)
ABSENT(fmi2SetRealInputDerivatives)
ABSENT(fmi2GetRealOutputDerivatives)
ABSENT(fmi2CancelStep)
ABSENT(fmi2GetStatus)
ABSENT(fmi2GetRealStatus)
ABSENT(fmi2GetIntegerStatus)
ABSENT(fmi2GetBooleanStatus)
ABSENT(fmi2GetStringStatus)
FMI const char *NAME(fmi2GetTypesPlatform)(void) { return "default"; }
FMI const char *NAME(fmi2GetVersion)(void) { return "2.0"; }
