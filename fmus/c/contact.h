/* contact.h - the torque of a unilateral wall, and the square root it takes.
 *
 * Of the depth x > 0 and its rate dx, by law:
 *
 *     SPRING_DAMPER    max(0, k x + b dx)
 *     HUNT_CROSSLEY_1  max(0, x (k + b dx))
 *     HUNT_CROSSLEY_15 max(0, x^1.5 (k + b dx))
 */
#ifndef CONTACT_H
#define CONTACT_H

#include <stdint.h>
#include <string.h>

#include "model.h"

enum { SPRING_DAMPER, HUNT_CROSSLEY_1, HUNT_CROSSLEY_15 };

/* The square root of a normal number x > 0, rounded to nearest, without libm.
 *
 * x = m 4^e with m in [1, 4). Heron's iteration gives y in [1, 2], the root of m to within a unit in
 * the last place u = 2^-52. It is right iff (y - u/2)^2 < m < (y + u/2)^2, that is
 * -y u < m - y^2 <= y u, since all of m, y^2 and y u are multiples of u^2. m - p is exact (p is
 * close to m), and so is y^2 = p + r by the halves a + b = y of 26 bits.
 */
static inline double square_root(double x) {
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

/* N.m; `stiffness` k and `damping` b in N.m/rad^n and N.m.s/rad^(n+1), n = 1 for SPRING_DAMPER. */
static inline double contact(int law, double x, double dx, double stiffness, double damping) {
    double torque = 0.0;
    if (!(x > 0.0)) return 0.0;
    if (law == SPRING_DAMPER)
        torque = stiffness * x + damping * dx;
    else if (law == HUNT_CROSSLEY_1)
        torque = x * (stiffness + damping * dx);
    else
        torque = x * square_root(x) * (stiffness + damping * dx);
    return torque > 0.0 ? torque : 0.0;
}

#endif
