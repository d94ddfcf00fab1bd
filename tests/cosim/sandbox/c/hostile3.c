/* An FMU of FMI 3.0 that passes its input on until `when`; then it does what `how` says. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef void (*log_t)(void *, int, const char *, const char *);
enum { NOTHING, LOOP, WILD, EXIT, ABORT, RECURSION, BIG_FRAMES, HUGE, READ, WRITE, CALL, ASK, LIE };
enum { U, Y, WHEN, HOW = 10 };

typedef struct {
    double value[3];
    int32_t how;
    log_t log;
    void *environment;
} fmu_t;

static volatile int depth = 1 << 30;
static volatile bool forever = true;

const char *fmi3GetVersion(void) { return "3.0"; }

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                  bool logging, bool events, bool early, const uint32_t *asked, size_t n,
                                  void *environment, log_t log, void *update)
{
    fmu_t *x = calloc(1, sizeof *x);
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)asked,
        (void)n;
    (void)update;
    if (strcmp(token, "t")) return NULL;
    x->log = log, x->environment = environment;
    return x;
}
void fmi3FreeInstance(void *x) { free(x); }
int fmi3EnterInitializationMode(void *x, bool a, double b, double c, bool d, double e)
{
    (void)x, (void)a, (void)b, (void)c, (void)d, (void)e;
    return 0;
}
int fmi3ExitInitializationMode(void *x) { return (void)x, 0; }
int fmi3Terminate(void *x) { return (void)x, 0; }

int fmi3GetFloat64(fmu_t *x, const uint32_t *vr, size_t n, double *values, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++) values[i] = x->value[vr[i]];
    return 0;
}
int fmi3SetFloat64(fmu_t *x, const uint32_t *vr, size_t n, const double *values, size_t m)
{
    (void)m;
    for (size_t i = 0; i < n; i++) x->value[vr[i]] = values[i];
    return 0;
}
int fmi3GetInt32(fmu_t *x, const uint32_t *vr, size_t n, int32_t *values, size_t m)
{
    (void)vr, (void)m;
    for (size_t i = 0; i < n; i++) values[i] = x->how;
    return 0;
}
int fmi3SetInt32(fmu_t *x, const uint32_t *vr, size_t n, const int32_t *values, size_t m)
{
    (void)vr, (void)n, (void)m;
    x->how = values[0];
    return 0;
}

static int (*volatile again)(int);
static int deeper(int left) { return left == 0 ? 0 : again(left - 1) ^ depth; }

static int wider(volatile int left)
{
    volatile char frame[1 << 16];
    memset((char *)frame, left, sizeof frame);
    return left == 0 ? 0 : wider(left - 1) + frame[left & 0xffff];
}

static int huge(void)
{
    for (;;) {
        volatile char *more = malloc(1 << 24);
        if (more == NULL) return 4;
        for (size_t i = 0; i < 1 << 24; i += 4096) more[i] = 1;
    }
}

static double opened(const char *path, const char *mode)
{
    FILE *file = fopen(path, mode);
    if (file == NULL) return -1.0;
    fclose(file);
    return 1.0;
}

int fmi3DoStep(fmu_t *x, double t, double h, bool prior, bool *event, bool *ended, bool *early, double *last)
{
    (void)prior;
    *event = *ended = *early = false;
    *last = t + h;
    x->value[Y] = x->value[U] + t;
    if (t < x->value[WHEN] || x->how == NOTHING) return 0;
    x->log(x->environment, 1, "logStatusWarning", "last words");
    switch (x->how) {
    case LOOP:
        while (forever) {}
        return 0;
    case WILD: return *(volatile int *)(uintptr_t)0xfffffff0u;
    case EXIT: exit(7);
    case ABORT: abort();
    case RECURSION: again = deeper; return deeper(depth);
    case BIG_FRAMES: return wider(depth);
    case HUGE: return huge();
    case READ: x->value[Y] = opened("/etc/passwd", "r"); return 0;
    case WRITE: x->value[Y] = opened("/tmp/written-by-an-fmu", "w"); return 0;
    case CALL:
        return ((int (*)(int, int, int, int, int, int))(uintptr_t)*(volatile int *)&depth)(1, 2, 3, 4, 5, 6);
    case ASK: x->value[Y] = getenv("PATH") == NULL ? -1.0 : 1.0; return 0;
    case LIE: return 77;
    }
    return 0;
}
