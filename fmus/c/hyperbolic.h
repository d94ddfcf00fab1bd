/* hyperbolic.h - the hyperbolic tangent, the same on every machine: no libm, no fused operations. */
#ifndef HYPERBOLIC_H
#define HYPERBOLIC_H

#include "real.h"

/* tanh x to about 2 ulp, for every x; NaN of NaN. */
#if TOGETHER == 1
double hyperbolic_tangent(double x);
#else
#include "hyperbolic_series.h"

static inline Real hyperbolic_tangent(Real x) {
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
