/* exchange.c - a model for model exchange: its states, their derivatives, and directional derivatives. */
#include "instance.h"

#include <string.h>

int exchangeable(const Instance *x, unsigned modes, const void *numbers, size_t n, size_t expected,
                 const char *function)
{
    if (declared.rates == NULL) {
        refuse(x, function, "this FMU is for co-simulation only");
        return 0;
    }
    if (!legal(x, modes, function)) return 0;
    if (n == expected && (n == 0 || numbers != NULL)) return 1;
    refuse(x, function, "found %lu numbers, expected %lu", numbers ? (unsigned long)n : 0ul,
           (unsigned long)expected);
    return 0;
}

Status exchange_set_time(Instance *x, double t, const char *function)
{
    if (!exchangeable(x, EVENT | CONTINUOUS, NULL, 0, 0, function)) return STATUS_ERROR;
    if (!all_finite(&t, 1)) return refuse(x, function, "the time is %g s", t);
    x->values[TIME] = t; /* no model depends on it */
    return STATUS_OK;
}

Status exchange_set_states(Instance *x, const double *states, size_t n, const char *function)
{
    if (!exchangeable(x, CONTINUOUS, states, n, declared.n_states, function)) return STATUS_ERROR;
    for (size_t i = 0; i < n; i++) x->values[state_places[i]] = states[i];
    x->stale = 1;
    return STATUS_OK;
}

enum { KNOWN = INITIALIZATION | EVENT | CONTINUOUS | TERMINATED };

Status exchange_get_states(Instance *x, double *states, size_t n, const char *function)
{
    if (!exchangeable(x, KNOWN, states, n, declared.n_states, function)) return STATUS_ERROR;
    for (size_t i = 0; i < n; i++) states[i] = x->values[state_places[i]];
    return STATUS_OK;
}

Status exchange_get_rates(Instance *x, double *rates, size_t n, const char *function)
{
    if (!exchangeable(x, KNOWN, rates, n, declared.n_states, function)) return STATUS_ERROR;
    const Status status = settle(x, function);
    for (size_t i = 0; i < n && status == STATUS_OK; i++) rates[i] = x->values[rate_places[i]];
    return status;
}

Status exchange_get_nominals(Instance *x, double *nominals, size_t n, const char *function)
{
    if (!exchangeable(x, KNOWN, nominals, n, declared.n_states, function)) return STATUS_ERROR;
    for (size_t i = 0; i < n; i++) nominals[i] = 1.0;
    return STATUS_OK;
}

/* f'(0) = (8 (f(d) - f(-d)) - (f(2d) - f(-2d))) / (12 d) + O(d^4); d = 2^-10 for a seed of at most one. */
Status exchange_directional(Instance *x, Places unknowns, Places knowns, const double *seed,
                            double *sensitivity, const char *function)
{
    static const double node[4] = {1.0, -1.0, 2.0, -2.0}, weight[4] = {8.0, -8.0, -1.0, 1.0};
    double most = 0.0;
    const char *why = NULL;

    for (size_t k = 0; k < knowns.n; k++)
        if (fabs(seed[k]) > most) most = fabs(seed[k]);
    for (size_t i = 0; i < unknowns.n; i++) sensitivity[i] = 0.0;
    if (most == 0.0) return STATUS_OK;
    if (settle(x, function) != STATUS_OK) return STATUS_ERROR;
    const double d = 0x1p-10 / most;
    for (int j = 0; j < 4 && why == NULL; j++) {
        for (size_t k = 0; k < knowns.n; k++) x->values[knowns.places[k]] += node[j] * d * seed[k];
        why = declared.rates((Model *)x->values);
        for (size_t i = 0; i < unknowns.n; i++)
            sensitivity[i] += weight[j] / (12.0 * d) * x->values[unknowns.places[i]];
        for (size_t k = 0; k < knowns.n; k++) x->values[knowns.places[k]] -= node[j] * d * seed[k];
    }
    x->stale = 1;
    return why == NULL ? STATUS_OK : discard(x, function, "near this state %s", why);
}
