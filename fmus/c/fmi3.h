/* fmi3.h - the functions of FMI 3.0.2 that an FMU exports. */
#ifndef FMI3_H
#define FMI3_H

#include "export.h"
#include "fmi3_types.h"

#define FMI3(function) EXPORT fmi3Status fmi3##function

/* Any kind of FMU (clause 2.3) */
EXPORT const char *fmi3GetVersion(void);
FMI3(SetDebugLogging)(fmi3Instance x, fmi3Boolean loggingOn, size_t n, const fmi3String categories[]);
EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String token,
                                                 fmi3String resourcePath, fmi3Boolean visible,
                                                 fmi3Boolean loggingOn, fmi3InstanceEnvironment environment,
                                                 fmi3LogMessageCallback logMessage);
EXPORT fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String token, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
    const fmi3ValueReference requiredIntermediateVariables[], size_t nRequiredIntermediateVariables,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback logMessage,
    fmi3IntermediateUpdateCallback intermediateUpdate);
EXPORT fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String instanceName, fmi3String token, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3InstanceEnvironment environment, fmi3LogMessageCallback logMessage,
    fmi3ClockUpdateCallback clockUpdate, fmi3LockPreemptionCallback lockPreemption,
    fmi3UnlockPreemptionCallback unlockPreemption);
EXPORT void fmi3FreeInstance(fmi3Instance x);
FMI3(EnterInitializationMode)(fmi3Instance x, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                              fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime);
FMI3(ExitInitializationMode)(fmi3Instance x);
FMI3(EnterEventMode)(fmi3Instance x);
FMI3(Terminate)(fmi3Instance x);
FMI3(Reset)(fmi3Instance x);

/* Values (clause 2.2.6.2): of each type T, fmi3Get<T> and fmi3Set<T> */
#define FMI3_VALUES(T)                                                                                       \
    FMI3(Get##T)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, fmi3##T values[], size_t nValues); \
    FMI3(Set##T)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, const fmi3##T values[],            \
                 size_t nValues);
FMI3_VALUES(Float32)
FMI3_VALUES(Float64)
FMI3_VALUES(Int8)
FMI3_VALUES(UInt8)
FMI3_VALUES(Int16)
FMI3_VALUES(UInt16)
FMI3_VALUES(Int32)
FMI3_VALUES(UInt32)
FMI3_VALUES(Int64)
FMI3_VALUES(UInt64)
FMI3_VALUES(Boolean)
FMI3_VALUES(String)
FMI3(GetBinary)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary values[],
                size_t nValues);
FMI3(SetBinary)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                const fmi3Binary values[], size_t nValues);
FMI3(GetClock)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, fmi3Clock values[]);
FMI3(SetClock)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, const fmi3Clock values[]);

/* Dependencies, saved states, derivatives (2.2.9 to 2.2.11) */
FMI3(GetNumberOfVariableDependencies)(fmi3Instance x, fmi3ValueReference vr, size_t *n);
FMI3(GetVariableDependencies)(fmi3Instance x, fmi3ValueReference dependent, size_t elementsOfDependent[],
                              fmi3ValueReference independents[], size_t elementsOfIndependents[],
                              fmi3DependencyKind kinds[], size_t n);
FMI3(GetFMUState)(fmi3Instance x, fmi3FMUState *state);
FMI3(SetFMUState)(fmi3Instance x, fmi3FMUState state);
FMI3(FreeFMUState)(fmi3Instance x, fmi3FMUState *state);
FMI3(SerializedFMUStateSize)(fmi3Instance x, fmi3FMUState state, size_t *size);
FMI3(SerializeFMUState)(fmi3Instance x, fmi3FMUState state, fmi3Byte bytes[], size_t size);
FMI3(DeserializeFMUState)(fmi3Instance x, const fmi3Byte bytes[], size_t size, fmi3FMUState *state);
FMI3(GetDirectionalDerivative)(fmi3Instance x, const fmi3ValueReference unknowns[], size_t nUnknowns,
                               const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                               size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity);
FMI3(GetAdjointDerivative)(fmi3Instance x, const fmi3ValueReference unknowns[], size_t nUnknowns,
                           const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                           size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity);

/* Configuration and event mode, clocks (2.3) */
FMI3(EnterConfigurationMode)(fmi3Instance x);
FMI3(ExitConfigurationMode)(fmi3Instance x);
FMI3(GetIntervalDecimal)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, fmi3Float64 intervals[],
                         fmi3IntervalQualifier qualifiers[]);
FMI3(GetIntervalFraction)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
                          fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[]);
FMI3(GetShiftDecimal)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, fmi3Float64 shifts[]);
FMI3(GetShiftFraction)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
                       fmi3UInt64 resolutions[]);
FMI3(SetIntervalDecimal)(fmi3Instance x, const fmi3ValueReference vr[], size_t n,
                         const fmi3Float64 intervals[]);
FMI3(SetIntervalFraction)(fmi3Instance x, const fmi3ValueReference vr[], size_t n,
                          const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]);
FMI3(SetShiftDecimal)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, const fmi3Float64 shifts[]);
FMI3(SetShiftFraction)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
                       const fmi3UInt64 resolutions[]);
FMI3(EvaluateDiscreteStates)(fmi3Instance x);
FMI3(UpdateDiscreteStates)(fmi3Instance x, fmi3Boolean *discreteStatesNeedUpdate,
                           fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
                           fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                           fmi3Float64 *nextEventTime);

/* Model exchange (clause 3) */
FMI3(EnterContinuousTimeMode)(fmi3Instance x);
FMI3(CompletedIntegratorStep)(fmi3Instance x, fmi3Boolean noSetPrior, fmi3Boolean *enterEventMode,
                              fmi3Boolean *terminateSimulation);
FMI3(SetTime)(fmi3Instance x, fmi3Float64 time);
FMI3(SetContinuousStates)(fmi3Instance x, const fmi3Float64 states[], size_t n);
FMI3(GetContinuousStateDerivatives)(fmi3Instance x, fmi3Float64 derivatives[], size_t n);
FMI3(GetEventIndicators)(fmi3Instance x, fmi3Float64 indicators[], size_t n);
FMI3(GetContinuousStates)(fmi3Instance x, fmi3Float64 states[], size_t n);
FMI3(GetNominalsOfContinuousStates)(fmi3Instance x, fmi3Float64 nominals[], size_t n);
FMI3(GetNumberOfEventIndicators)(fmi3Instance x, size_t *n);
FMI3(GetNumberOfContinuousStates)(fmi3Instance x, size_t *n);

/* Co-simulation (clause 4), scheduled execution (5) */
FMI3(EnterStepMode)(fmi3Instance x);
FMI3(GetOutputDerivatives)(fmi3Instance x, const fmi3ValueReference vr[], size_t n, const fmi3Int32 orders[],
                           fmi3Float64 values[], size_t nValues);
FMI3(DoStep)(fmi3Instance x, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
             fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
             fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime);
/* Not of FMI: the values of an instance (NULL: a structural parameter decides), and where a variable has its own: from the entry that is
 * returned on, one a scalar. Between steps, inputs may be written and outputs read there, as
 * fmi3SetFloat64 and fmi3GetFloat64 do. */
EXPORT fmi3Float64 *fmi3_values(fmi3Instance c);
EXPORT size_t fmi3_place(fmi3ValueReference reference, size_t *size);
/* Not of FMI: fmi3DoStep of n instances from t[0], ... t[m - 1], up to kernel_lanes() instances at once. An
 * instance stops at its first step that is not OK; made[k] is how many steps instance k has made before it. */
EXPORT void fmi3_advance(const fmi3Instance c[], size_t n, const fmi3Float64 t[], size_t m, fmi3Float64 h,
                         int status[], size_t made[]);
FMI3(ActivateModelPartition)(fmi3Instance x, fmi3ValueReference clock, fmi3Float64 activationTime);

#endif
