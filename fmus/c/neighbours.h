/* neighbours.h - the coupling of an adaptive law with its neighbours, joint by joint.
 *
 *     lambda sum_j w_j (xi - xi_in_j)
 *
 * Included after NETWORKED is defined: 1, the model has xi_in, w, age, lambda, age_max and age_fade;
 * 0, one arm alone. TASK is 1 for a model that has `listens`, too.
 */
#ifndef NEIGHBOURS_H
#define NEIGHBOURS_H

#include "model.h"

#if NETWORKED
enum { NEIGHBOURS = ENTRIES(w) };

/* Whether the value received over an active edge is older than age_max. */
static inline Truth is_stale(const Model *x, int j) { return (x->w[j] > 0.0) & (x->age[j] > x->age_max); }

static inline Truth any_stale(const Model *x)
{
    Truth stale = NEVER;
    for (int j = 0; j < NEIGHBOURS; j++) stale |= is_stale(x, j);
    return stale;
}

/* The weight w_j; for an edge that is too old it falls to 0 within age_fade. */
static inline Real weight(const Model *x, int j)
{
    const Truth stale = is_stale(x, j);
    if (!ANY(stale)) return x->w[j];
    const Real late = x->age[j] - x->age_max;
    const Real faded = PICK(late < x->age_fade, (1.0 - late / x->age_fade) * x->w[j], 0.0);
    return PICK(stale, faded, x->w[j]);
}

/* The part of entry i of what neighbour j sends that counts. */
#if defined(TASK) && TASK
#define HEARD(x, j, i) (x)->listens[j][i]
#else
#define HEARD(x, j, i) 1.0
#endif

/* lambda sum_j w_j (xi - xi_in_j) of entry i, a joint or a coordinate. */
static inline Real coupling(const Model *x, int i, Real xi)
{
    Real consensus = {0.0};
    for (int j = 0; j < NEIGHBOURS; j++) consensus += HEARD(x, j, i) * weight(x, j) * (xi - x->xi_in[j][i]);
    return x->lambda * consensus;
}
#else
static inline Truth any_stale(const Model *x) { return (void)x, NEVER; }
static inline Real coupling(const Model *x, int i, Real xi)
{
    const Real none = {0.0};
    return (void)x, (void)i, (void)xi, none;
}
#endif

#endif
