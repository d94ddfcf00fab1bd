/* fmi2_refused.c - functions of FMI 2.0.5 that this FMU exports but does not support.
 *
 * No strings, no derivatives of inputs, no asynchronous steps: the model description says so, and a call is refused in every mode with a message.
 */
#include "fmi2.h"
#include "instance.h"

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard's, not needed here */
#endif

enum { ANY = INSTANTIATED | INITIALIZATION | STEPPING | STEP_FAILED | TERMINATED };

static fmi2Status refused(const Instance *x, const char *function, const char *why)
{
    return (fmi2Status)refuse(x, function, "%s", why);
}

/* A call without value references is allowed. */
static fmi2Status no_strings(const Instance *x, unsigned modes, size_t n, const char *function)
{
    if (!legal(x, modes, function)) return fmi2Error;
    return n == 0 ? fmi2OK : refused(x, function, "this FMU has no variable of type String");
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[])
{
    return no_strings(c, ANY & ~INSTANTIATED, n, "fmi2GetString");
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[])
{
    return no_strings(c, INSTANTIATED | INITIALIZATION | STEPPING, n, "fmi2SetString");
}

static const char NO_INTERPOLATION[] =
    "inputs are held over a step and outputs have no derivatives in this FMU";
static const char NOT_PENDING[] = "steps are never pending in this FMU";

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    return refused(c, "fmi2SetRealInputDerivatives", NO_INTERPOLATION);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    return refused(c, "fmi2GetRealOutputDerivatives", NO_INTERPOLATION);
}

fmi2Status fmi2CancelStep(fmi2Component c) { return refused(c, "fmi2CancelStep", NOT_PENDING); }

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    return refused(c, "fmi2GetStatus", NOT_PENDING);
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    return refused(c, "fmi2GetIntegerStatus", NOT_PENDING);
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    return refused(c, "fmi2GetStringStatus", NOT_PENDING);
}
