/* A ball in FMI 1.0 for model exchange: it falls from 1 m, bounces, and changes colour every 0.3 s.
 *
 * States h and v; the input push accelerates it. It insists on its order of calls.
 */
#define MODEL_IDENTIFIER ball1
#include "fmiModelFunctions.h"

#include <stdlib.h>
#include <string.h>

enum { H, V, PUSH, E, BOUNCES, COLOURS, RED = 10 };
typedef struct {
    fmiCallbackFunctions f;
    double r[6], t, next;
    int started;
} ball_t;

const char *fmiGetModelTypesPlatform(void) { return fmiModelTypesPlatform; }
const char *fmiGetVersion(void) { return fmiVersion; }
fmiStatus fmiSetDebugLogging(fmiComponent c, fmiBoolean on)
{
    (void)c, (void)on;
    return fmiOK;
}

fmiComponent fmiInstantiateModel(fmiString name, fmiString token, fmiCallbackFunctions f, fmiBoolean logging)
{
    ball_t *b;
    (void)logging;
    if (strcmp(token, "{ball}")) {
        f.logger(NULL, name, fmiError, "error", "the token is %s", token);
        return NULL;
    }
    b = f.allocateMemory(1, sizeof *b);
    b->f = f, b->r[H] = 1.0, b->r[E] = 0.7, b->next = 0.3;
    return b;
}
void fmiFreeModelInstance(fmiComponent c) { ((ball_t *)c)->f.freeMemory(c); }
fmiStatus fmiTerminate(fmiComponent c) { return ((ball_t *)c)->started ? fmiOK : fmiError; }
fmiStatus fmiSetTime(fmiComponent c, fmiReal t)
{
    ((ball_t *)c)->t = t;
    return fmiOK;
}

static fmiStatus tell(ball_t *b, fmiEventInfo *info)
{
    memset(info, 0, sizeof *info);
    info->iterationConverged = info->upcomingTimeEvent = fmiTrue;
    info->nextEventTime = b->next;
    return fmiOK;
}
fmiStatus fmiInitialize(fmiComponent c, fmiBoolean controlled, fmiReal tolerance, fmiEventInfo *info)
{
    ball_t *b = c;
    (void)controlled, (void)tolerance;
    b->started = 1;
    return tell(b, info);
}
fmiStatus fmiEventUpdate(fmiComponent c, fmiBoolean intermediate, fmiEventInfo *info)
{
    ball_t *b = c;
    (void)intermediate;
    if (!b->started) return fmiError;
    if (b->r[H] <= 0.0 && b->r[V] < 0.0) {
        b->r[H] = 1e-300, b->r[V] *= -b->r[E];
        b->r[BOUNCES]++;
    }
    if (b->t >= b->next) b->r[COLOURS]++, b->next += 0.3;
    return tell(b, info);
}
fmiStatus fmiCompletedIntegratorStep(fmiComponent c, fmiBoolean *event)
{
    *event = fmiFalse;
    return ((ball_t *)c)->started ? fmiOK : fmiError;
}
fmiStatus fmiSetContinuousStates(fmiComponent c, const fmiReal x[], size_t n)
{
    memcpy(((ball_t *)c)->r, x, n * sizeof *x);
    return n == 2 ? fmiOK : fmiError;
}
fmiStatus fmiGetContinuousStates(fmiComponent c, fmiReal x[], size_t n)
{
    memcpy(x, ((ball_t *)c)->r, n * sizeof *x);
    return n == 2 ? fmiOK : fmiError;
}
fmiStatus fmiGetNominalContinuousStates(fmiComponent c, fmiReal x[], size_t n)
{
    (void)c;
    while (n) x[--n] = 1.0;
    return fmiOK;
}
fmiStatus fmiGetStateValueReferences(fmiComponent c, fmiValueReference r[], size_t n)
{
    (void)c;
    while (n--) r[n] = (fmiValueReference)n;
    return fmiOK;
}
fmiStatus fmiGetDerivatives(fmiComponent c, fmiReal dx[], size_t n)
{
    const ball_t *b = c;
    dx[0] = b->r[V], dx[1] = -9.81 + b->r[PUSH];
    return n == 2 ? fmiOK : fmiError;
}
fmiStatus fmiGetEventIndicators(fmiComponent c, fmiReal z[], size_t n)
{
    z[0] = ((ball_t *)c)->r[H];
    return n == 1 ? fmiOK : fmiError;
}
fmiStatus fmiSetReal(fmiComponent c, const fmiValueReference r[], size_t n, const fmiReal v[])
{
    while (n--) ((ball_t *)c)->r[r[n]] = v[n];
    return fmiOK;
}
fmiStatus fmiGetReal(fmiComponent c, const fmiValueReference r[], size_t n, fmiReal v[])
{
    while (n--) v[n] = ((ball_t *)c)->r[r[n]];
    return fmiOK;
}
fmiStatus fmiGetBoolean(fmiComponent c, const fmiValueReference r[], size_t n, fmiBoolean v[])
{
    while (n--) v[n] = r[n] == RED && (int)((ball_t *)c)->r[COLOURS] % 2;
    return fmiOK;
}
#define ABSENT(name) \
    fmiStatus name(void) { return fmiError; }
ABSENT(fmiSetBoolean)
ABSENT(fmiGetInteger)
ABSENT(fmiSetInteger)
ABSENT(fmiGetString)
ABSENT(fmiSetString)
