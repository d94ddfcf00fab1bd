/* fmi2.c - FMI 2.0.5 for co-simulation: the entry points.
 *
 * The table of clause 4.2.4 says which function may be called in which state. A value reference is the
 * index of a scalar in Model; declared.n_scalars is the time.
 */
#include "fmi2.h"

#include "instance.h"

/* The table: columns instantiated, initializationMode, stepComplete, stepFailed, terminated.
 * Steps end before fmi2DoStep returns, so nothing is in progress or cancelled. */
enum {
    LIVE = EVENT | CONTINUOUS, /* of model exchange, clause 3.2.3 */
    ANY = INSTANTIATED | INITIALIZATION | STEPPING | STEP_FAILED | TERMINATED | LIVE,
    READ = INITIALIZATION | STEPPING | STEP_FAILED | TERMINATED | LIVE,
    WRITE = INSTANTIATED | INITIALIZATION | STEPPING | LIVE,
    END = STEPPING | STEP_FAILED
};

/* --- any mode ----------------------------------------------------------------------------- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return "2.0"; }

/* fmi2CallbackLogger takes a format: the text goes through "%s", whatever it contains. */
static void forward(const Instance *x, Status status, const char *category, const char *text)
{
    const fmi2CallbackLogger logger = (fmi2CallbackLogger)x->callback;
    logger(x->environment, x->name, (fmi2Status)status, category, "%s", text);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t n,
                               const fmi2String categories[])
{
    if (!legal(c, ANY, "fmi2SetDebugLogging")) return fmi2Error;
    return (fmi2Status)set_logging(c, loggingOn, n, categories, "fmi2SetDebugLogging");
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type type, fmi2String guid,
                              fmi2String resourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)resourceLocation, (void)visible; /* nothing to read, nothing to show */
    if (functions == NULL) return NULL;
    Instance *x = instance_new(instanceName, guid, loggingOn, forward, (AnyFunction *)functions->logger,
                               functions->componentEnvironment, "fmi2Instantiate");
    if (x != NULL && type != (declared.rates ? fmi2ModelExchange : fmi2CoSimulation)) {
        refuse(x, "fmi2Instantiate", "this FMU is for %s only",
               declared.rates ? "model exchange" : "co-simulation");
        instance_free(x);
        return NULL;
    }
    return x;
}

void fmi2FreeInstance(fmi2Component c) { instance_free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    (void)toleranceDefined, (void)tolerance; /* the step is fixed */
    if (!legal(c, INSTANTIATED, "fmi2SetupExperiment")) return fmi2Error;
    return (fmi2Status)set_up(c, startTime, stopTimeDefined, stopTime, "fmi2SetupExperiment");
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    if (!legal(c, INSTANTIATED, "fmi2EnterInitializationMode")) return fmi2Error;
    return (fmi2Status)enter_initialization(c);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    if (!legal(c, INITIALIZATION, "fmi2ExitInitializationMode")) return fmi2Error;
    return (fmi2Status)exit_initialization(c, "fmi2ExitInitializationMode");
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    if (!legal(c, END | LIVE, "fmi2Terminate")) return fmi2Error;
    return (fmi2Status)terminate(c);
}

fmi2Status fmi2Reset(fmi2Component c)
{
    if (!legal(c, ANY, "fmi2Reset")) return fmi2Error;
    return (fmi2Status)reset(c);
}

/* --- values ------------------------------------------------------------------------------- */

/* Log what is wrong with a value reference that does not have all bits of `need`. */
static fmi2Status refuse_reference(const Instance *x, const char *function, fmi2ValueReference reference,
                                   unsigned need)
{
    if (reference > declared.n_scalars)
        return (fmi2Status)refuse(x, function, "there is no value reference %u, the last is %u", reference,
                                  declared.n_scalars);
    const unsigned access = scalar_access[reference];
    const char *type = access & IS_REAL ? "Real" : access & IS_INTEGER ? "Integer" : "Boolean";
    return (fmi2Status)refuse_access(x, function, scalar_names[reference], type, access, need);
}

static inline int has(fmi2ValueReference reference, unsigned need)
{
    return reference <= declared.n_scalars && (scalar_access[reference] & need) == need;
}

/* Before reading: mode, pointers, and calculated values brought up to date. */
static int may_get(Instance *x, const fmi2ValueReference vr[], size_t n, const void *value,
                   const char *function)
{
    if (!legal(x, READ, function)) return 0;
    if (n > 0 && (vr == NULL || value == NULL)) {
        refuse(x, function, "%s is null", vr == NULL ? "vr" : "value");
        return 0;
    }
    if (!x->stale || !(x->mode & (INITIALIZATION | LIVE))) return 1;
    for (size_t i = 0; i < n; i++)
        if (has(vr[i], IS_CALCULATED)) return settle(x, function) == STATUS_OK;
    return 1;
}

/* Before writing: mode, pointers, and every reference of type `type` and settable now. */
static int may_set(Instance *x, const fmi2ValueReference vr[], size_t n, const void *value, unsigned type,
                   const char *function)
{
    if (!legal(x, WRITE, function)) return 0;
    if (n > 0 && (vr == NULL || value == NULL)) {
        refuse(x, function, "%s is null", vr == NULL ? "vr" : "value");
        return 0;
    }
    const unsigned need = type | (x->mode & (STEPPING | LIVE) ? SET_IN_STEPS : SET_AT_START);
    for (size_t i = 0; i < n; i++)
        if (!has(vr[i], need)) {
            refuse_reference(x, function, vr[i], need);
            return 0;
        }
    x->stale |= x->mode != STEPPING;
    return 1;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    Instance *x = c;
    if (!may_get(x, vr, n, value, "fmi2GetReal")) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (!has(vr[i], IS_REAL)) return refuse_reference(x, "fmi2GetReal", vr[i], IS_REAL);
        value[i] = x->values[vr[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
{
    Instance *x = c;
    if (!may_get(x, vr, n, value, "fmi2GetInteger")) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (!has(vr[i], IS_INTEGER)) return refuse_reference(x, "fmi2GetInteger", vr[i], IS_INTEGER);
        value[i] = (fmi2Integer)x->values[vr[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[])
{
    Instance *x = c;
    if (!may_get(x, vr, n, value, "fmi2GetBoolean")) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (!has(vr[i], IS_BOOLEAN)) return refuse_reference(x, "fmi2GetBoolean", vr[i], IS_BOOLEAN);
        value[i] = x->values[vr[i]] != 0.0;
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    Instance *x = c;
    if (!may_set(x, vr, n, value, IS_REAL, "fmi2SetReal")) return fmi2Error;
    for (size_t i = 0; i < n; i++) x->values[vr[i]] = value[i];
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[])
{
    Instance *x = c;
    if (!may_set(x, vr, n, value, IS_INTEGER, "fmi2SetInteger")) return fmi2Error;
    for (size_t i = 0; i < n; i++) x->values[vr[i]] = value[i];
    return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[])
{
    Instance *x = c;
    if (!may_set(x, vr, n, value, IS_BOOLEAN, "fmi2SetBoolean")) return fmi2Error;
    for (size_t i = 0; i < n; i++) x->values[vr[i]] = value[i] != fmi2False;
    return fmi2OK;
}

/* --- saved states ------------------------------------------------------------------------- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!legal(c, ANY, "fmi2GetFMUstate")) return fmi2Error;
    return (fmi2Status)state_save(c, state, "fmi2GetFMUstate");
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    if (!legal(c, ANY, "fmi2SetFMUstate")) return fmi2Error;
    return (fmi2Status)state_restore(c, state, "fmi2SetFMUstate");
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!legal(c, ANY, "fmi2FreeFMUstate")) return fmi2Error;
    return (fmi2Status)state_free(c, state, "fmi2FreeFMUstate");
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    if (!legal(c, ANY, "fmi2SerializedFMUstateSize")) return fmi2Error;
    return (fmi2Status)state_size(c, state, size, "fmi2SerializedFMUstateSize");
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (!legal(c, ANY, "fmi2SerializeFMUstate")) return fmi2Error;
    return (fmi2Status)state_write(c, state, (unsigned char *)bytes, size, "fmi2SerializeFMUstate");
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    if (!legal(c, ANY, "fmi2DeSerializeFMUstate")) return fmi2Error;
    return (fmi2Status)state_read(c, (const unsigned char *)bytes, size, state, "fmi2DeSerializeFMUstate");
}

/* --- steps -------------------------------------------------------------------------------- */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    Instance *x = c;
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    if (!legal(x, STEPPING, "fmi2DoStep")) return fmi2Error;
    const Status status = do_step(x, currentCommunicationPoint, communicationStepSize, "fmi2DoStep");
    if (status == STATUS_DISCARD) x->mode = STEP_FAILED;
    return (fmi2Status)status;
}

fmi2Real *fmi2_values(fmi2Component c)
{
    Instance *x = c;
    return x->values;
}

void fmi2_advance(const fmi2Component c[], size_t n, const fmi2Real t[], size_t m, fmi2Real h, int status[],
                  size_t made[])
{
    Instance *const *x = (Instance *const *)c;
    do_steps(x, n, t, m, h, "fmi2DoStep", status, made);
    for (size_t i = 0; i < n; i++)
        if (status[i] == STATUS_DISCARD) x[i]->mode = STEP_FAILED;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    Instance *x = c;
    if (!legal(x, END | TERMINATED, "fmi2GetRealStatus")) return fmi2Error;
    if (value == NULL || kind != fmi2LastSuccessfulTime)
        return (fmi2Status)refuse(x, "fmi2GetRealStatus", "only fmi2LastSuccessfulTime is known");
    *value = x->values[TIME];
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (!legal(c, END | TERMINATED, "fmi2GetBooleanStatus")) return fmi2Error;
    if (value == NULL || kind != fmi2Terminated)
        return (fmi2Status)refuse(c, "fmi2GetBooleanStatus", "only fmi2Terminated is known");
    *value = fmi2False; /* these models never end a simulation on their own */
    return fmi2OK;
}
