/* The functions of FMI 3.0 of the FMU in exchange_model.h. */
#include <stdbool.h>

#include "exchange_model.h"

FMI const char *fmi3GetVersion(void) { return "3.0"; }
FMI void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources,
                                       bool visible, bool logging, void *environment, void *log)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    (void)environment; /* it may be NULL */
    return log ? made() : NULL;
}
FMI void fmi3FreeInstance(fmu_t *m)
{
    called(m, m->saved ? "FreeInstance LEAK" : "FreeInstance", ~DEAD);
    if (m->state != DEAD) free(m);
}
FMI int fmi3EnterInitializationMode(fmu_t *m, bool a, double tolerance, double t0, bool b, double t1)
{
    (void)a, (void)tolerance, (void)b, (void)t1;
    begins(m, t0);
    return mode(m, "EnterInitializationMode", MADE, STARTING);
}
FMI int fmi3ExitInitializationMode(fmu_t *m) { return mode(m, "ExitInitializationMode", STARTING, IN_EVENT); }
FMI int fmi3EnterEventMode(fmu_t *m) { return mode(m, "EnterEventMode", CONTINUOUS, IN_EVENT); }
FMI int fmi3EnterContinuousTimeMode(fmu_t *m)
{
    return mode(m, "EnterContinuousTimeMode", IN_EVENT, CONTINUOUS);
}
FMI int fmi3Terminate(fmu_t *m) { return mode(m, "Terminate", IN_EVENT | CONTINUOUS, OVER); }
FMI int fmi3UpdateDiscreteStates(fmu_t *m, bool *again, bool *terminate, bool *nominals, bool *values,
                                 bool *defined, double *next)
{
    *again = *values = happens(m);
    m->heard = m->gear;
    *terminate = m->model == COUNTS && m->events >= m->last;
    *nominals = false;
    *defined = m->model == COUNTS;
    *next = m->latest + m->period;
    return called(m, "NewDiscreteStates", IN_EVENT);
}
FMI int fmi3CompletedIntegratorStep(fmu_t *m, bool no_set, bool *event, bool *terminate)
{
    if (no_set) m->promised = m->t;
    *event = m->model == WRAPS && m->x[0] > 1.0, *terminate = false;
    return called(m, "CompletedIntegratorStep", CONTINUOUS);
}
FMI int fmi3SetTime(fmu_t *m, double t) { return set_time(m, t); }
FMI int fmi3SetContinuousStates(fmu_t *m, const double *x, size_t n) { return n == 2 ? set_states(m, x) : 3; }
FMI int fmi3GetContinuousStates(fmu_t *m, double *x, size_t n) { return n == 2 ? get_states(m, x) : 3; }
FMI int fmi3GetContinuousStateDerivatives(fmu_t *m, double *d, size_t n)
{
    return n == 2 ? derivatives(m, d) : 3;
}
FMI int fmi3GetNominalsOfContinuousStates(fmu_t *m, double *x, size_t n)
{
    for (size_t i = 0; i < n; i++) x[i] = 1.0;
    return called(m, "GetNominals", STARTING | IN_EVENT | CONTINUOUS | OVER);
}
FMI int fmi3GetEventIndicators(fmu_t *m, double *z, size_t n)
{
    *z = indicator(m);
    if (n == 2) z[1] = other_indicator(m);
    return n == 1 || n == 2 ? called(m, "EventIndicators", STARTING | IN_EVENT | CONTINUOUS | OVER) : 3;
}
FMI int fmi3GetDirectionalDerivative(fmu_t *m, const uint32_t *unknowns, size_t n, const uint32_t *knowns,
                                     size_t k, const double *seed, size_t n_seed, double *found,
                                     size_t n_found)
{
    return n == k && n_seed == n && n_found == n ? directional(m, unknowns, knowns, n, seed, found) : 3;
}
FMI int fmi3GetFloat64(fmu_t *m, const uint32_t *r, size_t n, double *v, size_t k)
{
    return n == k ? get_real(m, r, n, v) : 3;
}
FMI int fmi3SetFloat64(fmu_t *m, const uint32_t *r, size_t n, const double *v, size_t k)
{
    return n == k ? set_real(m, r, n, v) : 3;
}
FMI int fmi3GetInt32(fmu_t *m, const uint32_t *r, size_t n, int32_t *v, size_t k)
{
    (void)k;
    for (size_t i = 0; i < n; i++)
        if (get_whole(m, r[i], v + i)) return 3;
    return 0;
}
FMI int fmi3SetInt32(fmu_t *m, const uint32_t *r, size_t n, const int32_t *v, size_t k)
{
    (void)k;
    for (size_t i = 0; i < n; i++)
        if (set_whole(m, r[i], v[i])) return 3;
    return 0;
}

/* Saved states; the time of one must not be before what the importer has promised. */
FMI int fmi3GetFMUState(fmu_t *m, fmu_t **state)
{
    if (!*state) {
        *state = calloc(1, sizeof **state);
        m->saved++;
    }
    **state = *m;
    return called(m, "GetFMUState", MADE | STARTING | IN_EVENT | CONTINUOUS);
}
FMI int fmi3SetFMUState(fmu_t *m, const fmu_t *state)
{
    const int saved = m->saved, early = state->t < m->promised;
    const int result =
        called(m, early ? "SetFMUState ILLEGAL" : "SetFMUState", MADE | STARTING | IN_EVENT | CONTINUOUS);
    *m = *state;
    m->saved = saved;
    return result;
}
FMI int fmi3FreeFMUState(fmu_t *m, fmu_t **state)
{
    if (*state) m->saved--;
    free(*state);
    *state = NULL;
    return called(m, "FreeFMUState", MADE | STARTING | IN_EVENT | CONTINUOUS | OVER);
}
FMI int fmi3SerializedFMUStateSize(fmu_t *m, const fmu_t *state, size_t *size)
{
    *size = sizeof *state;
    return called(m, "SerializedFMUStateSize", MADE | STARTING | IN_EVENT | CONTINUOUS);
}
FMI int fmi3SerializeFMUState(fmu_t *m, const fmu_t *state, char *bytes, size_t size)
{
    memcpy(bytes, state, size);
    return called(m, "SerializeFMUState", MADE | STARTING | IN_EVENT | CONTINUOUS);
}
FMI int fmi3DeserializeFMUState(fmu_t *m, const char *bytes, size_t size, fmu_t **state)
{
    *state = malloc(sizeof **state);
    memcpy(*state, bytes, size);
    m->saved++;
    return called(m, "DeserializeFMUState", MADE | STARTING | IN_EVENT | CONTINUOUS);
}
