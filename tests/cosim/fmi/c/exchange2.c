/* The functions of FMI 2.0 of the FMU in exchange_model.h. */
#include "exchange_model.h"

typedef struct {
    int again, terminate, nominals, values, defined;
    double next;
} info_t;

FMI const char *fmi2GetVersion(void) { return "2.0"; }
FMI void *fmi2Instantiate(const char *name, int kind, const char *token, const char *resources,
                          const void *functions, int visible, int logging)
{
    (void)name, (void)token, (void)resources, (void)functions, (void)visible, (void)logging;
    return kind == 0 ? made() : NULL; /* fmi2ModelExchange */
}
FMI void fmi2FreeInstance(fmu_t *m)
{
    called(m, m->saved ? "FreeInstance LEAK" : "FreeInstance", ~DEAD);
    if (m->state != DEAD) free(m);
}
FMI int fmi2SetupExperiment(fmu_t *m, int a, double tolerance, double t0, int b, double t1)
{
    (void)a, (void)tolerance, (void)b, (void)t1;
    m->t = t0;
    return called(m, "SetupExperiment", MADE);
}
FMI int fmi2EnterInitializationMode(fmu_t *m)
{
    begins(m, m->t);
    return mode(m, "EnterInitializationMode", MADE, STARTING);
}
FMI int fmi2ExitInitializationMode(fmu_t *m) { return mode(m, "ExitInitializationMode", STARTING, IN_EVENT); }
FMI int fmi2EnterEventMode(fmu_t *m) { return mode(m, "EnterEventMode", CONTINUOUS, IN_EVENT); }
FMI int fmi2EnterContinuousTimeMode(fmu_t *m)
{
    return mode(m, "EnterContinuousTimeMode", IN_EVENT, CONTINUOUS);
}
FMI int fmi2Terminate(fmu_t *m) { return mode(m, "Terminate", IN_EVENT | CONTINUOUS, OVER); }
FMI int fmi2NewDiscreteStates(fmu_t *m, info_t *info)
{
    info->values = happens(m);
    info->again = info->values;
    m->heard = m->gear;
    info->terminate = m->model == COUNTS && m->events >= m->last;
    info->nominals = 0;
    info->defined = m->model == COUNTS;
    info->next = m->latest + m->period;
    return called(m, "NewDiscreteStates", IN_EVENT);
}
FMI int fmi2CompletedIntegratorStep(fmu_t *m, int no_set, int *event, int *terminate)
{
    if (no_set) m->promised = m->t;
    *event = m->model == WRAPS && m->x[0] > 1.0, *terminate = 0;
    return called(m, "CompletedIntegratorStep", CONTINUOUS);
}
FMI int fmi2SetTime(fmu_t *m, double t) { return set_time(m, t); }
FMI int fmi2SetContinuousStates(fmu_t *m, const double *x, size_t n) { return n == 2 ? set_states(m, x) : 3; }
FMI int fmi2GetContinuousStates(fmu_t *m, double *x, size_t n) { return n == 2 ? get_states(m, x) : 3; }
FMI int fmi2GetDerivatives(fmu_t *m, double *d, size_t n) { return n == 2 ? derivatives(m, d) : 3; }
FMI int fmi2GetNominalsOfContinuousStates(fmu_t *m, double *x, size_t n)
{
    for (size_t i = 0; i < n; i++) x[i] = 1.0;
    return called(m, "GetNominals", STARTING | IN_EVENT | CONTINUOUS | OVER);
}
FMI int fmi2GetEventIndicators(fmu_t *m, double *z, size_t n)
{
    *z = indicator(m);
    if (n == 2) z[1] = other_indicator(m);
    return n == 1 || n == 2 ? called(m, "EventIndicators", STARTING | IN_EVENT | CONTINUOUS | OVER) : 3;
}
FMI int fmi2GetDirectionalDerivative(fmu_t *m, const uint32_t *unknowns, size_t n, const uint32_t *knowns,
                                     size_t k, const double *seed, double *found)
{
    return n == k ? directional(m, unknowns, knowns, n, seed, found) : 3;
}
FMI int fmi2GetReal(fmu_t *m, const uint32_t *r, size_t n, double *v) { return get_real(m, r, n, v); }
FMI int fmi2SetReal(fmu_t *m, const uint32_t *r, size_t n, const double *v) { return set_real(m, r, n, v); }
FMI int fmi2GetInteger(fmu_t *m, const uint32_t *r, size_t n, int *v)
{
    for (size_t i = 0; i < n; i++)
        if (get_whole(m, r[i], v + i)) return 3;
    return 0;
}
FMI int fmi2SetInteger(fmu_t *m, const uint32_t *r, size_t n, const int *v)
{
    for (size_t i = 0; i < n; i++)
        if (set_whole(m, r[i], v[i])) return 3;
    return 0;
}

/* What every complete FMU has, and only other tools ask for. */
#define UNUSED(name) \
    FMI int fmi2##name(void) { return 3; }
FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
UNUSED(SetDebugLogging)
UNUSED(Reset)
UNUSED(GetBoolean)
UNUSED(GetString)
UNUSED(SetBoolean)
UNUSED(SetString)

/* Saved states; the time of one must not be before what the importer has promised. */
FMI int fmi2GetFMUstate(fmu_t *m, fmu_t **state)
{
    if (!*state) {
        *state = calloc(1, sizeof **state);
        m->saved++;
    }
    **state = *m;
    return called(m, "GetFMUstate", MADE | STARTING | IN_EVENT | CONTINUOUS);
}
FMI int fmi2SetFMUstate(fmu_t *m, const fmu_t *state)
{
    const int saved = m->saved, early = state->t < m->promised;
    const int result =
        called(m, early ? "SetFMUstate ILLEGAL" : "SetFMUstate", MADE | STARTING | IN_EVENT | CONTINUOUS);
    *m = *state;
    m->saved = saved;
    return result;
}
FMI int fmi2FreeFMUstate(fmu_t *m, fmu_t **state)
{
    if (*state) m->saved--;
    free(*state);
    *state = NULL;
    return called(m, "FreeFMUstate", MADE | STARTING | IN_EVENT | CONTINUOUS | OVER);
}
FMI int fmi2SerializedFMUstateSize(fmu_t *m, const fmu_t *state, size_t *size)
{
    *size = sizeof *state;
    return called(m, "SerializedFMUstateSize", MADE | STARTING | IN_EVENT | CONTINUOUS);
}
FMI int fmi2SerializeFMUstate(fmu_t *m, const fmu_t *state, char *bytes, size_t size)
{
    memcpy(bytes, state, size);
    return called(m, "SerializeFMUstate", MADE | STARTING | IN_EVENT | CONTINUOUS);
}
FMI int fmi2DeSerializeFMUstate(fmu_t *m, const char *bytes, size_t size, fmu_t **state)
{
    *state = malloc(sizeof **state);
    memcpy(*state, bytes, size);
    m->saved++;
    return called(m, "DeSerializeFMUstate", MADE | STARTING | IN_EVENT | CONTINUOUS);
}
