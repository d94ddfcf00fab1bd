/* host.c - an importer in C for the sanitizers: both APIs, right and wrong calls, many instances.
 *
 * Linked with the sources of one model. Prints nothing and returns 0 when every call was answered
 * as expected; memory errors, undefined behaviour and leaks are for the sanitizers to tell.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2.h"
#include "fmi3.h"
#include "model.h"

#define EXPECT(condition)                                                      \
    do {                                                                       \
        if (!(condition)) {                                                    \
            fprintf(stderr, "host.c:%d: expected %s\n", __LINE__, #condition); \
            exit(1);                                                           \
        }                                                                      \
    } while (0)

enum { STEPS = 300, CYCLES = 200, N_ALL = N_SCALARS + 1 };

static int logged; /* of this host, not of the FMU */

static void listen2(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                    fmi2String category, fmi2String message, ...)
{
    (void)environment, (void)status;
    logged += strlen(name) + strlen(category) + strlen(message) > 0;
}

static void listen3(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                    fmi3String message)
{
    (void)environment, (void)status;
    logged += strlen(category) + strlen(message) > 0;
}

/* Value references of scalars (2.0) that may be set in steps. */
static size_t inputs2(fmi2ValueReference vr[])
{
    size_t n = 0;
    for (unsigned i = 0; i < N_SCALARS; i++)
        if (scalar_access[i] & SET_IN_STEPS) vr[n++] = i;
    return n;
}

static size_t reals2(fmi2ValueReference vr[])
{
    size_t n = 0;
    for (unsigned i = 0; i < N_ALL; i++)
        if (scalar_access[i] & IS_REAL) vr[n++] = i;
    return n;
}

static fmi2Component new2(void)
{
    static const fmi2CallbackFunctions callbacks = {listen2, calloc, free, NULL, NULL};
    fmi2Component c =
        fmi2Instantiate("host", fmi2CoSimulation, declared.token, NULL, &callbacks, fmi2False, fmi2True);
    EXPECT(c != NULL);
    return c;
}

static void run2(void)
{
    fmi2ValueReference in[N_ALL], all[N_ALL];
    fmi2Real u[N_ALL] = {0}, y[N_ALL], again[N_ALL];
    const size_t nu = inputs2(in), ny = reals2(all);
    fmi2FMUstate state = NULL, copy = NULL;
    fmi2Component c = new2();
    EXPECT(fmi2SetupExperiment(c, fmi2False, 0, 0, fmi2True, 10) == fmi2OK);
    EXPECT(fmi2EnterInitializationMode(c) == fmi2OK);
    EXPECT(fmi2GetReal(c, all, ny, y) == fmi2OK);
    EXPECT(fmi2ExitInitializationMode(c) == fmi2OK);
    for (int k = 0; k < STEPS; k++) {
        for (size_t i = 0; i < nu; i++) u[i] = sin(0.1 * k + (double)i);
        EXPECT(fmi2SetReal(c, in, nu, u) == fmi2OK);
        EXPECT(fmi2DoStep(c, k * 1e-3, 1e-3, fmi2False) == fmi2OK);
        if (k == STEPS - 2) EXPECT(fmi2GetFMUstate(c, &state) == fmi2OK);
    }
    EXPECT(fmi2GetReal(c, all, ny, y) == fmi2OK);
    size_t size = 0;
    EXPECT(fmi2SerializedFMUstateSize(c, state, &size) == fmi2OK);
    fmi2Byte *bytes = malloc(size);
    EXPECT(fmi2SerializeFMUstate(c, state, bytes, size) == fmi2OK);
    EXPECT(fmi2DeSerializeFMUstate(c, bytes, size, &copy) == fmi2OK);
    EXPECT(fmi2SetFMUstate(c, copy) == fmi2OK);
    EXPECT(fmi2SetReal(c, in, nu, u) == fmi2OK);
    EXPECT(fmi2DoStep(c, (STEPS - 1) * 1e-3, 1e-3, fmi2False) == fmi2OK);
    EXPECT(fmi2GetReal(c, all, ny, again) == fmi2OK);
    EXPECT(memcmp(y, again, ny * sizeof y[0]) == 0);
    EXPECT(fmi2FreeFMUstate(c, &state) == fmi2OK && fmi2FreeFMUstate(c, &copy) == fmi2OK);
    EXPECT(fmi2Terminate(c) == fmi2OK);
    free(bytes);
    fmi2FreeInstance(c);
}

/* Whatever is called in whatever order: an answer, no crash. */
static void wrong2(void)
{
    fmi2ValueReference vr[3] = {0, N_ALL, 4000000000u};
    fmi2Real value[3] = {NAN, INFINITY, 1e308};
    fmi2Integer integer[3] = {0};
    fmi2Boolean boolean[3] = {0};
    fmi2String text[3] = {"", NULL, "x"};
    fmi2FMUstate state = NULL;
    size_t size;
    fmi2Component c = new2();
    unsigned seed = 12345;
    for (int n = 0; n < 20000; n++) {
        seed = seed * 1103515245u + 12345u;
        const fmi2Component it = seed >> 28 ? c : NULL;
        const size_t count = seed >> 10 & 3;
        switch (seed >> 16 & 31) {
        case 0: fmi2SetupExperiment(it, 0, 0, value[count % 3], 1, value[0]); break;
        case 1: fmi2SetupExperiment(it, 0, 0, 0, 0, 0); break;
        case 2: fmi2EnterInitializationMode(it); break;
        case 3: fmi2ExitInitializationMode(it); break;
        case 4: fmi2DoStep(it, 0, 1e-3, 1); break;
        case 5: fmi2DoStep(it, value[count % 3], value[n % 3], 0); break;
        case 6: fmi2Terminate(it); break;
        case 7: fmi2Reset(it); break;
        case 8: fmi2GetReal(it, vr, count % 3, value + 3 - count % 3); break;
        case 9: fmi2SetReal(it, vr, count % 3, value); break;
        case 10: fmi2GetInteger(it, vr, count % 3, integer); break;
        case 11: fmi2SetInteger(it, vr, count % 3, integer); break;
        case 12: fmi2GetBoolean(it, vr, count % 3, boolean); break;
        case 13: fmi2SetBoolean(it, vr, count % 3, boolean); break;
        case 14: fmi2GetString(it, vr, count % 3, text); break;
        case 15: fmi2SetDebugLogging(it, (int)count & 1, count % 3, text); break;
        case 16: fmi2GetFMUstate(it, &state); break;
        case 17: fmi2SetFMUstate(it, state); break;
        case 18: fmi2FreeFMUstate(it, &state); break;
        case 19: fmi2SerializedFMUstateSize(it, state, &size); break;
        case 20: fmi2SerializeFMUstate(it, state, (fmi2Byte *)value, sizeof value); break;
        case 21: fmi2DeSerializeFMUstate(it, (fmi2Byte *)value, sizeof value, &state); break;
        case 22: fmi2GetReal(it, NULL, count, NULL); break;
        case 23: fmi2SetReal(it, vr, 1, NULL); break;
        case 24: fmi2GetRealStatus(it, fmi2LastSuccessfulTime, value); break;
        case 25: fmi2CancelStep(it); break;
        case 26: fmi2NewDiscreteStates(it, NULL); break;
        case 27: fmi2GetDirectionalDerivative(it, vr, 1, vr, 1, value, value); break;
        case 28: fmi2SetFMUstate(it, NULL); break;
        default: fmi2SetReal(it, vr, 1, value + 2); break;
        }
        value[0] = NAN, value[1] = INFINITY, value[2] = 1e308;
    }
    fmi2FreeFMUstate(c, &state);
    fmi2FreeInstance(c);
    fmi2FreeInstance(NULL);
}

static fmi3Instance new3(void)
{
    fmi3Instance x = fmi3InstantiateCoSimulation("host", declared.token, NULL, fmi3False, fmi3True, fmi3False,
                                                 fmi3True, NULL, 0, NULL, listen3, NULL);
    EXPECT(x != NULL);
    return x;
}

static size_t references3(fmi3ValueReference vr[], unsigned access, size_t *size)
{
    size_t n = 0;
    *size = 0;
    for (unsigned i = 0; i <= N_VARIABLES; i++)
        if ((variables[i].access & access) == access) {
            vr[n++] = i;
            *size += variables[i].size;
        }
    return n;
}

static void run3(void)
{
    fmi3ValueReference in[N_ALL], all[N_ALL];
    fmi3Float64 u[N_ALL] = {0}, y[N_ALL], last;
    fmi3Boolean event, terminate, early;
    size_t su, sy;
    const size_t nu = references3(in, SET_IN_STEPS, &su), ny = references3(all, IS_REAL, &sy);
    fmi3FMUState state = NULL;
    fmi3Instance x = new3();
    EXPECT(fmi3EnterInitializationMode(x, fmi3False, 0, 0, fmi3False, 0) == fmi3OK);
    EXPECT(fmi3GetFloat64(x, all, ny, y, sy) == fmi3OK);
    EXPECT(fmi3ExitInitializationMode(x) == fmi3OK);
    for (int k = 0; k < STEPS; k++) {
        for (size_t i = 0; i < su; i++) u[i] = sin(0.1 * k + (double)i);
        EXPECT(fmi3SetFloat64(x, in, nu, u, su) == fmi3OK);
        EXPECT(fmi3DoStep(x, k * 1e-3, 1e-3, fmi3True, &event, &terminate, &early, &last) == fmi3OK);
        EXPECT(fmi3GetFloat64(x, all, ny, y, sy) == fmi3OK);
        EXPECT(fmi3GetFMUState(x, &state) == fmi3OK);
    }
    u[0] = NAN;
    EXPECT(fmi3SetFloat64(x, in, nu, u, su) == fmi3OK);
    EXPECT(fmi3DoStep(x, STEPS * 1e-3, 1e-3, fmi3True, &event, &terminate, &early, &last) == fmi3Discard);
    EXPECT(fmi3SetFloat64(x, in, nu, u, su + 1) == fmi3Error);
    EXPECT(fmi3GetFloat64(x, all, ny, y, sy - 1) == fmi3Error);
    EXPECT(fmi3DoStep(x, 0, 1, fmi3True, NULL, NULL, NULL, NULL) == fmi3Error);
    EXPECT(fmi3EnterEventMode(x) == fmi3Error);
    EXPECT(fmi3SetFMUState(x, state) == fmi3OK);
    EXPECT(fmi3FreeFMUState(x, &state) == fmi3OK);
    EXPECT(fmi3Terminate(x) == fmi3OK);
    EXPECT(fmi3Reset(x) == fmi3OK);
    fmi3FreeInstance(x);
}

/* Saved bytes, one bit wrong each: refused, and never read beyond their end. */
static void damage3(void)
{
    fmi3FMUState state = NULL, copy = NULL;
    size_t size;
    fmi3Instance x = new3();
    EXPECT(fmi3GetFMUState(x, &state) == fmi3OK);
    EXPECT(fmi3SerializedFMUStateSize(x, state, &size) == fmi3OK);
    fmi3Byte *bytes = malloc(size);
    EXPECT(fmi3SerializeFMUState(x, state, bytes, size) == fmi3OK);
    for (size_t i = 0; i < 8 * size; i++) {
        bytes[i / 8] ^= (fmi3Byte)(1 << i % 8);
        EXPECT(fmi3DeserializeFMUState(x, bytes, size, &copy) == fmi3Error);
        bytes[i / 8] ^= (fmi3Byte)(1 << i % 8);
    }
    for (size_t n = 0; n < size; n++) {
        fmi3Byte *part = malloc(n + 1);
        memcpy(part, bytes, n);
        EXPECT(fmi3DeserializeFMUState(x, part, n, &copy) == fmi3Error);
        free(part);
    }
    EXPECT(fmi3DeserializeFMUState(x, bytes, size, &copy) == fmi3OK);
    EXPECT(fmi3FreeFMUState(x, &state) == fmi3OK && fmi3FreeFMUState(x, &copy) == fmi3OK);
    free(bytes);
    fmi3FreeInstance(x);
}

int main(void)
{
    run2();
    wrong2();
    run3();
    damage3();
    for (int n = 0; n < CYCLES; n++) {
        fmi2FreeInstance(new2());
        fmi3FreeInstance(new3());
    }
    EXPECT(fmi2Instantiate("host", fmi2CoSimulation, "wrong", NULL, NULL, 0, 0) == NULL);
    EXPECT(logged > 0);
    return 0;
}
