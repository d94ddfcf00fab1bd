/* regressor.h - the planar arm, linear in its lumped inertia parameters theta.
 *
 *     Y(q, dq, z, dz) theta = M(q) dz + C(q, dq) z
 *
 *     Y = [ dz1   c2 (2 dz1 + dz2) - s2 (dq2 z1 + (dq1 + dq2) z2)   dz2       ]
 *         [ 0     c2 dz1 + s2 dq1 z1                                dz1 + dz2 ]
 */
#ifndef REGRESSOR_H
#define REGRESSOR_H

#include "model.h"
#include "trig.h"

typedef struct {
    Real Y11, Y12, Y13, Y22, Y23;
} Regressor;

static inline Regressor regressor(const Real q[2], const Real dq[2], const Real z[2], const Real dz[2])
{
    Real s2, c2;
    sine_cosine(q[1], &s2, &c2);
    const Regressor Y = {dz[0], c2 * (2.0 * dz[0] + dz[1]) - s2 * (dq[1] * z[0] + (dq[0] + dq[1]) * z[1]),
                         dz[1], c2 * dz[0] + s2 * dq[0] * z[0], dz[0] + dz[1]};
    return Y;
}

/* tau = Y theta. */
static inline void torque_of(const Regressor *Y, const Real theta[3], Real tau[2])
{
    tau[0] = Y->Y11 * theta[0] + Y->Y12 * theta[1] + Y->Y13 * theta[2];
    tau[1] = Y->Y22 * theta[1] + Y->Y23 * theta[2];
}

/* Ys = Y^T s. */
static inline void transposed_times(const Regressor *Y, const Real s[2], Real Ys[3])
{
    Ys[0] = Y->Y11 * s[0];
    Ys[1] = Y->Y12 * s[0] + Y->Y22 * s[1];
    Ys[2] = Y->Y13 * s[0] + Y->Y23 * s[1];
}

#endif
