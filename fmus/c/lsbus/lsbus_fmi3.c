/* lsbus_fmi3.c - the functions of FMI 3.0.2 that an FMU with CAN terminals needs; see lsbus.h. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core.h"

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard's, not needed here */
#endif

static const double PS = 1e-12;
enum { TIME = 4 * N_PORTS + 1 };

#define REQUIRE(modes)                                                                              \
    do {                                                                                            \
        if (!(x->mode & (modes))) return lsbus_refuse(x, "%s: not allowed in this mode", __func__); \
    } while (0)

void lsbus_begin(fmu_t *x)
{
    x->now = 0;
    for (int32_t i = 0; i < N_PORTS; i++) {
        port_t *p = &x->ports[i];
        p->n_rx = p->n_tx = 0, p->tick = NEVER;
        p->rx_on = p->tx_on = p->changed = false;
    }
}

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String token, fmi3String resourcePath,
                                         fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference required[], size_t nRequired,
                                         fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate)
{
    const size_t first = (sizeof(fmu_t) + 15) / 16 * 16;
    const char *wrong = NULL;
    if (!token || strcmp(token, TOKEN) != 0) wrong = "found another instantiationToken";
    else if (!eventModeUsed) wrong = "found eventModeUsed = false, expected true: clocks tick in it";
    fmu_t *x = wrong ? NULL : calloc(1, first + core_room() + 16);
    if (!x) {
        if (logMessage) logMessage(environment, fmi3Error, "logStatusError", wrong ? wrong : "no memory");
        return NULL;
    }
    uint8_t *start = (uint8_t *)x + first;
    x->log = logMessage, x->environment = environment;
    x->room = start + (16 - (uintptr_t)start % 16) % 16;
    x->mode = INSTANTIATED;
    lsbus_begin(x);
    return x;
}

void fmi3FreeInstance(fmi3Instance x) { free(x); }

fmi3Status fmi3SetDebugLogging(fmi3Instance x, fmi3Boolean loggingOn, size_t n, const fmi3String categories[])
{
    return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    fmu_t *x = instance;
    REQUIRE(INSTANTIATED);
    if (startTime != 0.0) return lsbus_refuse(x, "found startTime %g s, expected 0 s", startTime);
    x->mode = INITIALIZATION;
    lsbus_begin(x);
    return core_begin(x);
}

static fmi3Status change(fmu_t *x, unsigned from, unsigned to, const char *function)
{
    if (!(x->mode & from)) return lsbus_refuse(x, "%s: not allowed in this mode", function);
    x->mode = to;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance x) { return change(x, INITIALIZATION, EVENT, __func__); }

fmi3Status fmi3EnterEventMode(fmi3Instance x) { return change(x, STEPPING, EVENT, __func__); }

fmi3Status fmi3EnterStepMode(fmi3Instance x) { return change(x, EVENT, STEPPING, __func__); }

fmi3Status fmi3Terminate(fmi3Instance x) { return change(x, EVENT | STEPPING, TERMINATED, __func__); }

fmi3Status fmi3Reset(fmi3Instance instance)
{
    fmu_t *x = instance;
    x->mode = INSTANTIATED;
    return fmi3OK;
}

/* The terminal of a value reference of this kind; NULL: it is of another kind. */
static port_t *port(fmu_t *x, fmi3ValueReference vr, uint32_t kind)
{
    if (vr < TX_CLOCK || vr > 4 * N_PORTS || (vr - 1) % 4 + 1 != kind) return NULL;
    return &x->ports[(vr - 1) / 4];
}

/* --- clocks ---------------------------------------------------------------------------------- */

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                        const fmi3Clock values[])
{
    fmu_t *x = instance;
    REQUIRE(EVENT);
    for (size_t i = 0; i < n; i++) {
        port_t *tx = port(x, vr[i], TX_CLOCK), *rx = port(x, vr[i], RX_CLOCK);
        if (!tx && !rx) return lsbus_refuse(x, "fmi3SetClock: %u is no clock", (unsigned)vr[i]);
        if (tx) tx->tx_on = values[i];
        if (rx) rx->rx_on = values[i];
    }
    return fmi3OK;
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Clock values[])
{
    return n ? lsbus_refuse(instance, "fmi3GetClock: found an input clock, expected none") : fmi3OK;
}

/* What is left until a Tx_Clock ticks, ps, and whether it is news. */
static fmi3Status left(fmu_t *x, fmi3ValueReference vr, int64_t *ps, fmi3IntervalQualifier *qualifier)
{
    port_t *p = port(x, vr, TX_CLOCK);
    *ps = 0;
    if (!p) return lsbus_refuse(x, "%u is no clock with an interval", (unsigned)vr);
    *qualifier = p->changed         ? fmi3IntervalChanged
                 : p->tick == NEVER ? fmi3IntervalNotYetKnown
                                    : fmi3IntervalUnchanged;
    if (p->tick != NEVER && p->tick > x->now) *ps = p->tick - x->now;
    p->changed = false;
    return fmi3OK;
}

/* The interval i of those asked for in one call, ps. */
static fmi3Status interval(fmu_t *x, const char *function, const fmi3ValueReference vr[], size_t i,
                           int64_t *ps, fmi3IntervalQualifier qualifiers[])
{
    if (!(x->mode & (INITIALIZATION | EVENT)))
        return lsbus_refuse(x, "%s: not allowed in this mode", function);
    const fmi3Status status = i == 0 && x->mode & EVENT ? core_settle(x) : fmi3OK;
    if (status != fmi3OK) return status;
    if (i == 0) core_schedule(x);
    return left(x, vr[i], ps, &qualifiers[i]);
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                                  fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    fmi3Status status = fmi3OK;
    for (size_t i = 0; i < n && status == fmi3OK; i++) {
        int64_t ps = 0;
        status = interval(instance, __func__, vr, i, &ps, qualifiers);
        intervals[i] = (double)ps * PS;
    }
    return status;
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                                   fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[])
{
    fmi3Status status = fmi3OK;
    for (size_t i = 0; i < n && status == fmi3OK; i++) {
        int64_t ps = 0;
        status = interval(instance, __func__, vr, i, &ps, qualifiers);
        counters[i] = (uint64_t)ps, resolutions[i] = 1000000000000u;
    }
    return status;
}

/* --- operations ------------------------------------------------------------------------------ */

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                         const fmi3Binary values[], size_t nValues)
{
    fmu_t *x = instance;
    REQUIRE(EVENT);
    if (nValues != n) return lsbus_refuse(x, "fmi3SetBinary: found %u values", (unsigned)nValues);
    for (size_t i = 0; i < n; i++) {
        port_t *p = port(x, vr[i], RX_DATA);
        if (!p) return lsbus_refuse(x, "fmi3SetBinary: %u is no Rx_Data", (unsigned)vr[i]);
        if (!p->rx_on) return lsbus_refuse(x, "fmi3SetBinary: Rx_Clock does not tick");
        if (sizes[i] > ROOM - p->n_rx)
            return lsbus_refuse(x, "fmi3SetBinary: found %u bytes, expected at most %u", (unsigned)sizes[i],
                                (unsigned)(ROOM - p->n_rx));
        if (sizes[i]) memcpy(p->rx + p->n_rx, values[i], sizes[i]);
        p->n_rx += sizes[i];
    }
    return fmi3OK;
}

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, size_t sizes[],
                         fmi3Binary values[], size_t nValues)
{
    fmu_t *x = instance;
    REQUIRE(INITIALIZATION | EVENT | STEPPING | TERMINATED);
    if (nValues != n) return lsbus_refuse(x, "fmi3GetBinary: found %u values", (unsigned)nValues);
    for (size_t i = 0; i < n; i++) {
        port_t *tx = port(x, vr[i], TX_DATA), *rx = port(x, vr[i], RX_DATA);
        if (!tx && !rx) return lsbus_refuse(x, "fmi3GetBinary: %u is no Binary", (unsigned)vr[i]);
        if (tx && tx->tx_on && x->mode == EVENT && core_tick(x) != fmi3OK) return fmi3Error;
        sizes[i] = tx ? (tx->tx_on ? tx->n_tx : 0) : rx->n_rx;
        values[i] = tx ? tx->tx : rx->rx;
    }
    return fmi3OK;
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                          fmi3Boolean values[], size_t nValues)
{
    fmu_t *x = instance;
    for (size_t i = 0; i < n; i++) {
        if (!core_boolean(x, vr[i], &values[i])) return lsbus_refuse(x, "%u is no Boolean", (unsigned)vr[i]);
    }
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                          fmi3Float64 values[], size_t nValues)
{
    fmu_t *x = instance;
    size_t at = 0;
    REQUIRE(INITIALIZATION | EVENT | STEPPING | TERMINATED);
    for (size_t i = 0; i < n; i++) {
        const double now = (double)x->now * PS, *from = &now;
        const size_t count = vr[i] == TIME ? 1 : core_float64(x, vr[i], &from);
        if (!count) return lsbus_refuse(x, "%u is no Float64", (unsigned)vr[i]);
        if (count > nValues - at) {
            at = nValues + 1;
            break;
        }
        memcpy(values + at, from, count * sizeof *values);
        at += count;
    }
    if (at == nValues) return fmi3OK;
    return lsbus_refuse(x, "fmi3GetFloat64: found nValues = %u, expected another number", (unsigned)nValues);
}

/* --- events and steps ------------------------------------------------------------------------ */

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance)
{
    fmu_t *x = instance;
    REQUIRE(INITIALIZATION | EVENT);
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again, fmi3Boolean *terminate,
                                    fmi3Boolean *nominals, fmi3Boolean *states, fmi3Boolean *defined,
                                    fmi3Float64 *nextTime)
{
    fmu_t *x = instance;
    REQUIRE(EVENT);
    fmi3Status status = fmi3OK;
    for (int32_t i = 0; i < N_PORTS; i++) {
        port_t *p = &x->ports[i];
        if (p->tx_on && status == fmi3OK) status = core_tick(x);
        if (p->tx_on) p->n_tx = 0, p->tick = NEVER;
        p->tx_on = p->rx_on = false;
    }
    if (status == fmi3OK) status = core_settle(x);
    core_schedule(x);
    *again = *terminate = *nominals = *states = *defined = false;
    *nextTime = 0.0;
    return status;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean noSetPrior,
                      fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    fmu_t *x = instance;
    REQUIRE(STEPPING);
    if (!(fabs(t - (double)x->now * PS) < 1e-9) || !(h >= 0.0) || !(t + h < 9e6))
        return lsbus_refuse(x,
                            "fmi3DoStep: found a step from %.12g s of %.12g s, expected one from"
                            " %.12g s",
                            t, h, (double)x->now * PS);
    *event = *terminate = *early = false, *last = t + h;
    const fmi3Status status = core_go(x, (int64_t)floor((t + h) / PS + 0.5));
    for (int32_t i = 0; i < N_PORTS; i++) *event = *event || x->ports[i].n_tx > 0;
    return status;
}
