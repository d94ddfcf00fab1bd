/* fmi2_exchange.c - FMI 2.0.5 for model exchange: the entry points (clause 3.2).
 *
 * A model for model exchange has no events: Event Mode is entered where inputs change, or after the start.
 */
#include "fmi2.h"
#include "instance.h"

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    Instance *x = c;
    if (!exchangeable(x, CONTINUOUS, NULL, 0, 0, "fmi2EnterEventMode")) return fmi2Error;
    x->mode = EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    if (!exchangeable(c, EVENT, info, 1, 1, "fmi2NewDiscreteStates")) return fmi2Error;
    info->newDiscreteStatesNeeded = info->terminateSimulation = fmi2False;
    info->nominalsOfContinuousStatesChanged = info->valuesOfContinuousStatesChanged = fmi2False;
    info->nextEventTimeDefined = fmi2False;
    info->nextEventTime = 0.0;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    Instance *x = c;
    if (!exchangeable(x, EVENT, NULL, 0, 0, "fmi2EnterContinuousTimeMode")) return fmi2Error;
    x->mode = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetPrior, fmi2Boolean *enterEventMode,
                                       fmi2Boolean *terminateSimulation)
{
    static const char function[] = "fmi2CompletedIntegratorStep";
    (void)noSetPrior; /* nothing is kept for going back */
    if (!exchangeable(c, CONTINUOUS, enterEventMode, 1, 1, function)) return fmi2Error;
    if (terminateSimulation == NULL)
        return (fmi2Status)refuse(c, function, "a pointer for the answer is null");
    *enterEventMode = *terminateSimulation = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    return (fmi2Status)exchange_set_time(c, time, "fmi2SetTime");
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    return (fmi2Status)exchange_set_states(c, x, n, "fmi2SetContinuousStates");
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n)
{
    return (fmi2Status)exchange_get_rates(c, dx, n, "fmi2GetDerivatives");
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n)
{
    return exchangeable(c, INITIALIZATION | EVENT | CONTINUOUS | TERMINATED, z, n, 0,
                        "fmi2GetEventIndicators")
               ? fmi2OK
               : fmi2Error;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    return (fmi2Status)exchange_get_states(c, x, n, "fmi2GetContinuousStates");
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    return (fmi2Status)exchange_get_nominals(c, x, n, "fmi2GetNominalsOfContinuousStates");
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[],
                                        size_t nUnknowns, const fmi2ValueReference knowns[], size_t nKnowns,
                                        const fmi2Real dKnowns[], fmi2Real dUnknowns[])
{
    static const char function[] = "fmi2GetDirectionalDerivative";
    if (!exchangeable(c, INITIALIZATION | EVENT | CONTINUOUS | TERMINATED, NULL, 0, 0, function))
        return fmi2Error;
    if ((nUnknowns > 0 && (unknowns == NULL || dUnknowns == NULL)) ||
        (nKnowns > 0 && (knowns == NULL || dKnowns == NULL)))
        return (fmi2Status)refuse(c, function, "a pointer is null");
    for (size_t i = 0; i < nUnknowns + nKnowns; i++) {
        const fmi2ValueReference r = i < nUnknowns ? unknowns[i] : knowns[i - nUnknowns];
        if (r >= declared.n_scalars || !(scalar_access[r] & IS_REAL))
            return (fmi2Status)refuse(c, function, "value reference %u is no Real", r);
    }
    const Places of = {unknowns, nUnknowns}, by = {knowns, nKnowns};
    return (fmi2Status)exchange_directional(c, of, by, dKnowns, dUnknowns, function);
}
