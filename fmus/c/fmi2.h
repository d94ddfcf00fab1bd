/* fmi2.h - the functions of FMI 2.0.5 that an FMU exports. */
#ifndef FMI2_H
#define FMI2_H

#include "export.h"
#include "fmi2_types.h"

/* Any mode (clause 2.1) */
EXPORT const char *fmi2GetTypesPlatform(void);
EXPORT const char *fmi2GetVersion(void);
EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t n,
                                      const fmi2String categories[]);
EXPORT fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type type, fmi2String guid,
                                     fmi2String resourceLocation, const fmi2CallbackFunctions *functions,
                                     fmi2Boolean visible, fmi2Boolean loggingOn);
EXPORT void fmi2FreeInstance(fmi2Component c);

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                                      fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime);
EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c);
EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c);
EXPORT fmi2Status fmi2Terminate(fmi2Component c);
EXPORT fmi2Status fmi2Reset(fmi2Component c);

/* Values (clause 2.1.7) */
EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]);
EXPORT fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                 fmi2Integer value[]);
EXPORT fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                 fmi2Boolean value[]);
EXPORT fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]);
EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                              const fmi2Real value[]);
EXPORT fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                 const fmi2Integer value[]);
EXPORT fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                 const fmi2Boolean value[]);
EXPORT fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                const fmi2String value[]);

/* Saved states (clause 2.1.8) and derivatives (2.1.9) */
EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state);
EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state);
EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state);
EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size);
EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size);
EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                          fmi2FMUstate *state);
EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[],
                                               size_t nUnknowns, const fmi2ValueReference knowns[],
                                               size_t nKnowns, const fmi2Real dKnowns[],
                                               fmi2Real dUnknowns[]);

/* Co-simulation (clause 4.2) */
EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                              const fmi2Integer order[], const fmi2Real value[]);
EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                               const fmi2Integer order[], fmi2Real value[]);
EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint,
                             fmi2Real communicationStepSize, fmi2Boolean noSetFMUStatePriorToCurrentPoint);
EXPORT fmi2Status fmi2CancelStep(fmi2Component c);
EXPORT fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value);
/* Not of FMI: the values of an instance by their references. Between steps, inputs may be written and
 * outputs read there, as fmi2SetReal and fmi2GetReal do. */
EXPORT fmi2Real *fmi2_values(fmi2Component c);
/* Not of FMI: fmi2DoStep of n instances from t[0], ... t[m - 1], up to kernel_lanes() instances at once. An
 * instance stops at its first step that is not OK; made[k] is how many steps instance k has made before it. */
EXPORT void fmi2_advance(const fmi2Component c[], size_t n, const fmi2Real t[], size_t m, fmi2Real h,
                         int status[], size_t made[]);
EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value);
EXPORT fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value);
EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value);
EXPORT fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value);

/* Model exchange (clause 3.2) */
EXPORT fmi2Status fmi2EnterEventMode(fmi2Component c);
EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info);
EXPORT fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c);
EXPORT fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetPrior,
                                              fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation);
EXPORT fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time);
EXPORT fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n);
EXPORT fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n);
EXPORT fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n);
EXPORT fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n);
EXPORT fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n);

#endif
