/* natural.h - adaptation that keeps the estimate of a link physically consistent; equations in
 * fmus/arms/natural.py.
 *
 *     dP = -rate P L P,      P = [Sigma mc; mc^T m],   Sigma = tr(I) / 2 - I,   tr(P L) = ell^T theta
 */
#ifndef NATURAL_H
#define NATURAL_H

#include "declaration.h"

/* The symmetric 4 x 4 matrix with the upper entries `u` (xx xy yy xz yz zz, then x4 y4 z4 44). */
static inline void symmetric(const Real u[10], Real M[4][4])
{
    M[0][0] = u[0];
    M[0][1] = M[1][0] = u[1];
    M[1][1] = u[2];
    M[0][2] = M[2][0] = u[3];
    M[1][2] = M[2][1] = u[4];
    M[2][2] = u[5];
    for (int k = 0; k < 3; k++) M[k][3] = M[3][k] = u[6 + k];
    M[3][3] = u[9];
}

static inline Real root(Real x)
{
#if TOGETHER == 1
    return sqrt(x);
#else
    for (int k = 0; k < TOGETHER; k++) x[k] = sqrt(x[k]);
    return x;
#endif
}

static inline void pseudo_inertia(const Real theta[10], Real P[4][4])
{
    const Real *I = theta + 4, half = 0.5 * (I[0] + I[2] + I[5]);
    const Real u[10] = {half - I[0], -I[1],    half - I[2], -I[3],    -I[4],
                        half - I[5], theta[1], theta[2],    theta[3], theta[0]};
    symmetric(u, P);
}

/* theta (10,), the estimate of a link, moves against the gradient ell (10,): by `step`, the rate
 * times h, or by less, so that at least half of P is left in every direction. */
static inline void natural_step(Real theta[10], const Real ell[10], Real step)
{
    const Real *l = ell + 4;
    const Real u[10] = {l[2] + l[5], -0.5 * l[1],  l[0] + l[5],  -0.5 * l[3],  -0.5 * l[4],
                        l[0] + l[2], 0.5 * ell[1], 0.5 * ell[2], 0.5 * ell[3], ell[0]};
    Real P[4][4], L[4][4], PL[4][4], next[4][4], squared = REAL(0.0);
    pseudo_inertia(theta, P);
    symmetric(u, L);
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < 4; k++) {
            PL[i][k] = REAL(0.0);
            for (int j = 0; j < 4; j++) PL[i][k] += P[i][j] * L[j][k];
        }
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < 4; k++) squared += PL[i][k] * PL[k][i];
    const Truth far = step * step * squared > 0.25;
    if (ANY(far)) step = PICK(far, 0.5 / root(squared), step);
    for (int i = 0; i < 4; i++)
        for (int k = 0; k <= i; k++) {
            Real change = REAL(0.0);
            for (int j = 0; j < 4; j++) change += PL[i][j] * P[j][k];
            next[i][k] = P[i][k] - step * change;
        }
    const Real trace = next[0][0] + next[1][1] + next[2][2];
    theta[0] = next[3][3];
    for (int k = 0; k < 3; k++) theta[1 + k] = next[3][k];
    theta[4] = trace - next[0][0];
    theta[5] = -next[1][0];
    theta[6] = trace - next[1][1];
    theta[7] = -next[2][0];
    theta[8] = -next[2][1];
    theta[9] = trace - next[2][2];
}

#endif
