/* trig_reduced.h - sine and cosine but for the quadrant; part of trig.c and trig.h.
 *
 * Reduction (Cody and Waite): x = k pi/2 + r + d, pi/2 = P1 + P2 + P3. P1 and P2 have 33
 * significant bits, k has at most 20: k P1 and k P2 are exact, and so is x - k P1. What
 * rounding r loses is kept in d.
 *
 * Polynomials: minimax (Remez) of relative error 2^-56 on the interval, in z = r^2:
 *     sin r = r + r^3 S(z),   cos r = 1 - z/2 + z^2 C(z);
 *     sin (r + d) = sin r + d (1 - z/2),   cos (r + d) = cos r - d r   to the order that matters.
 */
#ifndef TRIG_REDUCED_H
#define TRIG_REDUCED_H

#include "real.h"

/* The sine and cosine of x - k pi/2. Returns k + TRIG_ROUND. */
static inline Real reduced(Real x, Real *sine, Real *cosine)
{
    const double TWO_OVER_PI = 0x1.45f306dc9c883p-1;
    const double P1 = 0x1.921fb54400000p+0;
    const double P2 = 0x1.0b4611a600000p-34;
    const double P3 = 0x1.3198a2e037073p-69;

    const double S1 = -0.1666666666666663, S2 = 0.00833333333332209;
    const double S3 = -0.00019841269829566106, S4 = 2.755731361296574e-06;
    const double S5 = -2.5050746401508872e-08, S6 = 1.5896148880587031e-10;

    const double C1 = 0.041666666666666595, C2 = -0.0013888888888873017;
    const double C3 = 2.4801587288825886e-05, C4 = -2.7557314171641616e-07;
    const double C5 = 2.087569977576356e-09, C6 = -1.135848003504428e-11;

    const Real shifted = x * TWO_OVER_PI + TRIG_ROUND;
    const Real k = shifted - TRIG_ROUND;
    const Real a = x - k * P1, b = k * P2; /* both exact */
    const Real u = a - b;
    const Real v = k * P3 - ((a - u) - b); /* the rest to subtract from u */
    const Real r = u - v;
    const Real d = (u - r) - v;

    const Real z = r * r, zz = z * z, half = 0.5 * z, one = 1.0 - half;
    const Real S = (S1 + z * S2) + zz * ((S3 + z * S4) + zz * (S5 + z * S6));
    const Real C = (C1 + z * C2) + zz * ((C3 + z * C4) + zz * (C5 + z * C6));
    *sine = r + (r * z * S + d * one);
    *cosine = one + (((1.0 - one) - half) + (zz * C - r * d));
    return shifted;
}

#endif
