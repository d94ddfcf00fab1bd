/* hyperbolic.h - the hyperbolic tangent, the same on every machine: no libm, no fused operations. */
#ifndef HYPERBOLIC_H
#define HYPERBOLIC_H

#include "real.h"

#define ONE_OVER_LN2 0x1.71547652b82fep+0

/* tanh of hyperbolic.c, of y >= 0 and its k, the nearest integer to y / ln 2; `power` = 2^k. */
static inline Real tangent_of(Real y, Real k, Real power)
{
    const double L1 = 0x1.62e42fef00000p-1, L2 = 0x1.473de6af278edp-34;
    const Real r = (y - k * L1) - k * L2;

    Real p = 1.0 / 479001600.0 + r * (1.0 / 6227020800.0); /* 1 / 12!, 1 / 13! */
    p = 1.0 / 39916800.0 + r * p;
    p = 1.0 / 3628800.0 + r * p;
    p = 1.0 / 362880.0 + r * p;
    p = 1.0 / 40320.0 + r * p;
    p = 1.0 / 5040.0 + r * p;
    p = 1.0 / 720.0 + r * p;
    p = 1.0 / 120.0 + r * p;
    p = 1.0 / 24.0 + r * p;
    p = 1.0 / 6.0 + r * p;
    p = 0.5 + r * p;
    p = r + r * r * p;
    const Real less = power * p + (power - 1.0); /* e^y - 1 */
    return less / (less + 2.0);
}

/* tanh x to about 2 ulp, for every x; NaN of NaN. */
#if TOGETHER == 1
double hyperbolic_tangent(double x);
#else
static inline Real hyperbolic_tangent(Real x)
{
    const double round = 0x1p52; /* adding and subtracting it rounds to an integer */
    const Real y = 2.0 * PICK(x < 0.0, -x, x);
    const Real above = y * ONE_OVER_LN2 + 0.5, nearest = (above + round) - round;
    const Real k = PICK(nearest > above, nearest - 1.0, nearest);
    const Real power = (Real)(((Truth)(k + round) + 1023) << 52);
    const Real found = tangent_of(y, k, power), limit = REAL(1.0);
    const Real size = PICK(y < 40.0, found, PICK(y != y, x, limit));
    return PICK(x < 0.0, -size, size);
}
#endif

#endif
