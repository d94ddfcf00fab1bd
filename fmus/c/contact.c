/* contact.c - the square root that Hunt and Crossley's contact law needs. */
#include "contact.h"

#include <stdint.h>
#include <string.h>

/* x = m 4^e with m in [1, 4). Heron's iteration gives y in [1, 2], the root of m to within a unit in
 * the last place u = 2^-52. It is right iff (y - u/2)^2 < m < (y + u/2)^2, that is
 * -y u < m - y^2 <= y u, since all of m, y^2 and y u are multiples of u^2. m - p is exact (p is
 * close to m), and so is y^2 = p + r by the halves a + b = y of 26 bits.
 */
double square_root(double x)
{
    const double u = 0x1p-52;
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    const int exponent = (int)(bits >> 52) - 1023;
    const int odd = exponent & 1;
    bits = (bits & UINT64_C(0xfffffffffffff)) | (uint64_t)(1023 + odd) << 52;
    double m, scale;
    memcpy(&m, &bits, sizeof m);
    bits = (uint64_t)(1023 + (exponent - odd) / 2) << 52;
    memcpy(&scale, &bits, sizeof scale);

    double y = 0.535 + 0.513 * m - 0.0374 * m * m; /* within 1.2 % */
    for (int i = 0; i < 3; i++) y = 0.5 * (y + m / y);
    if (y < 1.0) y = 1.0;
    const double c = 0x1.0000002p27 * y, a = c - (c - y), b = y - a; /* c = (2^27 + 1) y */
    const double p = y * y, r = ((a * a - p) + 2.0 * a * b) + b * b;
    const double rest = (m - p) - r;
    if (rest > y * u) y += u;
    if (rest <= -y * u) y -= u;
    return y * scale;
}
