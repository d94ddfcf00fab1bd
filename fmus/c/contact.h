/* contact.h - the torque of a unilateral wall.
 *
 * Of the depth x > 0 and its rate dx, by law; none for x <= 0:
 *
 *     SPRING_DAMPER     max(0, k x + b dx)
 *     HUNT_CROSSLEY_1   max(0, x (k + b dx))
 *     HUNT_CROSSLEY_15  max(0, x^1.5 (k + b dx))
 */
#ifndef CONTACT_H
#define CONTACT_H

#include "real.h"

enum { SPRING_DAMPER, HUNT_CROSSLEY_1, HUNT_CROSSLEY_15 };

/* The square root of a normal number x > 0, rounded to nearest, without libm. */
double square_root(double x);

/* The square root where x > 0, else 0. */
static inline Real root_of_depth(Real x)
{
#if TOGETHER == 1
    return x > 0.0 ? square_root(x) : 0.0;
#else
    Real root = {0.0};
    for (int k = 0; k < TOGETHER; k++) root[k] = x[k] > 0.0 ? square_root(x[k]) : 0.0;
    return root;
#endif
}

/* N.m; `stiffness` k and `damping` b in N.m/rad^n and N.m.s/rad^(n+1), n = 1 for SPRING_DAMPER. */
static inline Real contact(int law, Real x, Real dx, Real stiffness, Real damping)
{
    const Real depth = law == HUNT_CROSSLEY_15 ? x * root_of_depth(x) : x;
    const Real torque =
        law == SPRING_DAMPER ? stiffness * x + damping * dx : depth * (stiffness + damping * dx);
    return PICK((x > 0.0) & (torque > 0.0), torque, 0.0);
}

#endif
