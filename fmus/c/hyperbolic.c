/* hyperbolic.c - tanh x = (e^y - 1) / (e^y + 1) with y = 2 |x|, and the sign of x.
 *
 * y = k ln 2 + r with |r| <= ln 2 / 2 and ln 2 = L1 + L2, where k L1 is exact (L1 has 33 significant
 * bits). e^r - 1 is its Taylor polynomial of degree 13, whose rest is below 2^-56 of it; then
 * e^y - 1 = 2^k (e^r - 1) + (2^k - 1), which keeps the accuracy near x = 0 where k = 0.
 */
#include "hyperbolic.h"

#include <stdint.h>
#include <string.h>

double hyperbolic_tangent(double x)
{
    const double y = 2.0 * (x < 0.0 ? -x : x);
    if (!(y < 40.0)) return y != y ? x : x < 0.0 ? -1.0 : 1.0;
    const int k = (int)(y * ONE_OVER_LN2 + 0.5);
    const uint64_t bits = (uint64_t)(1023 + k) << 52;
    double power; /* 2^k */
    memcpy(&power, &bits, sizeof power);
    const double found = tangent_of(y, k, power);
    return x < 0.0 ? -found : found;
}
