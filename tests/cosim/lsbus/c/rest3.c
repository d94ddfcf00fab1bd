/* Functions of FMI 3.0 that node3.c does not need, for importers that ask for all: they refuse. */
#define REFUSED(name) __attribute__((visibility("default"))) int fmi3##name(void) { return 3; }
REFUSED(GetFloat32) REFUSED(SetFloat32) REFUSED(GetInt8) REFUSED(SetInt8) REFUSED(GetUInt8)
REFUSED(SetUInt8) REFUSED(GetInt16) REFUSED(SetInt16) REFUSED(GetUInt16) REFUSED(SetUInt16)
REFUSED(GetInt32) REFUSED(SetInt32) REFUSED(GetUInt32) REFUSED(SetUInt32) REFUSED(GetInt64)
REFUSED(SetInt64) REFUSED(GetUInt64) REFUSED(SetUInt64) REFUSED(GetString) REFUSED(SetString)
REFUSED(SetDebugLogging) REFUSED(Reset) REFUSED(GetNumberOfVariableDependencies)
REFUSED(GetVariableDependencies) REFUSED(GetFMUState) REFUSED(SetFMUState)
REFUSED(FreeFMUState) REFUSED(SerializedFMUStateSize) REFUSED(SerializeFMUState)
REFUSED(DeserializeFMUState) REFUSED(GetDirectionalDerivative) REFUSED(GetAdjointDerivative)
REFUSED(EnterConfigurationMode) REFUSED(ExitConfigurationMode) REFUSED(GetIntervalFraction)
REFUSED(GetShiftFraction) REFUSED(SetIntervalDecimal) REFUSED(SetIntervalFraction)
REFUSED(SetShiftDecimal) REFUSED(SetShiftFraction) REFUSED(EvaluateDiscreteStates)
REFUSED(EnterContinuousTimeMode) REFUSED(CompletedIntegratorStep) REFUSED(SetTime)
REFUSED(SetContinuousStates) REFUSED(GetContinuousStateDerivatives) REFUSED(GetEventIndicators)
REFUSED(GetContinuousStates) REFUSED(GetNominalsOfContinuousStates)
REFUSED(GetNumberOfEventIndicators) REFUSED(GetNumberOfContinuousStates)
REFUSED(GetOutputDerivatives) REFUSED(ActivateModelPartition)
__attribute__((visibility("default"))) void *fmi3InstantiateModelExchange(void) { return 0; }
__attribute__((visibility("default"))) void *fmi3InstantiateScheduledExecution(void) { return 0; }
__attribute__((visibility("default"))) const char *fmi3GetVersion(void) { return "3.0"; }
