/* An FMU of FMI 2.0 that passes its input on, in four types, until `when`; then does what `how`
 * says. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FMI __attribute__((visibility("default")))
typedef void (*log_t)(void *, const char *, int, const char *, const char *, ...);
enum { OK, CRASH, HANG, NOT_A_NUMBER, LEAK, DISCARD, ERROR, FATAL, EXIT, NO_START, SAY };

typedef struct {
    log_t log;
    void *(*allocate)(size_t, size_t);
    void (*free)(void *);
    void *finished, *environment;
} functions_t;
typedef struct {
    const functions_t *f;
    double u, y, when, sum;
    int how, count, flag, mode, given[3];
    char label[80];
} fmu_t;

FMI void *fmi2Instantiate(const char *name, int kind, const char *token, const char *resources,
                          const functions_t *f, int visible, int logging)
{
    fmu_t *x = calloc(1, sizeof *x);
    (void)kind, (void)token, (void)resources, (void)visible;
    x->f = f;
    strcpy(x->label, "nothing");
    if (logging) f->log(f->environment, name, 0, "logAll", "%s is %s", name, "made");
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
FMI int fmi2EnterInitializationMode(fmu_t *x)
{
    if (x->how == NO_START) abort();
    return 0;
}
FMI int fmi2ExitInitializationMode(void *x)
{
    (void)x;
    return 0;
}

static int leak(fmu_t *x)
{
    for (;;) {
        volatile char *more = malloc(1 << 24); /* volatile: what nobody reads is still written */
        if (!more) {
            x->f->log(x->f->environment, "x", 4, "logStatusFatal", "no memory left");
            return 4;
        }
        for (size_t i = 0; i < 1 << 24; i += 4096) more[i] = 1;
    }
}

FMI int fmi2DoStep(fmu_t *x, double t, double h, int prior)
{
    static volatile int forever = 1;
    static int *volatile nowhere;
    (void)prior;
    x->sum += h * x->u;
    x->y = x->u + x->sum;
    x->given[0] = x->count, x->given[1] = x->flag, x->given[2] = x->mode;
    if (x->how == SAY) {
        static const char *const line = "one of many lines that an FMU may write when it is told";
        for (int i = 0; i < 100; i++) x->f->log(x->f->environment, "x", 1, "chat", "%s %d", line, i);
    }
    if (t < x->when || x->how == OK || x->how == SAY) return 0;
    if (x->how == CRASH) {
        x->f->log(x->f->environment, "x", 1, "logStatusWarning", "going down at %g", t);
        return *nowhere;
    }
    while (x->how == HANG && forever) {}
    if (x->how == NOT_A_NUMBER) x->y = NAN;
    if (x->how == LEAK) return leak(x);
    if (x->how == EXIT) exit(7);
    if (x->how >= DISCARD && x->how <= FATAL) {
        x->f->log(x->f->environment, "x", x->how - 3, "logStatusError", "no step from %g on", t);
        return x->how - 3;
    }
    return 0;
}
FMI int fmi2SetReal(fmu_t *x, const uint32_t *r, size_t n, const double *v)
{
    for (size_t i = 0; i < n; i++) *(r[i] == 2 ? &x->when : &x->u) = v[i];
    return 0;
}
FMI int fmi2GetReal(fmu_t *x, const uint32_t *r, size_t n, double *v)
{
    for (size_t i = 0; i < n; i++) v[i] = r[i] == 2 ? x->when : x->y;
    return 0;
}
FMI int fmi2SetInteger(fmu_t *x, const uint32_t *r, size_t n, const int *v)
{
    for (size_t i = 0; i < n; i++) *(r[i] == 3 ? &x->how : r[i] == 5 ? &x->mode : &x->count) = v[i];
    return 0;
}
FMI int fmi2GetInteger(fmu_t *x, const uint32_t *r, size_t n, int *v)
{
    for (size_t i = 0; i < n; i++) v[i] = r[i] == 3 ? x->how : x->given[r[i] == 15 ? 2 : 0];
    return 0;
}
FMI int fmi2SetBoolean(fmu_t *x, const uint32_t *r, size_t n, const int *v)
{
    (void)r, (void)n;
    x->flag = *v;
    return 0;
}
FMI int fmi2GetBoolean(fmu_t *x, const uint32_t *r, size_t n, int *v)
{
    (void)r, (void)n;
    *v = x->given[1];
    return 0;
}
FMI int fmi2SetString(fmu_t *x, const uint32_t *r, size_t n, const char *const *v)
{
    (void)r, (void)n;
    snprintf(x->label, sizeof x->label, "%s", *v);
    return 0;
}
FMI int fmi2GetString(fmu_t *x, const uint32_t *r, size_t n, const char **v)
{
    (void)r, (void)n;
    *v = x->label;
    return 0;
}
