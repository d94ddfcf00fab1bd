/* fmi3.c - FMI 3.0.2 for co-simulation: the entry points.
 *
 * Clauses 2.3 and 4.2.1 say which function may be called in which state. There is no configuration mode and no
 * intermediate update; Event Mode and the clock are in fmi3_events.c. A value reference is the
 * place of a variable in the declaration, declared.n_variables is the time; arrays are row-major.
 */
#include "fmi3.h"

#include "instance.h"

enum {
    LIVE = STEPPING | EVENT | CONTINUOUS,
    ANY = INSTANTIATED | CONFIGURATION | INITIALIZATION | LIVE | TERMINATED,
    READ = CONFIGURATION | INITIALIZATION | LIVE | TERMINATED,
    WRITE = INSTANTIATED | CONFIGURATION | INITIALIZATION | LIVE
};

/* --- life cycle --------------------------------------------------------------------------- */

const char *fmi3GetVersion(void) { return "3.0"; }

static void forward(const Instance *x, Status status, const char *category, const char *text)
{
    const fmi3LogMessageCallback log = (fmi3LogMessageCallback)x->callback;
    log(x->environment, (fmi3Status)status, category, text);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance x, fmi3Boolean loggingOn, size_t n, const fmi3String categories[])
{
    if (!legal(x, ANY, "fmi3SetDebugLogging")) return fmi3Error;
    return (fmi3Status)set_logging(x, loggingOn, n, categories, "fmi3SetDebugLogging");
}

/* An instance; or, if `impossible` is a message, NULL after logging it. */
static fmi3Instance instantiate(fmi3String name, fmi3String token, fmi3Boolean loggingOn,
                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                const char *impossible, const char *function)
{
    Instance *x = instance_new(name, token, loggingOn, forward, (AnyFunction *)log, environment, function);
    if (x == NULL || impossible == NULL) return x;
    refuse(x, function, "%s", impossible);
    instance_free(x);
    return NULL;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String token, fmi3String resourcePath,
                                         fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate)
{
    (void)resourcePath, (void)visible; /* nothing to read, nothing to show */
    (void)earlyReturnAllowed;          /* allowed, never done */
    (void)requiredIntermediateVariables, (void)nRequiredIntermediateVariables;
    (void)intermediateUpdate; /* none provided */
    const char *impossible = declared.rates ? "this FMU is for model exchange, not co-simulation"
                             : eventModeUsed && !declared.is_clocked
                                 ? "this FMU has no event mode: eventModeUsed must be false"
                                 : NULL;
    Instance *x = instantiate(instanceName, token, loggingOn, environment, logMessage, impossible,
                              "fmi3InstantiateCoSimulation");
    if (x != NULL) x->clock.used = eventModeUsed;
    return x;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String token, fmi3String resourcePath,
                                          fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback logMessage)
{
    (void)resourcePath, (void)visible;
    return instantiate(instanceName, token, loggingOn, environment, logMessage,
                       declared.rates ? NULL : "this FMU is for co-simulation, not model exchange",
                       "fmi3InstantiateModelExchange");
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String token,
                                               fmi3String resourcePath, fmi3Boolean visible,
                                               fmi3Boolean loggingOn, fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback logMessage,
                                               fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)resourcePath, (void)visible;
    (void)clockUpdate, (void)lockPreemption, (void)unlockPreemption;
    return instantiate(instanceName, token, loggingOn, environment, logMessage,
                       "this FMU is for co-simulation, not scheduled execution",
                       "fmi3InstantiateScheduledExecution");
}

void fmi3FreeInstance(fmi3Instance x) { instance_free(x); }

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    Instance *x = instance;
    if (declared.structural == declared.n_scalars)
        return (fmi3Status)refuse(x, "fmi3EnterConfigurationMode", "this FMU has no structural parameters");
    if (!legal(x, INSTANTIATED, "fmi3EnterConfigurationMode")) return fmi3Error;
    x->mode = CONFIGURATION;
    return fmi3OK;
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    Instance *x = instance;
    if (declared.structural == declared.n_scalars)
        return (fmi3Status)refuse(x, "fmi3ExitConfigurationMode", "this FMU has no structural parameters");
    if (!legal(x, CONFIGURATION, "fmi3ExitConfigurationMode")) return fmi3Error;
    x->mode = INSTANTIATED;
    return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance x, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined,
                                       fmi3Float64 stopTime)
{
    static const char function[] = "fmi3EnterInitializationMode";
    (void)toleranceDefined, (void)tolerance; /* the step is fixed */
    if (!legal(x, INSTANTIATED, function)) return fmi3Error;
    const Status status = set_up(x, startTime, stopTimeDefined, stopTime, function);
    return (fmi3Status)(status == STATUS_OK ? enter_initialization(x) : status);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance x)
{
    if (!legal(x, INITIALIZATION, "fmi3ExitInitializationMode")) return fmi3Error;
    return (fmi3Status)exit_initialization(x, "fmi3ExitInitializationMode");
}

fmi3Status fmi3Terminate(fmi3Instance x)
{
    if (!legal(x, LIVE, "fmi3Terminate")) return fmi3Error;
    return (fmi3Status)terminate(x);
}

fmi3Status fmi3Reset(fmi3Instance x)
{
    if (!legal(x, ANY, "fmi3Reset")) return fmi3Error;
    return (fmi3Status)reset(x);
}

/* --- values ------------------------------------------------------------------------------- */

static inline int has(fmi3ValueReference reference, unsigned need)
{
    return reference <= declared.n_variables && (variables[reference].access & need) == need;
}

static int refuse_reference(const Instance *x, const char *function, fmi3ValueReference reference,
                            unsigned need)
{
    if (declared.is_clocked && reference == CLOCK_REFERENCE) {
        refuse(x, function, "value reference %u is the clock", CLOCK_REFERENCE);
        return 0;
    }
    if (reference > declared.n_variables) {
        refuse(x, function, "there is no value reference %lu, the last is %u", (unsigned long)reference,
               declared.n_variables);
        return 0;
    }
    const Variable *v = &variables[reference];
    const char *type = v->access & IS_REAL      ? "Float64"
                       : v->access & IS_INTEGER ? "Int32"
                       : v->access & IS_SIZE    ? "UInt64"
                                                : "Boolean";
    refuse_access(x, function, v->name, type, v->access, need);
    return 0;
}

/* Check the pointers, that all references have the access `need`, and the number of values. */
static inline int fit(const Instance *x, const fmi3ValueReference vr[], size_t n, const void *values,
                      size_t nValues, unsigned need, const char *function)
{
    size_t size = 0;
    if ((n > 0 && vr == NULL) || (nValues > 0 && values == NULL)) {
        refuse(x, function, "%s is null", vr == NULL ? "valueReferences" : "values");
        return 0;
    }
    for (size_t i = 0; i < n; i++) {
        if (!has(vr[i], need)) return refuse_reference(x, function, vr[i], need);
        size += size_of(x, &variables[vr[i]]);
    }
    if (size == nValues) return 1;
    refuse(x, function, "nValues is %lu, expected %lu", (unsigned long)nValues, (unsigned long)size);
    return 0;
}

/* Before calculated values are read: bring them up to date. */
static int follow(Instance *x, const fmi3ValueReference vr[], size_t n, const char *function)
{
    if (x->mode == EVENT && declared.is_clocked) return clock_evaluate(x, function) == STATUS_OK;
    for (size_t i = 0; i < n; i++)
        if (has(vr[i], IS_CALCULATED)) return settle(x, function) == STATUS_OK;
    return 1;
}

/* Inputs are clocked: where the importer ticks, they are set while the clock is active. */
static int between_ticks(const Instance *x, const char *function)
{
    if (!x->clock.used || x->clock.active || !(x->mode & (STEPPING | EVENT))) return 1;
    refuse(x, function, "inputs are clocked: set them in Event Mode, after fmi3SetClock");
    return 0;
}

static inline int may_get(Instance *x, const fmi3ValueReference vr[], size_t n, const void *values,
                          size_t nValues, unsigned type, const char *function)
{
    if (!legal(x, READ, function)) return 0;
    if (!fit(x, vr, n, values, nValues, type, function)) return 0;
    if (!x->stale || !(x->mode & (INITIALIZATION | EVENT | CONTINUOUS))) return 1;
    return follow(x, vr, n, function);
}

static inline int may_set(Instance *x, const fmi3ValueReference vr[], size_t n, const void *values,
                          size_t nValues, unsigned type, const char *function)
{
    if (!legal(x, WRITE, function)) return 0;
    const unsigned need = type | (x->mode & CONFIGURATION ? IS_SIZE
                                  : x->mode & LIVE        ? SET_IN_STEPS
                                                          : SET_AT_START);
    if (!fit(x, vr, n, values, nValues, need, function)) return 0;
    if (declared.is_clocked && n > 0 && !between_ticks(x, function)) return 0;
    x->stale |= x->mode != STEPPING;
    return 1;
}

/* fmi3Get<T> and fmi3Set<T>: each variable's scalars lie one after the other. */
#define VALUES(T, BIT)                                                                                      \
    fmi3Status fmi3Get##T(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3##T values[], \
                          size_t nValues)                                                                   \
    {                                                                                                       \
        Instance *x = instance;                                                                             \
        if (!may_get(x, vr, n, values, nValues, BIT, "fmi3Get" #T)) return fmi3Error;                       \
        for (size_t i = 0; i < n; i++) {                                                                    \
            const Variable *v = &variables[vr[i]];                                                          \
            const unsigned size = size_of(x, v);                                                            \
            const double *from = x->values + v->offset;                                                     \
            if (size == 1) *values++ = (fmi3##T) * from;                                                    \
            else                                                                                            \
                for (unsigned k = size; k > 0; k--) *values++ = (fmi3##T) * from++;                         \
        }                                                                                                   \
        return fmi3OK;                                                                                      \
    }                                                                                                       \
    fmi3Status fmi3Set##T(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,                   \
                          const fmi3##T values[], size_t nValues)                                           \
    {                                                                                                       \
        Instance *x = instance;                                                                             \
        if (!may_set(x, vr, n, values, nValues, BIT, "fmi3Set" #T)) return fmi3Error;                       \
        for (size_t i = 0; i < n; i++) {                                                                    \
            const Variable *v = &variables[vr[i]];                                                          \
            const unsigned size = size_of(x, v);                                                            \
            double *to = x->values + v->offset;                                                             \
            if (size == 1) *to = *values++;                                                                 \
            else                                                                                            \
                for (unsigned k = size; k > 0; k--) *to++ = *values++;                                      \
        }                                                                                                   \
        return fmi3OK;                                                                                      \
    }
VALUES(Float64, IS_REAL)
VALUES(Int32, IS_INTEGER)
VALUES(Boolean, IS_BOOLEAN)

/* Where there is no structural parameter, a call with references is refused. */
static int has_size(const Instance *x, unsigned modes, size_t n, const char *function)
{
    if (declared.structural < declared.n_scalars || n == 0) return 1;
    if (legal(x, modes, function)) refuse(x, function, "this FMU has no variable of type UInt64");
    return 0;
}

/* The structural parameter: a scalar within its limits. */
fmi3Status fmi3GetUInt64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3UInt64 values[],
                         size_t nValues)
{
    Instance *x = instance;
    static const char function[] = "fmi3GetUInt64";
    if (!has_size(x, READ, n + nValues, function)) return fmi3Error;
    if (!may_get(x, vr, n, values, nValues, IS_SIZE, function)) return fmi3Error;
    for (size_t i = 0; i < n; i++) values[i] = (fmi3UInt64)x->values[variables[vr[i]].offset];
    return fmi3OK;
}

fmi3Status fmi3SetUInt64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                         const fmi3UInt64 values[], size_t nValues)
{
    static const char function[] = "fmi3SetUInt64";
    Instance *x = instance;
    if (!has_size(x, WRITE, n + nValues, function)) return fmi3Error;
    if (!may_set(x, vr, n, values, nValues, IS_SIZE, function)) return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        const Variable *v = &variables[vr[i]];
        if (!((double)values[i] >= v->minimum && (double)values[i] <= v->maximum))
            return (fmi3Status)refuse(x, function, "%s is %lu, expected between %g and %g", v->name,
                                      (unsigned long)values[i], v->minimum, v->maximum);
    }
    for (size_t i = 0; i < n; i++) x->values[variables[vr[i]].offset] = (double)values[i];
    return fmi3OK;
}

/* --- saved states ------------------------------------------------------------------------- */

fmi3Status fmi3GetFMUState(fmi3Instance x, fmi3FMUState *state)
{
    if (!legal(x, ANY, "fmi3GetFMUState")) return fmi3Error;
    return (fmi3Status)state_save(x, state, "fmi3GetFMUState");
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    Instance *x = instance;
    if (!legal(x, ANY, "fmi3SetFMUState")) return fmi3Error;
    const Status status = state_restore(x, state, "fmi3SetFMUState");
    if (x->mode == STEP_FAILED) x->mode = STEPPING; /* serialised by FMI 2.0, unknown to 3.0 */
    return (fmi3Status)status;
}

fmi3Status fmi3FreeFMUState(fmi3Instance x, fmi3FMUState *state)
{
    if (!legal(x, ANY, "fmi3FreeFMUState")) return fmi3Error;
    return (fmi3Status)state_free(x, state, "fmi3FreeFMUState");
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance x, fmi3FMUState state, size_t *size)
{
    if (!legal(x, ANY, "fmi3SerializedFMUStateSize")) return fmi3Error;
    return (fmi3Status)state_size(x, state, size, "fmi3SerializedFMUStateSize");
}

fmi3Status fmi3SerializeFMUState(fmi3Instance x, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    if (!legal(x, ANY, "fmi3SerializeFMUState")) return fmi3Error;
    return (fmi3Status)state_write(x, state, bytes, size, "fmi3SerializeFMUState");
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance x, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    if (!legal(x, ANY, "fmi3DeserializeFMUState")) return fmi3Error;
    return (fmi3Status)state_read(x, bytes, size, state, "fmi3DeserializeFMUState");
}

/* --- steps -------------------------------------------------------------------------------- */

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    Instance *x = instance;
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    if (!legal(x, STEPPING, "fmi3DoStep")) return fmi3Error;
    if (eventHandlingNeeded == NULL || terminateSimulation == NULL || earlyReturn == NULL ||
        lastSuccessfulTime == NULL)
        return (fmi3Status)refuse(x, "fmi3DoStep", "a pointer for the answer is null");
    const Status status = do_step(x, currentCommunicationPoint, communicationStepSize, "fmi3DoStep");
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    *lastSuccessfulTime = x->values[TIME];
    return (fmi3Status)status;
}

fmi3Float64 *fmi3_values(fmi3Instance c)
{
    Instance *x = c;
    return declared.structural == declared.n_scalars ? x->values : NULL;
}

size_t fmi3_place(fmi3ValueReference reference, size_t *size)
{
    const Variable *v = &variables[reference <= declared.n_variables ? reference : 0];
    *size = v->size;
    return v->offset;
}

void fmi3_advance(const fmi3Instance c[], size_t n, const fmi3Float64 t[], size_t m, fmi3Float64 h,
                  int status[], size_t made[])
{
    Instance *const *x = (Instance *const *)c;
    do_steps(x, n, t, m, h, "fmi3DoStep", status, made);
}
