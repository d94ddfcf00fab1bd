/* guard.c: limits of a torque before it leaves a node; see guard.h. */
#include "guard.h"

#include <math.h>

#include "life_cycle.h"

enum { BITS = 7 };

/* By comparison, not by the sign or the exponent: true for no NaN and no infinity. */
static int finite(double x) { return x - x == 0.0; }

static double magnitude(double x) { return x < 0.0 ? -x : x; }

/* `x` within ±limit (limit >= 0); a limit that is not a number lets nothing through. */
static double clipped(double x, double limit)
{
    if (!(limit >= 0.0)) return 0.0;
    return x > limit ? limit : x < -limit ? -limit : x;
}

static double limited(double tau, double limit, uint32_t bit, uint32_t *bits)
{
    const double out = clipped(tau, limit);
    if (out != tau) *bits |= bit;
    return out;
}

/* Whether the encoder moved further in a tick than it can; remembers where it is. */
static int jumped(guard_t *g, int32_t i, double q)
{
    const double last = g->last_q[i];
    g->last_q[i] = q;
    return g->q_jump && finite(last) && !(magnitude(q - last) <= g->q_jump[i]);
}

/* Faults that set the torque to 0: a value that is not finite, or an implausible encoder value. */
static uint32_t input_fault_bits(guard_t *g, int32_t i, double tau, const double *q, const double *dq)
{
    uint32_t bits = finite(tau) ? 0 : GUARD_FINITE;
    if (dq && !finite(dq[i])) bits |= GUARD_FINITE;
    if (q && !finite(q[i])) bits |= GUARD_FINITE;
    else if (q && jumped(g, i, q[i])) bits |= GUARD_JUMP;
    return bits;
}

/* -1, 0, 1: below, within, beyond the soft limits. A limit that is not a number is passed. */
static int soft_limit_side(const guard_t *g, int32_t i, double q)
{
    if (g->q_high && !(q <= g->q_high[i])) return 1;
    return g->q_low && !(q >= g->q_low[i]) ? -1 : 0;
}

/* Without what points outwards beyond a soft limit, what accelerates beyond dq_max, and what is
 * more than power_max. */
static double limit_torque(const guard_t *g, int32_t i, double tau, int beyond, const double *dq,
                           uint32_t *bits)
{
    if (beyond) *bits |= GUARD_POSITION;
    if (beyond * tau > 0.0) tau = 0.0;
    if (!dq) return tau;
    const double v = dq[i];
    if (g->dq_max && !(magnitude(v) <= g->dq_max[i])) {
        *bits |= GUARD_VELOCITY;
        if ((v < 0.0 ? -tau : tau) > 0.0) tau = 0.0;
    }
    if (g->power_max && !(tau * v <= g->power_max[i])) {
        *bits |= GUARD_POWER;
        tau = clipped(tau, g->power_max[i] / magnitude(v));
    }
    return tau;
}

/* Damping while a joint moves outwards beyond a soft limit: never a push out. */
static double braking(const guard_t *g, int32_t i, int beyond, const double *dq)
{
    if (!(g->brake > 0.0)) return 0.0;
    return dq && beyond * dq[i] > 0.0 ? -g->brake * dq[i] : 0.0;
}

/* Torque of one joint before the scale; last_tau is what the rate counts from: without brake. */
static double guarded(guard_t *g, int32_t i, double tau, const double *q, const double *dq, uint32_t *bits)
{
    const uint32_t refused = input_fault_bits(g, i, tau, q, dq);
    const double last = finite(g->last_tau[i]) ? g->last_tau[i] : 0.0;
    *bits |= refused;
    g->last_tau[i] = 0.0;
    if (refused) return 0.0;
    if (g->tau_max) tau = limited(tau, g->tau_max[i], GUARD_TORQUE, bits);
    if (g->rate_max) {
        const double step = clipped(tau - last, g->rate_max[i] * g->h);
        if (step != tau - last) *bits |= GUARD_RATE, tau = last + step;
    }
    const int beyond = q ? soft_limit_side(g, i, q[i]) : 0;
    tau = limit_torque(g, i, tau, beyond, dq, bits);
    g->last_tau[i] = tau;
    tau += braking(g, i, beyond, dq);
    if (g->tau_max) tau = clipped(tau, g->tau_max[i]);
    if (!finite(tau)) *bits |= GUARD_FINITE, g->last_tau[i] = tau = 0.0;
    return tau;
}

API uint32_t guard_apply(guard_t *g, const double *tau, const double *q, const double *dq, double scale,
                         double *out)
{
    uint32_t bits = 0;
    if (!(scale > 0.0)) scale = 0.0;
    if (scale > 1.0) scale = 1.0;
    for (int32_t i = 0; i < g->joints; i++) {
        out[i] = scale * guarded(g, i, tau[i], q, dq, &bits) + 0.0; /* no -0 */
        if (scale == 0.0) g->last_tau[i] = 0.0;
    }
    if (scale == 0.0) bits &= ~(uint32_t)GUARD_RATE; /* nothing is given that could change */
    for (int32_t b = 0; b < BITS; b++) g->trips[b] += bits >> b & 1;
    return g->bits = bits;
}

API void guard_forget(guard_t *g)
{
    for (int32_t i = 0; i < g->joints; i++) g->last_q[i] = NAN;
}

API uint32_t guard_why(const guard_t *g)
{
    const uint32_t stopping = g->bits & g->stops;
    return (stopping & ~(uint32_t)GUARD_JUMP ? WHY_GUARD : 0) | (stopping & GUARD_JUMP ? WHY_JUMP : 0);
}
