/* fmi2_refused.c - functions of FMI 2.0.5 that this FMU exports but does not support.
 *
 * No strings, no derivatives, no asynchronous steps, no model exchange: the model description says
 * so, and a call is refused in every mode with a message.
 */
#include "fmi2.h"
#include "instance.h"

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard's, not needed here */
#endif

enum { ANY = INSTANTIATED | INITIALIZATION | STEPPING | STEP_FAILED | TERMINATED };

static fmi2Status refused(const Instance *x, const char *function, const char *why) {
    return (fmi2Status)refuse(x, function, "%s", why);
}

/* A call without value references is allowed. */
static fmi2Status no_strings(const Instance *x, unsigned modes, size_t n, const char *function) {
    if (!legal(x, modes, function)) return fmi2Error;
    return n == 0 ? fmi2OK : refused(x, function, "this FMU has no variable of type String");
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                         fmi2String value[]) {
    return no_strings(c, ANY & ~INSTANTIATED, n, "fmi2GetString");
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                         const fmi2String value[]) {
    return no_strings(c, INSTANTIATED | INITIALIZATION | STEPPING, n, "fmi2SetString");
}

static const char NO_DERIVATIVES[] = "this FMU provides no directional derivatives";
static const char NO_INTERPOLATION[] =
    "inputs are held over a step and outputs have no derivatives in this FMU";
static const char NOT_PENDING[] = "steps are never pending in this FMU";
static const char NO_MODEL_EXCHANGE[] = "this FMU is for co-simulation, not model exchange";

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[],
                                        size_t nUnknowns, const fmi2ValueReference knowns[],
                                        size_t nKnowns, const fmi2Real dKnowns[],
                                        fmi2Real dUnknowns[]) {
    return refused(c, "fmi2GetDirectionalDerivative", NO_DERIVATIVES);
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    return refused(c, "fmi2SetRealInputDerivatives", NO_INTERPOLATION);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    return refused(c, "fmi2GetRealOutputDerivatives", NO_INTERPOLATION);
}

fmi2Status fmi2CancelStep(fmi2Component c) { return refused(c, "fmi2CancelStep", NOT_PENDING); }

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    return refused(c, "fmi2GetStatus", NOT_PENDING);
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    return refused(c, "fmi2GetIntegerStatus", NOT_PENDING);
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    return refused(c, "fmi2GetStringStatus", NOT_PENDING);
}

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    return refused(c, "fmi2EnterEventMode", NO_MODEL_EXCHANGE);
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    return refused(c, "fmi2NewDiscreteStates", NO_MODEL_EXCHANGE);
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    return refused(c, "fmi2EnterContinuousTimeMode", NO_MODEL_EXCHANGE);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetPrior,
                                       fmi2Boolean *enterEventMode,
                                       fmi2Boolean *terminateSimulation) {
    return refused(c, "fmi2CompletedIntegratorStep", NO_MODEL_EXCHANGE);
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    return refused(c, "fmi2SetTime", NO_MODEL_EXCHANGE);
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    return refused(c, "fmi2SetContinuousStates", NO_MODEL_EXCHANGE);
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
    return refused(c, "fmi2GetDerivatives", NO_MODEL_EXCHANGE);
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
    return refused(c, "fmi2GetEventIndicators", NO_MODEL_EXCHANGE);
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    return refused(c, "fmi2GetContinuousStates", NO_MODEL_EXCHANGE);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    return refused(c, "fmi2GetNominalsOfContinuousStates", NO_MODEL_EXCHANGE);
}
