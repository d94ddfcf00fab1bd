/* trig.c - sine and cosine by reduction to [-pi/4, pi/4] and a polynomial.
 *
 * Reduction (Cody and Waite): x = k pi/2 + r + d, pi/2 = P1 + P2 + P3. P1 and P2 have 33
 * significant bits, k has at most 20: k P1 and k P2 are exact, and so is x - k P1. What
 * rounding r loses is kept in d.
 *
 * Polynomials: minimax (Remez) of relative error 2^-56 on the interval, in z = r^2:
 *     sin r = r + r^3 S(z),   cos r = 1 - z/2 + z^2 C(z);
 *     sin (r + d) = sin r + d (1 - z/2),   cos (r + d) = cos r - d r   to the order that matters.
 */
#include "trig.h"

#include <math.h>

#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

static const double TWO_OVER_PI = 0x1.45f306dc9c883p-1;
static const double P1 = 0x1.921fb54400000p+0;
static const double P2 = 0x1.0b4611a600000p-34;
static const double P3 = 0x1.3198a2e037073p-69;
static const double ROUND = 0x1.8p52; /* adding and subtracting it rounds to an integer */

static const double S1 = -0.1666666666666663, S2 = 0.00833333333332209;
static const double S3 = -0.00019841269829566106, S4 = 2.755731361296574e-06;
static const double S5 = -2.5050746401508872e-08, S6 = 1.5896148880587031e-10;

static const double C1 = 0.041666666666666595, C2 = -0.0013888888888873017;
static const double C3 = 2.4801587288825886e-05, C4 = -2.7557314171641616e-07;
static const double C5 = 2.087569977576356e-09, C6 = -1.135848003504428e-11;

void sine_cosine(double x, double *sine, double *cosine) {
    if (!(x >= -TRIG_RANGE && x <= TRIG_RANGE)) {
        *sine = *cosine = NAN;
        return;
    }
    const double k = (x * TWO_OVER_PI + ROUND) - ROUND;
    const double a = x - k * P1, b = k * P2; /* both exact */
    const double u = a - b;
    const double v = k * P3 - ((a - u) - b); /* the rest to subtract from u */
    const double r = u - v;
    const double d = (u - r) - v;

    const double z = r * r, zz = z * z, half = 0.5 * z, one = 1.0 - half;
    const double S = (S1 + z * S2) + zz * ((S3 + z * S4) + zz * (S5 + z * S6));
    const double C = (C1 + z * C2) + zz * ((C3 + z * C4) + zz * (C5 + z * C6));
    const double s = r + (r * z * S + d * one);
    const double c = one + (((1.0 - one) - half) + (zz * C - r * d));

    const int quadrant = (int)k & 3;
    const double p = quadrant & 1 ? c : s, q = quadrant & 1 ? s : c;
    *sine = quadrant & 2 ? -p : p;
    *cosine = (quadrant + 1) & 2 ? -q : q;
}
