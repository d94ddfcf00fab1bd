/* lsbus_refused.c - functions of FMI 3.0.2 that every binary must export and this one does not support. */
#include <stdarg.h>
#include <stdio.h>

#include "core.h"

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard's, not needed here */
#endif

fmi3Status lsbus_refuse(fmu_t *x, const char *format, ...)
{
    va_list values;
    va_start(values, format);
    vsnprintf(x->message, sizeof x->message, format, values);
    va_end(values);
    if (x->log) x->log(x->environment, fmi3Error, "logStatusError", x->message);
    return fmi3Error;
}

#define REFUSED(function, ...)                                                                   \
    fmi3Status fmi3##function(fmi3Instance x, __VA_ARGS__)                                       \
    {                                                                                            \
        return lsbus_refuse(x, "fmi3" #function ": not in this FMU, see its model description"); \
    }
#define REFUSED_BARE(function)                                                                   \
    fmi3Status fmi3##function(fmi3Instance x)                                                    \
    {                                                                                            \
        return lsbus_refuse(x, "fmi3" #function ": not in this FMU, see its model description"); \
    }
/* A call without value references is allowed. */
#define GET(T)                                                                                       \
    fmi3Status fmi3Get##T(fmi3Instance x, const fmi3ValueReference vr[], size_t n, fmi3##T values[], \
                          size_t nValues)                                                            \
    {                                                                                                \
        return n ? lsbus_refuse(x, "fmi3Get" #T ": found no such variable") : fmi3OK;                \
    }
#define SET(T)                                                                                             \
    fmi3Status fmi3Set##T(fmi3Instance x, const fmi3ValueReference vr[], size_t n, const fmi3##T values[], \
                          size_t nValues)                                                                  \
    {                                                                                                      \
        return n ? lsbus_refuse(x, "fmi3Set" #T ": found no such variable") : fmi3OK;                      \
    }

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String token, fmi3String resourcePath,
                                          fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback logMessage)
{
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String token,
                                               fmi3String resourcePath, fmi3Boolean visible,
                                               fmi3Boolean loggingOn, fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback logMessage,
                                               fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption)
{
    return NULL;
}

GET(Float32)
SET(Float32)
SET(Float64)
GET(Int8)
SET(Int8)
GET(UInt8)
SET(UInt8)
GET(Int16)
SET(Int16)
GET(UInt16)
SET(UInt16)
GET(Int32)
SET(Int32)
GET(UInt32)
SET(UInt32)
GET(Int64)
SET(Int64)
GET(UInt64)
SET(UInt64)
SET(Boolean)
GET(String)
SET(String)

REFUSED(GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t *n)
REFUSED(GetVariableDependencies, fmi3ValueReference dependent, size_t elementsOfDependent[],
        fmi3ValueReference independents[], size_t elementsOfIndependents[], fmi3DependencyKind kinds[],
        size_t n)
REFUSED(GetFMUState, fmi3FMUState *state)
REFUSED(SetFMUState, fmi3FMUState state)
REFUSED(FreeFMUState, fmi3FMUState *state)
REFUSED(SerializedFMUStateSize, fmi3FMUState state, size_t *size)
REFUSED(SerializeFMUState, fmi3FMUState state, fmi3Byte bytes[], size_t size)
REFUSED(DeserializeFMUState, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
REFUSED(GetDirectionalDerivative, const fmi3ValueReference unknowns[], size_t nUnknowns,
        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
        fmi3Float64 sensitivity[], size_t nSensitivity)
REFUSED(GetAdjointDerivative, const fmi3ValueReference unknowns[], size_t nUnknowns,
        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
        fmi3Float64 sensitivity[], size_t nSensitivity)
REFUSED_BARE(EnterConfigurationMode)
REFUSED_BARE(ExitConfigurationMode)
REFUSED(GetShiftDecimal, const fmi3ValueReference vr[], size_t n, fmi3Float64 shifts[])
REFUSED(GetShiftFraction, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
        fmi3UInt64 resolutions[])
REFUSED(SetIntervalDecimal, const fmi3ValueReference vr[], size_t n, const fmi3Float64 intervals[])
REFUSED(SetIntervalFraction, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
        const fmi3UInt64 resolutions[])
REFUSED(SetShiftDecimal, const fmi3ValueReference vr[], size_t n, const fmi3Float64 shifts[])
REFUSED(SetShiftFraction, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
        const fmi3UInt64 resolutions[])
REFUSED_BARE(EnterContinuousTimeMode)
REFUSED(CompletedIntegratorStep, fmi3Boolean noSetPrior, fmi3Boolean *enterEventMode,
        fmi3Boolean *terminateSimulation)
REFUSED(SetTime, fmi3Float64 time)
REFUSED(SetContinuousStates, const fmi3Float64 states[], size_t n)
REFUSED(GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t n)
REFUSED(GetEventIndicators, fmi3Float64 indicators[], size_t n)
REFUSED(GetContinuousStates, fmi3Float64 states[], size_t n)
REFUSED(GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t n)
REFUSED(GetNumberOfEventIndicators, size_t *n)
REFUSED(GetNumberOfContinuousStates, size_t *n)
REFUSED(GetOutputDerivatives, const fmi3ValueReference vr[], size_t n, const fmi3Int32 orders[],
        fmi3Float64 values[], size_t nValues)
REFUSED(ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 activationTime)
