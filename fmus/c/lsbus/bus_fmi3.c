/* bus_fmi3.c - the bus as an FMU of FMI 3.0.2 for co-simulation: the functions that it needs. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bus_fmu.h"

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard's, not needed here */
#endif

static const double PS = 1e-12;

#define REQUIRE(modes)                                                                       \
    do {                                                                                     \
        if (!(x->mode & (modes))) return bus_refuse(x, "%s: not allowed in this mode", __func__); \
    } while (0)

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String token, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
    const fmi3ValueReference required[], size_t nRequired, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback logMessage, fmi3IntermediateUpdateCallback intermediateUpdate) {
    const size_t first = (sizeof(bus_fmu_t) + 15) / 16 * 16, size = bus_room();
    const char *wrong = NULL;
    if (!token || strcmp(token, TOKEN) != 0) wrong = "found another instantiationToken";
    else if (!eventModeUsed) wrong = "found eventModeUsed = false, expected true: clocks tick in it";
    bus_fmu_t *x = wrong ? NULL : calloc(1, first + 2 * size + 16);
    if (!x) {
        if (logMessage)
            logMessage(environment, fmi3Error, "logStatusError", wrong ? wrong : "no memory");
        return NULL;
    }
    uint8_t *start = (uint8_t *)x + first;
    x->log = logMessage, x->environment = environment, x->size = size;
    x->memory = start + (16 - (uintptr_t)start % 16) % 16, x->saved = x->memory + size;
    x->mode = INSTANTIATED;
    bus_begin(x);
    return x;
}

void fmi3FreeInstance(fmi3Instance x) { free(x); }

fmi3Status fmi3SetDebugLogging(fmi3Instance x, fmi3Boolean loggingOn, size_t n,
                               const fmi3String categories[]) {
    return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    bus_fmu_t *x = instance;
    REQUIRE(INSTANTIATED);
    if (startTime != 0.0) return bus_refuse(x, "found startTime %g s, expected 0 s", startTime);
    x->mode = INITIALIZATION;
    return fmi3OK;
}

static fmi3Status change(bus_fmu_t *x, unsigned from, unsigned to, const char *function) {
    if (!(x->mode & from)) return bus_refuse(x, "%s: not allowed in this mode", function);
    x->mode = to;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance x) {
    return change(x, INITIALIZATION, EVENT, __func__);
}

fmi3Status fmi3EnterEventMode(fmi3Instance x) { return change(x, STEPPING, EVENT, __func__); }

fmi3Status fmi3EnterStepMode(fmi3Instance x) { return change(x, EVENT, STEPPING, __func__); }

fmi3Status fmi3Terminate(fmi3Instance x) {
    return change(x, EVENT | STEPPING, TERMINATED, __func__);
}

fmi3Status fmi3Reset(fmi3Instance instance) {
    bus_fmu_t *x = instance;
    x->mode = INSTANTIATED;
    bus_begin(x);
    return fmi3OK;
}

/* The terminal of a value reference of this kind; NULL: it is of another kind. */
static bus_port_t *port(bus_fmu_t *x, fmi3ValueReference vr, uint32_t kind) {
    if (vr < TX_CLOCK || vr > 4 * N_NODES || (vr - 1) % 4 + 1 != kind) return NULL;
    return &x->ports[(vr - 1) / 4];
}

/* --- clocks ---------------------------------------------------------------------------------- */

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                        const fmi3Clock values[]) {
    bus_fmu_t *x = instance;
    REQUIRE(EVENT);
    for (size_t i = 0; i < n; i++) {
        bus_port_t *tx = port(x, vr[i], TX_CLOCK), *rx = port(x, vr[i], RX_CLOCK);
        if (!tx && !rx) return bus_refuse(x, "fmi3SetClock: %u is no clock", (unsigned)vr[i]);
        if (tx) tx->tx_on = values[i];
        if (rx) rx->rx_on = values[i];
    }
    return fmi3OK;
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                        fmi3Clock values[]) {
    return n ? bus_refuse(instance, "fmi3GetClock: found an input clock, expected none") : fmi3OK;
}

/* What is left until a Tx_Clock ticks, ps, and whether it is news. */
static fmi3Status left(bus_fmu_t *x, fmi3ValueReference vr, int64_t *ps,
                       fmi3IntervalQualifier *qualifier) {
    bus_port_t *p = port(x, vr, TX_CLOCK);
    *ps = 0;
    if (!p) return bus_refuse(x, "%u is no clock with an interval", (unsigned)vr);
    *qualifier = p->changed ? fmi3IntervalChanged
                            : p->tick == NEVER ? fmi3IntervalNotYetKnown : fmi3IntervalUnchanged;
    if (p->tick != NEVER && p->tick > x->now) *ps = p->tick - x->now;
    p->changed = false;
    return fmi3OK;
}

static fmi3Status look(bus_fmu_t *x) {
    const fmi3Status status = x->mode & EVENT ? bus_settle(x) : fmi3OK;
    if (status == fmi3OK) bus_schedule(x);
    return status;
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                                  fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[]) {
    bus_fmu_t *x = instance;
    REQUIRE(INITIALIZATION | EVENT);
    fmi3Status status = look(x);
    for (size_t i = 0; i < n && status == fmi3OK; i++) {
        int64_t ps;
        status = left(x, vr[i], &ps, &qualifiers[i]);
        intervals[i] = (double)ps * PS;
    }
    return status;
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                                   fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[]) {
    bus_fmu_t *x = instance;
    REQUIRE(INITIALIZATION | EVENT);
    fmi3Status status = look(x);
    for (size_t i = 0; i < n && status == fmi3OK; i++) {
        int64_t ps;
        status = left(x, vr[i], &ps, &qualifiers[i]);
        counters[i] = (uint64_t)ps, resolutions[i] = 1000000000000u;
    }
    return status;
}

/* --- operations ------------------------------------------------------------------------------ */

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                         const size_t sizes[], const fmi3Binary values[], size_t nValues) {
    bus_fmu_t *x = instance;
    REQUIRE(EVENT);
    if (nValues != n) return bus_refuse(x, "fmi3SetBinary: found %u values", (unsigned)nValues);
    for (size_t i = 0; i < n; i++) {
        bus_port_t *p = port(x, vr[i], RX_DATA);
        if (!p) return bus_refuse(x, "fmi3SetBinary: %u is no Rx_Data", (unsigned)vr[i]);
        if (!p->rx_on) return bus_refuse(x, "fmi3SetBinary: Rx_Clock does not tick");
        if (sizes[i] > ROOM - p->n_rx)
            return bus_refuse(x, "fmi3SetBinary: found %u bytes, expected at most %u",
                              (unsigned)sizes[i], (unsigned)(ROOM - p->n_rx));
        if (sizes[i]) memcpy(p->rx + p->n_rx, values[i], sizes[i]);
        p->n_rx += sizes[i];
    }
    return fmi3OK;
}

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                         size_t sizes[], fmi3Binary values[], size_t nValues) {
    bus_fmu_t *x = instance;
    REQUIRE(INITIALIZATION | EVENT | STEPPING | TERMINATED);
    if (nValues != n) return bus_refuse(x, "fmi3GetBinary: found %u values", (unsigned)nValues);
    for (size_t i = 0; i < n; i++) {
        bus_port_t *tx = port(x, vr[i], TX_DATA), *rx = port(x, vr[i], RX_DATA);
        if (!tx && !rx) return bus_refuse(x, "fmi3GetBinary: %u is no Binary", (unsigned)vr[i]);
        sizes[i] = tx ? (tx->tx_on ? tx->n_tx : 0) : rx->n_rx;
        values[i] = tx ? tx->tx : rx->rx;
    }
    return fmi3OK;
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                          fmi3Boolean values[], size_t nValues) {
    bus_fmu_t *x = instance;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] != NOTIFICATIONS) return bus_refuse(x, "%u is no Boolean", (unsigned)vr[i]);
        values[i] = true;
    }
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                          fmi3Float64 values[], size_t nValues) {
    bus_fmu_t *x = instance;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] != TIME) return bus_refuse(x, "%u is no Float64", (unsigned)vr[i]);
        values[i] = (double)x->now * PS;
    }
    return fmi3OK;
}

/* --- events and steps ------------------------------------------------------------------------ */

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) {
    bus_fmu_t *x = instance;
    REQUIRE(INITIALIZATION | EVENT);
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again,
                                    fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *states, fmi3Boolean *defined,
                                    fmi3Float64 *nextTime) {
    bus_fmu_t *x = instance;
    REQUIRE(EVENT);
    for (int32_t i = 0; i < N_NODES; i++) {
        bus_port_t *p = &x->ports[i];
        if (p->tx_on) p->n_tx = 0, p->tick = NEVER;
        p->tx_on = p->rx_on = false;
    }
    const fmi3Status status = bus_settle(x);
    bus_schedule(x);
    *again = *terminate = *nominals = *states = *defined = false;
    *nextTime = 0.0;
    return status;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean noSetPrior,
                      fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early,
                      fmi3Float64 *last) {
    bus_fmu_t *x = instance;
    REQUIRE(STEPPING);
    if (!(fabs(t - (double)x->now * PS) < 1e-9) || !(h >= 0.0) || !(t + h < 9e6))
        return bus_refuse(x, "fmi3DoStep: found a step from %.12g s of %.12g s, expected one from"
                             " %.12g s", t, h, (double)x->now * PS);
    *event = *terminate = *early = false, *last = t + h;
    const fmi3Status status = bus_go(x, (int64_t)floor((t + h) / PS + 0.5));
    for (int32_t i = 0; i < N_NODES; i++) *event = *event || x->ports[i].n_tx > 0;
    return status;
}
