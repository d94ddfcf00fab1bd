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

enum { SPRING_DAMPER, HUNT_CROSSLEY_1, HUNT_CROSSLEY_15 };

/* x or x^1.5, for x > 0. */
double contact_depth(int law, double x);

/* The square root of a normal number x > 0, rounded to nearest, without libm. */
double square_root(double x);

#define SPRING_AND_DAMPER(x, dx, stiffness, damping) ((stiffness) * (x) + (damping) * (dx))

/* N.m; `stiffness` k and `damping` b in N.m/rad^n and N.m.s/rad^(n+1), n = 1 for SPRING_DAMPER. */
static inline double contact(int law, double x, double dx, double stiffness, double damping) {
    const double torque = law == SPRING_DAMPER
                              ? SPRING_AND_DAMPER(x, dx, stiffness, damping)
                              : contact_depth(law, x) * (stiffness + damping * dx);
    return x > 0.0 && torque > 0.0 ? torque : 0.0;
}

#endif
