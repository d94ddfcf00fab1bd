/* fmi3_exchange.c - FMI 3.0.2 for model exchange: the entry points (clause 3.2).
 *
 * A model for model exchange has no events: Event Mode is entered where inputs change, or after the start.
 */
#include <stdlib.h>

#include "fmi3.h"
#include "instance.h"

enum { KNOWN = INITIALIZATION | EVENT | CONTINUOUS | TERMINATED };

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    Instance *x = instance;
    if (!exchangeable(x, EVENT, NULL, 0, 0, "fmi3EnterContinuousTimeMode")) return fmi3Error;
    x->mode = CONTINUOUS;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance x, fmi3Boolean noSetPrior, fmi3Boolean *enterEventMode,
                                       fmi3Boolean *terminateSimulation)
{
    static const char function[] = "fmi3CompletedIntegratorStep";
    (void)noSetPrior; /* nothing is kept for going back */
    if (!exchangeable(x, CONTINUOUS, enterEventMode, 1, 1, function)) return fmi3Error;
    if (terminateSimulation == NULL)
        return (fmi3Status)refuse(x, function, "a pointer for the answer is null");
    *enterEventMode = *terminateSimulation = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance x, fmi3Float64 time)
{
    return (fmi3Status)exchange_set_time(x, time, "fmi3SetTime");
}

fmi3Status fmi3SetContinuousStates(fmi3Instance x, const fmi3Float64 states[], size_t n)
{
    return (fmi3Status)exchange_set_states(x, states, n, "fmi3SetContinuousStates");
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance x, fmi3Float64 derivatives[], size_t n)
{
    return (fmi3Status)exchange_get_rates(x, derivatives, n, "fmi3GetContinuousStateDerivatives");
}

fmi3Status fmi3GetEventIndicators(fmi3Instance x, fmi3Float64 indicators[], size_t n)
{
    return exchangeable(x, KNOWN, indicators, n, 0, "fmi3GetEventIndicators") ? fmi3OK : fmi3Error;
}

fmi3Status fmi3GetContinuousStates(fmi3Instance x, fmi3Float64 states[], size_t n)
{
    return (fmi3Status)exchange_get_states(x, states, n, "fmi3GetContinuousStates");
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance x, fmi3Float64 nominals[], size_t n)
{
    return (fmi3Status)exchange_get_nominals(x, nominals, n, "fmi3GetNominalsOfContinuousStates");
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance x, size_t *n)
{
    if (!exchangeable(x, ~0u, n, 1, 1, "fmi3GetNumberOfEventIndicators")) return fmi3Error;
    *n = 0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance x, size_t *n)
{
    if (!exchangeable(x, ~0u, n, 1, 1, "fmi3GetNumberOfContinuousStates")) return fmi3Error;
    *n = declared.n_states;
    return fmi3OK;
}

/* Room for the places of all scalars of some variables; how many these are in *n. */
static unsigned *places_of(const Instance *x, const fmi3ValueReference vr[], size_t count, size_t *n,
                           const char *function)
{
    unsigned *found = malloc((declared.n_scalars + 1) * sizeof *found);
    *n = 0;
    for (size_t i = 0; i < count && found != NULL; i++) {
        const int known = vr[i] < declared.n_variables && (variables[vr[i]].access & IS_REAL);
        if (!known || *n + variables[vr[i]].size > declared.n_scalars) {
            refuse(x, function, "value reference %lu is no Float64, or is there twice", (unsigned long)vr[i]);
            free(found);
            return NULL;
        }
        for (unsigned k = 0; k < variables[vr[i]].size; k++) found[(*n)++] = variables[vr[i]].offset + k;
    }
    return found;
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance x, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                        const fmi3ValueReference knowns[], size_t nKnowns,
                                        const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
                                        size_t nSensitivity)
{
    static const char function[] = "fmi3GetDirectionalDerivative";
    Places of = {NULL, 0}, by = {NULL, 0};
    Status status = STATUS_ERROR;
    if (!exchangeable(x, KNOWN, NULL, 0, 0, function)) return fmi3Error;
    unsigned *first = places_of(x, unknowns, nUnknowns, &of.n, function);
    unsigned *second = first ? places_of(x, knowns, nKnowns, &by.n, function) : NULL;
    of.places = first, by.places = second;
    if (second == NULL) status = STATUS_ERROR;
    else if (nSensitivity != of.n || nSeed != by.n || seed == NULL || sensitivity == NULL)
        status = refuse(x, function, "found %lu seeds and %lu sensitivities, expected %lu and %lu",
                        (unsigned long)nSeed, (unsigned long)nSensitivity, (unsigned long)by.n,
                        (unsigned long)of.n);
    else status = exchange_directional(x, of, by, seed, sensitivity, function);
    free(first);
    free(second);
    return (fmi3Status)status;
}
