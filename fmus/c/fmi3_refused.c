/* fmi3_refused.c - functions of FMI 3.0.2 that this FMU exports but does not support.
 *
 * No types but Float64, Int32, Boolean and UInt64 (and Clock, see fmi3_events.c), no adjoint
 * derivatives, no scheduled execution: the model description says so, and a call is refused in every mode with a message.
 */
#include "fmi3.h"
#include "instance.h"

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard's, not needed here */
#endif

static fmi3Status refused(const Instance *x, const char *function, const char *why)
{
    return (fmi3Status)refuse(x, function, "%s", why);
}

/* --- values of types that no variable has; a call without references is allowed -------------- */

static fmi3Status none(const Instance *x, unsigned modes, size_t n, const char *type, const char *function)
{
    if (!legal(x, modes, function)) return fmi3Error;
    if (n == 0) return fmi3OK;
    return (fmi3Status)refuse(x, function, "this FMU has no variable of type %s", type);
}

enum {
    READ = CONFIGURATION | INITIALIZATION | STEPPING | EVENT | TERMINATED,
    WRITE = INSTANTIATED | CONFIGURATION | INITIALIZATION | STEPPING | EVENT
};

#define NO_VALUES(T)                                                                                       \
    fmi3Status fmi3Get##T(fmi3Instance x, const fmi3ValueReference vr[], size_t n, fmi3##T values[],       \
                          size_t nValues)                                                                  \
    {                                                                                                      \
        return none(x, READ, n + nValues, #T, "fmi3Get" #T);                                               \
    }                                                                                                      \
    fmi3Status fmi3Set##T(fmi3Instance x, const fmi3ValueReference vr[], size_t n, const fmi3##T values[], \
                          size_t nValues)                                                                  \
    {                                                                                                      \
        return none(x, WRITE, n + nValues, #T, "fmi3Set" #T);                                              \
    }
NO_VALUES(Float32)
NO_VALUES(Int8)
NO_VALUES(UInt8)
NO_VALUES(Int16)
NO_VALUES(UInt16)
NO_VALUES(UInt32)
NO_VALUES(Int64)
NO_VALUES(String)

fmi3Status fmi3GetBinary(fmi3Instance x, const fmi3ValueReference vr[], size_t n, size_t sizes[],
                         fmi3Binary values[], size_t nValues)
{
    return none(x, READ, n + nValues, "Binary", "fmi3GetBinary");
}

fmi3Status fmi3SetBinary(fmi3Instance x, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                         const fmi3Binary values[], size_t nValues)
{
    return none(x, WRITE, n + nValues, "Binary", "fmi3SetBinary");
}

/* --- dependencies and derivatives ----------------------------------------------------------- */

static const char NO_DEPENDENCIES[] = "this FMU does not provide dependencies of elements";
static const char NO_DERIVATIVES[] = "this FMU provides no derivatives";

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance x, fmi3ValueReference vr, size_t *n)
{
    return refused(x, "fmi3GetNumberOfVariableDependencies", NO_DEPENDENCIES);
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance x, fmi3ValueReference dependent,
                                       size_t elementsOfDependent[], fmi3ValueReference independents[],
                                       size_t elementsOfIndependents[], fmi3DependencyKind kinds[], size_t n)
{
    return refused(x, "fmi3GetVariableDependencies", NO_DEPENDENCIES);
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance x, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns,
                                    const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
                                    size_t nSensitivity)
{
    return refused(x, "fmi3GetAdjointDerivative", NO_DERIVATIVES);
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance x, const fmi3ValueReference vr[], size_t n,
                                    const fmi3Int32 orders[], fmi3Float64 values[], size_t nValues)
{
    return refused(x, "fmi3GetOutputDerivatives", NO_DERIVATIVES);
}

/* --- scheduled execution --------------------------------------------------------------------- */

static const char NO_PARTITIONS[] = "this FMU is not for scheduled execution";

fmi3Status fmi3ActivateModelPartition(fmi3Instance x, fmi3ValueReference clock, fmi3Float64 activationTime)
{
    return refused(x, "fmi3ActivateModelPartition", NO_PARTITIONS);
}
