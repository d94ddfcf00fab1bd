/* An FMU of FMI 3.0 for scheduled execution only (3.0.2, 5.2), which writes down its calls and marks
 * those that the standard does not allow in the state it is in: it has no fmi3DoStep and no events.
 *
 * Its input clocks: third (every 1/30 s), fast (every 0.05 s), tuned (as it is told), mine (as it says:
 * every 3/20 s from 1/20 s on), pulse (changing: after 1/7, 2/7, 1/7, 2/7 s ...), delay (counts down:
 * armed in every third activation of fast, `wait` / 1000 s later), go (triggered from outside). Output
 * clock: done ticks in delay's partition. With `wrong` 1, pulse says that its interval is not known; 2:
 * delay counts down 0 s in its own partition; 3: an activation of fast at 0.2 s fails.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#define FMI __attribute__((visibility("default")))
typedef void (*log_t)(void *, int, const char *, const char *);
typedef void (*update_t)(void *);
typedef void (*lock_t)(void);
enum { THIRD = 1, FAST, TUNED, MINE, PULSE, DELAY, GO, DONE, CLOCKS };
enum { U_FAST = 10, U, WAIT, WRONG, Y_FAST = 20, Y, Y_DONE, AT_DONE, Y_GO, ACTIVATIONS, N };
enum { MADE = 1, INITIALIZING = 2, ACTIVATION = 4, ACTIVE = 8, UPDATE = 16, OVER = 32 };
enum { UNKNOWN, UNCHANGED, CHANGED };

typedef struct {
    log_t log;
    update_t update;
    lock_t lock, unlock;
    void *environment;
    int state;
    bool dirty, done, armed, set[CLOCKS];
    double value[N], last[CLOCKS], now;
    uint64_t counter, pulses;
    int fasts, active;
} fmu_t;

static int called(fmu_t *x, const char *name, double a, double b, int allowed)
{
    const char *path = getenv("SCHEDULED_CALLS");
    FILE *file = path ? fopen(path, "a") : NULL;
    const bool legal = (x->state & allowed) != 0;
    if (file) {
        fprintf(file, "%s %.17g %.17g%s\n", name, a, b, legal ? "" : " ILLEGAL");
        fclose(file);
    }
    return legal ? 0 : 3;
}

FMI void *fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *resources,
                                            bool visible, bool logging, void *environment, log_t log,
                                            update_t update, lock_t lock, lock_t unlock)
{
    fmu_t *x = calloc(1, sizeof *x);
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    x->log = log, x->update = update, x->environment = environment;
    x->lock = lock, x->unlock = unlock, x->state = MADE, x->counter = 1;
    x->value[WAIT] = 20.0;
    for (int i = 0; i < CLOCKS; i++) x->last[i] = -1.0;
    return x;
}
FMI void fmi3FreeInstance(fmu_t *x) { free(x); }
FMI int fmi3Terminate(fmu_t *x)
{
    const int result = called(x, "Terminate", 0, 0, ACTIVATION);
    x->state = OVER;
    return result;
}
FMI int fmi3EnterInitializationMode(fmu_t *x, bool a, double b, double c, bool d, double e)
{
    const int result = called(x, "EnterInitializationMode", 0, 0, MADE);
    (void)a, (void)b, (void)c, (void)d, (void)e;
    x->state = INITIALIZING;
    return result;
}
FMI int fmi3ExitInitializationMode(fmu_t *x)
{
    const int result = called(x, "ExitInitializationMode", 0, 0, INITIALIZING);
    x->state = ACTIVATION;
    return result;
}

static bool inputs_of(const fmu_t *x, uint32_t r)
{
    return x->state != ACTIVATION ? r <= WRONG : r == U_FAST || r == U;
}
FMI int fmi3SetFloat64(fmu_t *x, const uint32_t *r, size_t n, const double *v, size_t k)
{
    (void)k;
    for (size_t i = 0; i < n; i++) {
        if (called(x, "SetFloat64", r[i], v[i], inputs_of(x, r[i]) ? MADE | INITIALIZING | ACTIVATION : 0))
            return 3;
        x->value[r[i]] = v[i];
        x->dirty = x->state == ACTIVATION;
    }
    return 0;
}
FMI int fmi3GetFloat64(fmu_t *x, const uint32_t *r, size_t n, double *v, size_t k)
{
    (void)k;
    for (size_t i = 0; i < n; i++) {
        v[i] = x->value[r[i]];
        if (called(x, "GetFloat64", r[i], v[i], x->dirty ? 0 : INITIALIZING | ACTIVATION | OVER)) return 3;
    }
    return 0;
}
FMI int fmi3GetClock(fmu_t *x, const uint32_t *r, size_t n, bool *v)
{
    for (size_t i = 0; i < n; i++) {
        if (called(x, "GetClock", r[i], 0, r[i] == DONE ? UPDATE : 0)) return 3;
        v[i] = x->done;
        x->done = false; /* only the first call for an activation reports it */
    }
    return 0;
}
FMI int fmi3GetIntervalFraction(fmu_t *x, const uint32_t *r, size_t n, uint64_t *counter,
                                uint64_t *resolution, int *qualifier)
{
    for (size_t i = 0; i < n; i++) {
        const int when = r[i] == MINE    ? INITIALIZING
                         : r[i] == PULSE ? INITIALIZING | ACTIVATION
                         : r[i] == DELAY ? INITIALIZING | UPDATE
                                         : 0;
        if (called(x, "GetIntervalFraction", r[i], 0, when)) return 3;
        counter[i] = r[i] == MINE ? 3 : r[i] == PULSE ? x->pulses % 2 + 1 : (uint64_t)x->value[WAIT];
        resolution[i] = r[i] == MINE ? 20 : r[i] == PULSE ? 7 : 1000;
        qualifier[i] = r[i] != DELAY ? CHANGED : x->armed ? CHANGED : UNCHANGED;
        if (r[i] == PULSE && x->value[WRONG] == 1.0 && x->pulses) qualifier[i] = UNKNOWN;
        if (r[i] == DELAY) x->armed = false;
    }
    return 0;
}
FMI int fmi3GetShiftFraction(fmu_t *x, const uint32_t *r, size_t n, uint64_t *counter, uint64_t *resolution)
{
    for (size_t i = 0; i < n; i++) {
        if (called(x, "GetShiftFraction", r[i], 0, r[i] == MINE ? INITIALIZING : 0)) return 3;
        counter[i] = 1, resolution[i] = 20;
    }
    return 0;
}
FMI int fmi3SetIntervalFraction(fmu_t *x, const uint32_t *r, size_t n, const uint64_t *counter,
                                const uint64_t *resolution)
{
    for (size_t i = 0; i < n; i++)
        if (called(x, "SetIntervalFraction", (double)counter[i], (double)resolution[i],
                   r[i] == TUNED ? INITIALIZING : 0))
            return 3;
    return 0;
}

/* In a partition: the importer is told of clocks. */
static void tell(fmu_t *x)
{
    x->state = UPDATE;
    x->update(x->environment);
    x->state = ACTIVE;
}
FMI int fmi3ActivateModelPartition(fmu_t *x, uint32_t clock, double now)
{
    const bool fine = clock < DONE && now > x->last[clock] && now >= x->now;
    if (called(x, "Activate", clock, now, fine ? ACTIVATION : 0)) return 3;
    x->state = ACTIVE, x->dirty = false, x->last[clock] = x->now = now;
    x->value[ACTIVATIONS] += 1.0;
    x->lock();
    x->value[Y] += x->value[U];
    x->unlock();
    if (clock == FAST) {
        x->value[Y_FAST] = 2.0 * x->value[U_FAST];
        if (x->fasts++ % 3 == 0) x->armed = true, tell(x);
        if (x->value[WRONG] == 3.0 && now >= 0.2) {
            x->log(x->environment, 3, "logStatusError", "no more");
            return 3;
        }
    }
    if (clock == PULSE) x->pulses++;
    if (clock == GO) x->value[Y_GO] = now;
    if (clock == DELAY) {
        x->done = true, x->value[Y_DONE] += 1.0, x->value[AT_DONE] = now;
        if (x->value[WRONG] == 2.0) x->armed = true, x->value[WAIT] = 0.0;
        tell(x);
    }
    x->state = ACTIVATION;
    return 0;
}
#include "saved3.h"
SAVED_FROM(state)
