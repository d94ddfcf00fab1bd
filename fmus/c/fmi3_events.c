/* fmi3_events.c - FMI 3.0.2: Event Mode and the clock (clauses 2.2.8, 2.3.5 and 4.2.1).
 *
 * A model that was built with a clock has one, an input of constant interval; its value reference is
 * CLOCK_REFERENCE. Other models have no clocks, and Event Mode only for model exchange.
 */
#include "fmi3.h"
#include "instance.h"

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard's, not needed here */
#endif

static const char NO_EVENTS[] = "this FMU has no event mode";
static const char NO_CLOCKS[] = "this FMU has no clocks";
static const char CONSTANT[] = "the interval of the clock is constant";
static const char NO_FRACTIONS[] = "the clock does not support fractions (supportsFraction)";

static fmi3Status refused(const Instance *x, const char *function, const char *why)
{
    return (fmi3Status)refuse(x, function, "%s", why);
}

/* --- modes -------------------------------------------------------------------------------- */

/* Whether the importer said that it handles events, and the mode fits. */
static int eventful(const Instance *x, unsigned mode, const char *function)
{
    if (!declared.is_clocked || x == NULL || !x->clock.used) {
        refuse(x, function, "%s", declared.is_clocked ? "eventModeUsed is false" : NO_EVENTS);
        return 0;
    }
    return legal(x, mode, function);
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    Instance *x = instance;
    if (!(declared.rates ? legal(x, CONTINUOUS, "fmi3EnterEventMode")
                         : eventful(x, STEPPING, "fmi3EnterEventMode")))
        return fmi3Error;
    x->mode = EVENT;
    return fmi3OK;
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    Instance *x = instance;
    if (!eventful(x, EVENT, "fmi3EnterStepMode")) return fmi3Error;
    if (x->clock.active)
        return refused(x, "fmi3EnterStepMode", "the clock is active, fmi3UpdateDiscreteStates comes first");
    x->mode = STEPPING;
    return fmi3OK;
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance x)
{
    return refused(x, "fmi3EvaluateDiscreteStates",
                   declared.is_clocked ? "this FMU evaluates its states with its outputs" : NO_EVENTS);
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance x, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation,
                                    fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged,
                                    fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime)
{
    static const char function[] = "fmi3UpdateDiscreteStates";
    if (!(declared.rates ? legal(x, EVENT, function) : eventful(x, EVENT, function))) return fmi3Error;
    if (discreteStatesNeedUpdate == NULL || terminateSimulation == NULL ||
        nominalsOfContinuousStatesChanged == NULL || valuesOfContinuousStatesChanged == NULL ||
        nextEventTimeDefined == NULL || nextEventTime == NULL)
        return refused(x, function, "a pointer for the answer is null");
    *discreteStatesNeedUpdate = *terminateSimulation = *nominalsOfContinuousStatesChanged = 0;
    *valuesOfContinuousStatesChanged = *nextEventTimeDefined = 0;
    *nextEventTime = 0.0;
    return declared.rates ? fmi3OK : (fmi3Status)clock_update(x, function);
}

/* --- the clock ---------------------------------------------------------------------------- */

/* Whether all n references are the clock and no pointer is null. */
static int is_clock(const Instance *x, const fmi3ValueReference vr[], size_t n, const void *values,
                    const char *function)
{
    if (n > 0 && (vr == NULL || values == NULL)) {
        refuse(x, function, "%s is null", vr == NULL ? "valueReferences" : "values");
        return 0;
    }
    for (size_t i = 0; i < n; i++) {
        if (declared.is_clocked && vr[i] == CLOCK_REFERENCE) continue;
        if (!declared.is_clocked) refuse(x, function, "this FMU has no variable of type Clock");
        else
            refuse(x, function, "value reference %lu is no clock, expected %u", (unsigned long)vr[i],
                   CLOCK_REFERENCE);
        return 0;
    }
    return 1;
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Clock values[])
{
    const Instance *x = instance;
    if (!legal(x, INITIALIZATION | STEPPING | EVENT | TERMINATED, "fmi3GetClock")) return fmi3Error;
    if (!is_clock(x, vr, n, values, "fmi3GetClock")) return fmi3Error;
    for (size_t i = 0; i < n; i++) values[i] = x->clock.active != 0;
    return fmi3OK;
}

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                        const fmi3Clock values[])
{
    static const char function[] = "fmi3SetClock";
    Instance *x = instance;
    const unsigned modes = declared.is_clocked ? EVENT : INSTANTIATED | INITIALIZATION | STEPPING;
    if (!legal(x, modes, function)) return fmi3Error;
    if (!is_clock(x, vr, n, values, function)) return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        if (values[i]) {
            if (clock_activate(x, function) != STATUS_OK) return fmi3Error;
        } else if (x->clock.active) {
            return refused(x, function, "the clock cannot be deactivated (canBeDeactivated)");
        }
    }
    return fmi3OK;
}

/* Whether interval or shift may be asked for. */
static int askable(const Instance *x, const fmi3ValueReference vr[], size_t n, const void *values,
                   const char *function)
{
    if (!declared.is_clocked) {
        refuse(x, function, "%s", NO_CLOCKS);
        return 0;
    }
    return legal(x, INITIALIZATION | STEPPING | EVENT, function) && is_clock(x, vr, n, values, function);
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance x, const fmi3ValueReference vr[], size_t n,
                                  fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    static const char function[] = "fmi3GetIntervalDecimal";
    if (!askable(x, vr, n, intervals, function)) return fmi3Error;
    if (n > 0 && qualifiers == NULL) return refused(x, function, "qualifiers is null");
    for (size_t i = 0; i < n; i++) {
        intervals[i] = declared.clock_interval;
        qualifiers[i] = fmi3IntervalUnchanged;
    }
    return fmi3OK;
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance x, const fmi3ValueReference vr[], size_t n, fmi3Float64 shifts[])
{
    if (!askable(x, vr, n, shifts, "fmi3GetShiftDecimal")) return fmi3Error;
    for (size_t i = 0; i < n; i++) shifts[i] = 0.0;
    return fmi3OK;
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance x, const fmi3ValueReference vr[], size_t n,
                                   fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[])
{
    return refused(x, "fmi3GetIntervalFraction", declared.is_clocked ? NO_FRACTIONS : NO_CLOCKS);
}

fmi3Status fmi3GetShiftFraction(fmi3Instance x, const fmi3ValueReference vr[], size_t n,
                                fmi3UInt64 counters[], fmi3UInt64 resolutions[])
{
    return refused(x, "fmi3GetShiftFraction", declared.is_clocked ? NO_FRACTIONS : NO_CLOCKS);
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance x, const fmi3ValueReference vr[], size_t n,
                                  const fmi3Float64 intervals[])
{
    return refused(x, "fmi3SetIntervalDecimal", declared.is_clocked ? CONSTANT : NO_CLOCKS);
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance x, const fmi3ValueReference vr[], size_t n,
                                   const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    return refused(x, "fmi3SetIntervalFraction", declared.is_clocked ? CONSTANT : NO_CLOCKS);
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance x, const fmi3ValueReference vr[], size_t n,
                               const fmi3Float64 shifts[])
{
    return refused(x, "fmi3SetShiftDecimal", declared.is_clocked ? CONSTANT : NO_CLOCKS);
}

fmi3Status fmi3SetShiftFraction(fmi3Instance x, const fmi3ValueReference vr[], size_t n,
                                const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    return refused(x, "fmi3SetShiftFraction", declared.is_clocked ? CONSTANT : NO_CLOCKS);
}
