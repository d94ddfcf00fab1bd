/* component.c - an FMU of FMI 3.0 for co-simulation as the core module of a WebAssembly component.
 *
 * The world is `co-simulation-fmu` of the FMI Layered Standard for WebAssembly (README.md says which draft).
 * Each function below is one of it as the canonical ABI of the component model lowers it: it calls its namesake
 * of FMI 3.0. Lists and texts that the host passes are in the arena until the next call, as are results.
 */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3.h"
#include "sizes.h" /* generated: which variables are arrays */

enum { NO_DIMENSION = UINT32_MAX };
typedef struct {
    fmi3Instance fmu;
    char *name;
    size_t length; /* of the name */
} Resource;
typedef const char *Text;
typedef const fmi3ValueReference *References;
typedef struct {
    Text text;
    size_t length;
} Slice;
typedef struct {
    uint32_t reference;
    uint32_t order;
} Order;
typedef struct {
    uint64_t counter, resolution;
} Fraction;

/* What an FMU may lack is refused, not called. */
#define WEAK(function) extern __typeof__(fmi3##function) fmi3##function __attribute__((weak))
#define HAS(function) (fmi3##function != NULL)
WEAK(SetDebugLogging);
WEAK(EnterEventMode);
WEAK(UpdateDiscreteStates);
WEAK(EnterConfigurationMode);
WEAK(ExitConfigurationMode);
WEAK(GetNumberOfVariableDependencies);
WEAK(GetVariableDependencies);
WEAK(GetFMUState);
WEAK(SetFMUState);
WEAK(FreeFMUState);
WEAK(SerializedFMUStateSize);
WEAK(SerializeFMUState);
WEAK(DeserializeFMUState);
WEAK(GetDirectionalDerivative);
WEAK(GetAdjointDerivative);
WEAK(GetIntervalDecimal);
WEAK(GetIntervalFraction);
WEAK(GetShiftDecimal);
WEAK(GetShiftFraction);
WEAK(SetIntervalDecimal);
WEAK(SetIntervalFraction);
WEAK(SetShiftDecimal);
WEAK(SetShiftFraction);
WEAK(EvaluateDiscreteStates);
WEAK(GetOutputDerivatives);
WEAK(EnterStepMode);
WEAK(Reset);
WEAK(Terminate);
WEAK(GetBinary);
WEAK(SetBinary);
WEAK(GetClock);
WEAK(SetClock);
WEAK(GetFloat32);
WEAK(GetFloat64);
WEAK(GetInt8);
WEAK(GetUInt8);
WEAK(GetInt16);
WEAK(GetUInt16);
WEAK(GetInt32);
WEAK(GetUInt32);
WEAK(GetInt64);
WEAK(GetUInt64);
WEAK(GetBoolean);
WEAK(GetString);
WEAK(SetFloat32);
WEAK(SetFloat64);
WEAK(SetInt8);
WEAK(SetUInt8);
WEAK(SetInt16);
WEAK(SetUInt16);
WEAK(SetInt32);
WEAK(SetUInt32);
WEAK(SetInt64);
WEAK(SetUInt64);
WEAK(SetBoolean);
WEAK(SetString);

#define IN "fmi:fmi3/co-simulation@3.0.0#"
#define EXPORTED(name) __attribute__((export_name(name), used))
#define METHOD(name) EXPORTED(IN "[method]co-simulation-instance." name)
#define IMPORTED(from, name) __attribute__((import_module(from), import_name(name)))

IMPORTED("[export]fmi:fmi3/co-simulation@3.0.0", "[resource-new]co-simulation-instance")
extern int32_t new_handle(Resource *x);
IMPORTED("fmi:fmi3/callbacks@3.0.0", "log-message")
extern void log_message(Text name, size_t n, int32_t status, Text category, size_t m, Text message, size_t k);

/* --- memory of one call ------------------------------------------------------------------- */

enum { ROOM = 4096 };
typedef struct More More;
struct More {
    More *next;
};
static _Alignas(16) uint8_t arena[ROOM];
static size_t filled;
static More *more; /* what does not fit */
static bool over;  /* the call: the next allocation is of another one */

static void *allocate(size_t align, size_t size)
{
    if (over) {
        filled = 0, over = false;
        while (more != NULL) {
            More *next = more->next;
            free(more);
            more = next;
        }
    }
    const size_t start = (filled + align - 1) & ~(align - 1);
    if (size <= ROOM && start <= ROOM - size) {
        filled = start + size;
        return arena + start;
    }
    if (size > SIZE_MAX - 16) __builtin_trap();
    More *found = malloc(16 + size);
    if (found == NULL) __builtin_trap();
    found->next = more, more = found;
    return (uint8_t *)found + 16;
}

static void *many(size_t n, size_t size, size_t align)
{
    if (size != 0 && n > SIZE_MAX / size) __builtin_trap();
    return allocate(align, n * size);
}
#define MANY(type, n) ((type *)many(n, sizeof(type), _Alignof(type)))

EXPORTED("cabi_realloc") void *cabi_realloc(void *old, size_t before, size_t align, size_t size)
{
    void *found = allocate(align, size);
    if (old != NULL && before != 0) memcpy(found, old, before < size ? before : size);
    return found;
}

/* The text of the host, ended by 0 as C has it. */
static char *ended(Text text, size_t n)
{
    char *found = many(n + 1, 1, 1);
    memcpy(found, text, n);
    found[n] = 0;
    return found;
}

/* --- what calls return: a status, or a variant in memory: 0 and a value, or 1 and the status --- */

enum { PAYLOAD4 = 4, PAYLOAD8 = 8 };
static int32_t done(fmi3Status status)
{
    over = true;
    return (int32_t)status > fmi3Fatal || (int32_t)status < 0 ? fmi3Fatal : (int32_t)status;
}

static uint8_t *result(size_t payload, fmi3Status status)
{
    uint8_t *found = allocate(8, 40);
    const bool good = status == fmi3OK || status == fmi3Warning;
    memset(found, 0, 40);
    found[0] = !good;
    if (!good) found[payload] = (uint8_t)done(status);
    over = true;
    return found;
}

static uint8_t *listed(fmi3Status status, const void *items, size_t n)
{
    uint8_t *found = result(PAYLOAD4, status);
    if (found[0] == 0)
        ((uint32_t *)found)[1] = (uint32_t)(uintptr_t)items, ((uint32_t *)found)[2] = (uint32_t)n;
    return found;
}

/* Scalars of some variables: a row of SIZES is a value reference, a factor, and the structural parameters that it
 * is multiplied by. */
static size_t scalars(const Resource *x, References references, size_t n)
{
    static const uint32_t sizes[][2 + DIMENSIONS] = SIZES; /* DIMENSIONS may be 0 */
    size_t sum = 0;
    for (size_t i = 0; i < n; i++) {
        size_t size = 1;
        for (size_t k = 0; k < sizeof sizes / sizeof sizes[0]; k++) {
            if (sizes[k][0] != references[i] || sizes[k][1] == 0) continue;
            size = sizes[k][1];
            for (size_t d = 2; d < 2 + DIMENSIONS; d++) {
                uint64_t extent = 1;
                if (sizes[k][d] != NO_DIMENSION &&
                    fmi3GetUInt64(x->fmu, &sizes[k][d], 1, &extent, 1) > fmi3Warning)
                    extent = 1;
                if (extent != 0 && size > UINT32_MAX / extent) __builtin_trap();
                size *= (size_t)extent;
            }
        }
        sum += size;
    }
    return sum;
}

/* --- the instance ------------------------------------------------------------------------- */

static void say(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                fmi3String message)
{
    const Resource *x = environment;
    if (category == NULL) category = "";
    if (message == NULL) message = "";
    log_message(x->name, x->length, done(status), category, strlen(category), message, strlen(message));
}

EXPORTED("fmi:fmi3/common@3.0.0#get-version") uint8_t *lifted_get_version(void)
{
    Slice *found = MANY(Slice, 1);
    found->text = "3.0", found->length = 3;
    over = true;
    return (uint8_t *)found;
}

EXPORTED(IN "[static]co-simulation-instance.instantiate-co-simulation")
uint8_t *lifted_instantiate(Text name, size_t n, Text token, size_t m, int32_t visible, int32_t logging,
                            int32_t events, int32_t early, References asked, size_t n_asked)
{
    uint32_t *found = allocate(8, 8);
    Resource *x = calloc(1, sizeof *x);
    found[0] = 0;
    if (x == NULL || (x->name = malloc(n + 1)) == NULL) __builtin_trap();
    memcpy(x->name, name, n);
    x->name[n] = 0, x->length = n;
    x->fmu = fmi3InstantiateCoSimulation(x->name, ended(token, m), "", visible != 0, logging != 0,
                                         events != 0, early != 0, asked, n_asked, x, say, NULL);
    over = true;
    if (x->fmu == NULL) {
        free(x->name), free(x);
        return (uint8_t *)found;
    }
    found[1] = (uint32_t)new_handle(x);
    found[0] = 1;
    return (uint8_t *)found;
}

EXPORTED(IN "[dtor]co-simulation-instance") void lifted_drop(Resource *x)
{
    fmi3FreeInstance(x->fmu);
    free(x->name), free(x);
    over = true;
}

#define PLAIN(name, function)                                            \
    METHOD(name) int32_t lifted_plain_##function(Resource *x)            \
    {                                                                    \
        return done(HAS(function) ? fmi3##function(x->fmu) : fmi3Error); \
    }
PLAIN("exit-initialization-mode", ExitInitializationMode)
PLAIN("enter-event-mode", EnterEventMode)
PLAIN("terminate", Terminate)
PLAIN("reset", Reset)
PLAIN("enter-configuration-mode", EnterConfigurationMode)
PLAIN("exit-configuration-mode", ExitConfigurationMode)
PLAIN("evaluate-discrete-states", EvaluateDiscreteStates)
PLAIN("enter-step-mode", EnterStepMode)

METHOD("set-debug-logging")
int32_t lifted_set_debug_logging(Resource *x, int32_t on, const Slice *categories, size_t n)
{
    fmi3String *texts = MANY(fmi3String, n);
    for (size_t i = 0; i < n; i++) texts[i] = ended(categories[i].text, categories[i].length);
    return done(HAS(SetDebugLogging) ? fmi3SetDebugLogging(x->fmu, on != 0, n, texts) : fmi3Error);
}

METHOD("enter-initialization-mode")
int32_t lifted_enter_initialization(Resource *x, int32_t has_tolerance, double tolerance, double start,
                                    int32_t has_stop, double stop)
{
    return done(
        fmi3EnterInitializationMode(x->fmu, has_tolerance != 0, tolerance, start, has_stop != 0, stop));
}

METHOD("update-discrete-states") uint8_t *lifted_update_discrete_states(Resource *x)
{
    fmi3Boolean flag[5] = {0};
    double next = 0.0;
    const fmi3Status status =
        HAS(UpdateDiscreteStates)
            ? fmi3UpdateDiscreteStates(x->fmu, flag, flag + 1, flag + 2, flag + 3, flag + 4, &next)
            : fmi3Error;
    uint8_t *found = result(PAYLOAD8, status);
    if (found[0] != 0) return found;
    for (int i = 0; i < 5; i++) found[PAYLOAD8 + i] = flag[i];
    memcpy(found + PAYLOAD8 + 8, &next, sizeof next);
    return found;
}

METHOD("do-step") uint8_t *lifted_do_step(Resource *x, double t, double h, int32_t no_return)
{
    fmi3Boolean event = false, ended_ = false, early = false;
    double last = t;
    uint8_t *found =
        result(PAYLOAD8, fmi3DoStep(x->fmu, t, h, no_return != 0, &event, &ended_, &early, &last));
    if (found[0] != 0) return found;
    memcpy(found + PAYLOAD8, &last, sizeof last);
    found[PAYLOAD8 + 8] = event, found[PAYLOAD8 + 9] = ended_, found[PAYLOAD8 + 10] = early;
    return found;
}

/* --- values ------------------------------------------------------------------------------- */

#define VALUES(name, T)                                                                           \
    METHOD("get-" name) uint8_t *lifted_get_##T(Resource *x, References vr, size_t n)             \
    {                                                                                             \
        const size_t m = scalars(x, vr, n);                                                       \
        fmi3##T *values = MANY(fmi3##T, m);                                                       \
        return listed(HAS(Get##T) ? fmi3Get##T(x->fmu, vr, n, values, m) : fmi3Error, values, m); \
    }                                                                                             \
    METHOD("set-" name)                                                                           \
    int32_t lifted_set_##T(Resource *x, References vr, size_t n, const fmi3##T *values, size_t m) \
    {                                                                                             \
        return done(HAS(Set##T) ? fmi3Set##T(x->fmu, vr, n, values, m) : fmi3Error);              \
    }
VALUES("float32", Float32)
VALUES("float64", Float64)
VALUES("int8", Int8)
VALUES("int16", Int16)
VALUES("int32", Int32)
VALUES("int64", Int64)
VALUES("uint8", UInt8)
VALUES("uint16", UInt16)
VALUES("uint32", UInt32)
VALUES("uint64", UInt64)
VALUES("boolean", Boolean)

METHOD("get-string") uint8_t *lifted_get_string(Resource *x, References vr, size_t n)
{
    const size_t m = scalars(x, vr, n);
    fmi3String *texts = MANY(fmi3String, m);
    const fmi3Status status = HAS(GetString) ? fmi3GetString(x->fmu, vr, n, texts, m) : fmi3Error;
    Slice *found = MANY(Slice, m);
    for (size_t i = 0; i < m && status <= fmi3Warning; i++) {
        found[i].text = texts[i] ? texts[i] : "";
        found[i].length = strlen(found[i].text);
    }
    return listed(status, found, m);
}

METHOD("set-string")
int32_t lifted_set_string(Resource *x, References vr, size_t n, const Slice *values, size_t m)
{
    fmi3String *texts = MANY(fmi3String, m);
    for (size_t i = 0; i < m; i++) texts[i] = ended(values[i].text, values[i].length);
    return done(HAS(SetString) ? fmi3SetString(x->fmu, vr, n, texts, m) : fmi3Error);
}

METHOD("get-binary") uint8_t *lifted_get_binary(Resource *x, References vr, size_t n)
{
    const size_t m = scalars(x, vr, n);
    size_t *sizes = MANY(size_t, m);
    fmi3Binary *values = MANY(fmi3Binary, m);
    const fmi3Status status = HAS(GetBinary) ? fmi3GetBinary(x->fmu, vr, n, sizes, values, m) : fmi3Error;
    Slice *found = MANY(Slice, m);
    for (size_t i = 0; i < m && status <= fmi3Warning; i++)
        found[i].text = (Text)values[i], found[i].length = values[i] ? sizes[i] : 0;
    return listed(status, found, m);
}

METHOD("set-binary")
int32_t lifted_set_binary(Resource *x, References vr, size_t n, const Slice *values, size_t m)
{
    size_t *sizes = MANY(size_t, m);
    fmi3Binary *bytes = MANY(fmi3Binary, m);
    for (size_t i = 0; i < m; i++) sizes[i] = values[i].length, bytes[i] = (fmi3Binary)values[i].text;
    return done(HAS(SetBinary) ? fmi3SetBinary(x->fmu, vr, n, sizes, bytes, m) : fmi3Error);
}

METHOD("get-clock") uint8_t *lifted_get_clock(Resource *x, References vr, size_t n)
{
    fmi3Clock *found = MANY(fmi3Clock, n);
    return listed(HAS(GetClock) ? fmi3GetClock(x->fmu, vr, n, found) : fmi3Error, found, n);
}

METHOD("set-clock")
int32_t lifted_set_clock(Resource *x, References vr, size_t n, const fmi3Clock *values, size_t m)
{
    return done(HAS(SetClock) && n == m ? fmi3SetClock(x->fmu, vr, n, values) : fmi3Error);
}

/* --- dependencies, states, derivatives ------------------------------------------------------ */

METHOD("get-number-of-variable-dependencies") uint8_t *lifted_n_dependencies(Resource *x, uint32_t vr)
{
    size_t n = 0;
    uint8_t *found = result(PAYLOAD8, HAS(GetNumberOfVariableDependencies)
                                          ? fmi3GetNumberOfVariableDependencies(x->fmu, vr, &n)
                                          : fmi3Error);
    const uint64_t wide = n;
    if (found[0] == 0) memcpy(found + PAYLOAD8, &wide, sizeof wide);
    return found;
}

METHOD("get-variable-dependencies") uint8_t *lifted_dependencies(Resource *x, uint32_t vr)
{
    typedef struct {
        uint32_t dependent, element, independent, element_of;
        uint8_t kind;
    } Dependency;
    static const uint8_t kinds[] = {0, 1, 2, 3, 4, 0}; /* of fmi3DependencyKind: there is no "independent" */
    size_t n = 0;
    fmi3Status status = HAS(GetNumberOfVariableDependencies) && HAS(GetVariableDependencies)
                            ? fmi3GetNumberOfVariableDependencies(x->fmu, vr, &n)
                            : fmi3Error;
    size_t *elements = MANY(size_t, n), *elements_of = MANY(size_t, n);
    fmi3ValueReference *independents = MANY(fmi3ValueReference, n);
    fmi3DependencyKind *kind = MANY(fmi3DependencyKind, n);
    if (status <= fmi3Warning)
        status = fmi3GetVariableDependencies(x->fmu, vr, elements, independents, elements_of, kind, n);
    Dependency *found = MANY(Dependency, n);
    for (size_t i = 0; i < n && status <= fmi3Warning; i++)
        found[i] = (Dependency){vr, elements[i], independents[i], elements_of[i], kinds[kind[i] % 6]};
    return listed(status, found, n);
}

METHOD("get-fmu-state") uint8_t *lifted_get_fmu_state(Resource *x)
{
    fmi3FMUState state = NULL;
    size_t n = 0;
    uint8_t *bytes = NULL;
    const bool has =
        HAS(GetFMUState) && HAS(FreeFMUState) && HAS(SerializedFMUStateSize) && HAS(SerializeFMUState);
    fmi3Status status = has ? fmi3GetFMUState(x->fmu, &state) : fmi3Error;
    if (status <= fmi3Warning) status = fmi3SerializedFMUStateSize(x->fmu, state, &n);
    if (status <= fmi3Warning) {
        bytes = many(n, 1, 8);
        status = fmi3SerializeFMUState(x->fmu, state, bytes, n);
    }
    if (state != NULL) fmi3FreeFMUState(x->fmu, &state);
    return listed(status, bytes, n);
}

METHOD("set-fmu-state") int32_t lifted_set_fmu_state(Resource *x, const uint8_t *bytes, size_t n)
{
    fmi3FMUState state = NULL;
    const bool has = HAS(SetFMUState) && HAS(FreeFMUState) && HAS(DeserializeFMUState);
    fmi3Status status = has ? fmi3DeserializeFMUState(x->fmu, bytes, n, &state) : fmi3Error;
    if (status <= fmi3Warning) status = fmi3SetFMUState(x->fmu, state);
    if (state != NULL) fmi3FreeFMUState(x->fmu, &state);
    return done(status);
}

METHOD("get-directional-derivative")
uint8_t *lifted_directional(Resource *x, References unknowns, size_t n, References knowns, size_t m,
                            const double *seed, size_t k)
{
    const size_t count = scalars(x, unknowns, n);
    double *found = MANY(double, count);
    return listed(HAS(GetDirectionalDerivative)
                      ? fmi3GetDirectionalDerivative(x->fmu, unknowns, n, knowns, m, seed, k, found, count)
                      : fmi3Error,
                  found, count);
}

METHOD("get-adjoint-derivative")
uint8_t *lifted_adjoint(Resource *x, References unknowns, size_t n, References knowns, size_t m,
                        const double *seed, size_t k)
{
    const size_t count = scalars(x, knowns, m);
    double *found = MANY(double, count);
    return listed(HAS(GetAdjointDerivative)
                      ? fmi3GetAdjointDerivative(x->fmu, unknowns, n, knowns, m, seed, k, found, count)
                      : fmi3Error,
                  found, count);
}

METHOD("set-input-derivatives")
int32_t lifted_set_input_derivatives(Resource *x, const Order *requests, size_t n, const double *values,
                                     size_t m)
{
    (void)x, (void)requests, (void)n, (void)values, (void)m; /* FMI 3.0 has no such function */
    return done(fmi3Error);
}

METHOD("get-output-derivatives")
uint8_t *lifted_output_derivatives(Resource *x, const Order *requests, size_t n)
{
    fmi3ValueReference *vr = MANY(fmi3ValueReference, n);
    fmi3Int32 *orders = MANY(fmi3Int32, n);
    for (size_t i = 0; i < n; i++) vr[i] = requests[i].reference, orders[i] = (fmi3Int32)requests[i].order;
    const size_t m = scalars(x, vr, n);
    double *found = MANY(double, m);
    return listed(HAS(GetOutputDerivatives) ? fmi3GetOutputDerivatives(x->fmu, vr, n, orders, found, m)
                                            : fmi3Error,
                  found, m);
}

/* --- clocks ------------------------------------------------------------------------------- */

METHOD("get-interval-decimal") uint8_t *lifted_get_interval_decimal(Resource *x, References vr, size_t n)
{
    typedef struct {
        double interval;
        uint8_t qualifier;
    } Item;
    double *intervals = MANY(double, n);
    fmi3IntervalQualifier *qualifiers = MANY(fmi3IntervalQualifier, n);
    const fmi3Status status =
        HAS(GetIntervalDecimal) ? fmi3GetIntervalDecimal(x->fmu, vr, n, intervals, qualifiers) : fmi3Error;
    Item *found = MANY(Item, n);
    for (size_t i = 0; i < n && status <= fmi3Warning; i++)
        found[i] = (Item){intervals[i], (uint8_t)(qualifiers[i] % 3)};
    return listed(status, found, n);
}

METHOD("get-interval-fraction") uint8_t *lifted_get_interval_fraction(Resource *x, References vr, size_t n)
{
    typedef struct {
        Fraction interval;
        uint8_t qualifier;
    } Item;
    uint64_t *counters = MANY(uint64_t, n), *resolutions = MANY(uint64_t, n);
    fmi3IntervalQualifier *qualifiers = MANY(fmi3IntervalQualifier, n);
    const fmi3Status status = HAS(GetIntervalFraction)
                                  ? fmi3GetIntervalFraction(x->fmu, vr, n, counters, resolutions, qualifiers)
                                  : fmi3Error;
    Item *found = MANY(Item, n);
    for (size_t i = 0; i < n && status <= fmi3Warning; i++)
        found[i] = (Item){{counters[i], resolutions[i]}, (uint8_t)(qualifiers[i] % 3)};
    return listed(status, found, n);
}

METHOD("get-shift-decimal") uint8_t *lifted_get_shift_decimal(Resource *x, References vr, size_t n)
{
    double *found = MANY(double, n);
    return listed(HAS(GetShiftDecimal) ? fmi3GetShiftDecimal(x->fmu, vr, n, found) : fmi3Error, found, n);
}

METHOD("get-shift-fraction") uint8_t *lifted_get_shift_fraction(Resource *x, References vr, size_t n)
{
    uint64_t *counters = MANY(uint64_t, n), *resolutions = MANY(uint64_t, n);
    const fmi3Status status =
        HAS(GetShiftFraction) ? fmi3GetShiftFraction(x->fmu, vr, n, counters, resolutions) : fmi3Error;
    Fraction *found = MANY(Fraction, n);
    for (size_t i = 0; i < n && status <= fmi3Warning; i++)
        found[i] = (Fraction){counters[i], resolutions[i]};
    return listed(status, found, n);
}

#define DECIMALS(name, function)                                                                       \
    METHOD(name)                                                                                       \
    int32_t lifted_decimal_##function(Resource *x, References vr, size_t n, const double *s, size_t m) \
    {                                                                                                  \
        return done(HAS(function) && n == m ? fmi3##function(x->fmu, vr, n, s) : fmi3Error);           \
    }
DECIMALS("set-interval-decimal", SetIntervalDecimal)
DECIMALS("set-shift-decimal", SetShiftDecimal)

#define FRACTIONS(name, function)                                                                         \
    METHOD(name)                                                                                          \
    int32_t lifted_fraction_##function(Resource *x, References vr, size_t n, const Fraction *s, size_t m) \
    {                                                                                                     \
        uint64_t *counters = MANY(uint64_t, m), *resolutions = MANY(uint64_t, m);                         \
        for (size_t i = 0; i < m; i++) counters[i] = s[i].counter, resolutions[i] = s[i].resolution;      \
        return done(HAS(function) && n == m ? fmi3##function(x->fmu, vr, n, counters, resolutions)        \
                                            : fmi3Error);                                                 \
    }
FRACTIONS("set-interval-fraction", SetIntervalFraction)
FRACTIONS("set-shift-fraction", SetShiftFraction)
