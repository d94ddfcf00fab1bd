/* hyperbolic.c - tanh x = (e^y - 1) / (e^y + 1) with y = 2 |x|, and the sign of x.
 *
 * y = k ln 2 + r with |r| <= ln 2 / 2 and ln 2 = L1 + L2, where k L1 is exact (L1 has 33 significant
 * bits). e^r - 1 is its Taylor polynomial of degree 13, whose rest is below 2^-56 of it; then
 * e^y - 1 = 2^k (e^r - 1) + (2^k - 1), which keeps the accuracy near x = 0 where k = 0.
 */
#include "hyperbolic.h"

#include <stdint.h>
#include <string.h>

#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

static const double ONE_OVER_LN2 = 0x1.71547652b82fep+0;
static const double L1 = 0x1.62e42fef00000p-1;
static const double L2 = 0x1.473de6af278edp-34;

double hyperbolic_tangent(double x) {
    const double y = 2.0 * (x < 0.0 ? -x : x);
    if (!(y < 40.0)) return y != y ? x : x < 0.0 ? -1.0 : 1.0;
    const int k = (int)(y * ONE_OVER_LN2 + 0.5);
    const double r = (y - k * L1) - k * L2;

    double p = 1.0 / 6227020800.0; /* 1 / 13! */
    p = 1.0 / 479001600.0 + r * p;
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

    const uint64_t bits = (uint64_t)(1023 + k) << 52;
    double power; /* 2^k */
    memcpy(&power, &bits, sizeof power);
    const double less = power * p + (power - 1.0); /* e^y - 1 */
    const double found = less / (less + 2.0);
    return x < 0.0 ? -found : found;
}
